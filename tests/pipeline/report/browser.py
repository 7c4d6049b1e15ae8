"""Headless Chromium for the tests of pages: Debian's packages chromium and chromium-driver."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

from selenium import webdriver
from selenium.webdriver.chrome.service import Service

OPTIONS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--window-size=1400,1000",
)


def installed() -> bool:
    """True if there is a browser with its driver."""
    return bool(shutil.which("chromium") and shutil.which("chromedriver"))


@contextmanager
def opened() -> Iterator[webdriver.Chrome]:
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
