"""Headless Chromium for the tests of pages: Debian's packages chromium and chromium-driver."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from selenium import webdriver
from selenium.webdriver import Chrome
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.ui import WebDriverWait

PATIENCE_S = 30

OPTIONS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    "--window-size=1400,1000",
)


needs_browser = pytest.mark.skipif(
    not (shutil.which("chromium") and shutil.which("chromedriver")),
    reason="Chromium is not installed: Debian's chromium and chromium-driver",
)


@contextmanager
def opened() -> Iterator[Chrome]:
    """A browser with a profile of its own, which ends with the block."""
    options = webdriver.ChromeOptions()
    options.binary_location = str(shutil.which("chromium"))
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        for option in (*OPTIONS, f"--user-data-dir={profile}"):
            options.add_argument(option)
        # With its own path stated, selenium looks for no driver elsewhere.
        browser = webdriver.Chrome(
            options=options, service=Service(str(shutil.which("chromedriver")))
        )
        # The chart library complains by traces, which the browser's log leaves out.
        loud = {"source": "console.trace = console.error;"}
        browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", loud)
        try:
            yield browser
        finally:
            browser.quit()


def visit(browser: Chrome, page: Path, fragment: str = "") -> None:
    """Open a page anew; whatever the console said before is forgotten."""
    browser.get("about:blank")
    browser.get_log("browser")
    browser.get(page.resolve().as_uri() + fragment)
    # On a busy machine `get` may end before the page's styles and scripts are there.
    wait(browser, "return location.protocol === 'file:' && document.readyState === 'complete'")


def complaints(browser: Chrome) -> list[str]:
    """Messages of the console, and a mark if a text was run as code."""
    messages = [entry["message"] for entry in browser.get_log("browser")]
    return [*messages, *(["harmed"] if browser.execute_script("return window.harmed") else [])]


def wait(browser: Chrome, script: str) -> Any:
    """The value of a script, as soon as it has one."""
    return WebDriverWait(browser, PATIENCE_S, 0.05).until(lambda page: page.execute_script(script))


def drawn(browser: Chrome) -> dict[str, str]:
    """Result of each figure: a chart, or a reason why there is none."""
    wait(browser, "return document.body.dataset.night")
    return wait(
        browser,
        "const all = [...document.querySelectorAll('figure.chart')];"
        "return all.every((figure) => figure.dataset.drawn)"
        " && Object.fromEntries(all.map((figure) => [figure.id, figure.dataset.drawn]))",
    )


def text(browser: Chrome, selector: str) -> str:
    """Text of all elements that a selector finds, shown or not."""
    elements: list[WebElement] = browser.find_elements(By.CSS_SELECTOR, selector)
    return " ".join(element.get_attribute("textContent") or "" for element in elements)


def shown(browser: Chrome) -> list[str]:
    """Ids of the motors that the fleet page shows, from the top."""
    return browser.execute_script(  # type: ignore[no-any-return]
        "return [...document.querySelectorAll('#fleet tbody tr')]"
        ".filter((row) => row.checkVisibility()).map((row) => row.querySelector('a').innerText)"
    )
