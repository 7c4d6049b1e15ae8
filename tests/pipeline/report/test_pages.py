"""The pages with names of others, on paper, on small and dark screens, and without scripts."""

from __future__ import annotations

import datetime as dt
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By

from pipeline.report.build import KnownMotor, ReportRequest, build_report
from pipeline.schema import NIGHT_TABLES, TREND_TABLES
from tests.pipeline.report.browser import complaints, drawn, needs_browser, text, visit, wait
from tests.pipeline.report.conftest import change_table
from tests.pipeline.report.judged import REASON

pytestmark = needs_browser

# Would run, were it ever taken for markup, for a part of a script or for a template.
HOSTILE = (
    '</script><script>window.harmed=1</script><img src=x onerror="window.harmed=1">'
    "'\"${window.harmed=1}%{x}<a href='javascript:window.harmed=1'>"
)


def hostile_output(output: Path) -> Path:
    """The tables with a stranger's words wherever a name or a text can stand."""
    texts = {
        "fits": ("motor_type", "oil", "reason", "reference_reason", "interval_status"),
        "parameters": ("reason",),
        "sensitivities": ("source",),
        "quality": ("reason",),
        "input_files": ("path", "message"),
        "trends": ("state_reason", "gated_reason", "unit"),
        "watch": ("cause", "candidates", "sentence", "advice"),
    }
    for table in (*NIGHT_TABLES, *TREND_TABLES):
        names = ("motor_id", *texts.get(table.name, ()))
        keyed = {"sensitivities": "source", "quality": "reason", "trends": "indicator"}
        unique = keyed.get(table.name)
        names = (*names, unique) if unique and unique not in names else names

        def rename(rows: pl.DataFrame, names: Any = names, unique: Any = unique) -> pl.DataFrame:
            mine = rows.filter(motor_id="CB560-01")
            return mine.with_columns(
                (pl.lit(HOSTILE) + pl.col(name) if name == unique else pl.lit(HOSTILE)).alias(name)
                for name in names
                if name in rows.columns
            )

        change_table(output, table.name, rename)
    return output


def test_hostile_names_are_shown_and_do_nothing(browser: Chrome, output: Path) -> None:
    hostile_output(output)
    event = {"date": dt.date(2026, 1, 3), "kind": HOSTILE, "note": HOSTILE}
    known = {HOSTILE: KnownMotor(HOSTILE, (event,))}
    build_report(ReportRequest(output, output / "report", fleet=HOSTILE, known=known))
    visit(browser, output / "report" / "index.html")
    link = browser.find_element(By.CSS_SELECTOR, "#fleet tbody a")
    assert link.text == HOSTILE
    assert complaints(browser) == []
    link.click()
    states = drawn(browser)
    assert states["budget"] == states["refused"] == "chart"
    assert browser.find_element(By.TAG_NAME, "h1").text == HOSTILE
    for details in browser.find_elements(By.TAG_NAME, "details"):
        browser.execute_script("arguments[0].open = true", details)
    wait(browser, "return document.querySelector('#budget tbody td')")
    assert HOSTILE in text(browser, "#budget tbody td")
    assert HOSTILE in text(browser, "#files td")
    assert HOSTILE in text(browser, "#refused .ytick text") + text(browser, "#refused tbody")
    assert browser.find_elements(By.CSS_SELECTOR, "main img, a[href^=javascript], svg a") == []


OVERLAPS = """
const kinds = 'h1, h2, h3, p, figcaption, .plot, table, dl, svg.strip';
const boxes = [...document.querySelectorAll(kinds)]
  .filter((one) => one.checkVisibility() && !one.matches('.unseen'))
  .map((one) => [one, one.getBoundingClientRect()])
  .filter(([, box]) => box.width && box.height);
const found = [];
boxes.forEach(([a, p], at) => boxes.slice(at + 1).forEach(([b, q]) => {
  if (a.contains(b) || b.contains(a)) return;
  const wide = Math.min(p.right, q.right) - Math.max(p.left, q.left);
  const high = Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top);
  if (wide > 1 && high > 1) found.push(`${a.tagName} ${a.textContent.slice(0, 30)} | ${b.tagName}`);
}));
return found;
"""
WIDEST = "return document.documentElement.scrollWidth"
PAGES = ("index.html", "motors/CB560-01.html")


def channels(browser: Chrome, selector: str, name: str) -> list[int]:
    """Red, green and blue of an element's colour."""
    script = "return getComputedStyle(document.querySelector(arguments[0]))[arguments[1]]"
    return [int(one) for one in re.findall(r"\d+", browser.execute_script(script, selector, name))]


@contextmanager
def seen_as(browser: Chrome, width: int, media: str = "", scheme: str = "light") -> Iterator[None]:
    """A screen, or a sheet of paper, of another width and colour."""
    size = {"width": width, "height": 1000, "deviceScaleFactor": 1, "mobile": False}
    scheme_feature = {"name": "prefers-color-scheme", "value": scheme}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.execute_cdp_cmd(
        "Emulation.setEmulatedMedia", {"media": media, "features": [scheme_feature]}
    )
    try:
        yield
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "", "features": []})


@pytest.mark.parametrize("page", PAGES)
def test_a_telephone_in_the_dark_and_paper(browser: Chrome, told: Path, page: str) -> None:
    """A4 between its margins is 703 pixels wide."""
    with seen_as(browser, 390, scheme="dark"):
        visit(browser, told / page)
        if page != PAGES[0]:
            drawn(browser)
        assert browser.execute_script(WIDEST) <= 390
        assert max(channels(browser, "body", "backgroundColor")) < 60
        if page != PAGES[0]:
            assert min(channels(browser, ".plot .xtick text", "fill")) > 150
        assert browser.execute_script(OVERLAPS) == []
    with seen_as(browser, 703, "print", "dark"):
        browser.execute_script("window.dispatchEvent(new Event('beforeprint'))")
        assert browser.execute_script(OVERLAPS) == []
        assert browser.execute_script(WIDEST) <= 703
        assert channels(browser, "body", "backgroundColor") == [255, 255, 255]


def test_without_scripts_the_pages_say_so_and_hold_the_figures(told: Path) -> None:
    for page in PAGES:
        content = (told / page).read_text("utf-8")
        assert "need JavaScript" in content.partition("<noscript>")[2].partition("</noscript>")[0]
        assert REASON[1:] in re.sub(r"<script.*?</script>", "", content, flags=re.DOTALL)
