"""Pictures of the README and the docs, made anew from the demo: `make pictures`."""

from __future__ import annotations

import io
import sys
from pathlib import Path

from PIL import Image
from selenium.webdriver.remote.webdriver import WebDriver

from tests.pipeline.report.browser import opened

PAGES = {"fleet.png": "index.html", "motor.png": "motors/CB560-02.html"}
SIZE = {"width": 1280, "height": 900, "deviceScaleFactor": 1, "mobile": False}
# The morning after the last night of the pictures' demo: its data are not old then.
MORNING = "Date.now = () => Date.parse('2026-03-17T08:00Z');"


def main(report: Path, folder: Path) -> None:
    """Write a picture of the first screen of each page."""
    folder.mkdir(parents=True, exist_ok=True)
    with opened() as browser:
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", SIZE)
        browser.execute_cdp_cmd("Emulation.setScrollbarsHidden", {"hidden": True})
        browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": MORNING})
        for name, page in PAGES.items():
            browser.get((report / page).resolve().as_uri())
            _first_screen(browser).save(folder / name, optimize=True)


def _first_screen(browser: WebDriver) -> Image.Image:
    screen = Image.open(io.BytesIO(browser.get_screenshot_as_png())).convert("RGB")
    # This method keeps the few colours of the marks; without it a green becomes a blue.
    return screen.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:3]))
