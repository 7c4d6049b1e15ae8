"""The pages in headless Chromium, opened from the file system."""

from __future__ import annotations

import base64
import datetime as dt
import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select

from pipeline.config.motors import Event
from pipeline.report.build import build_report
from tests.pipeline.report.browser import complaints, drawn, needs_browser, shown, text, visit, wait
from tests.pipeline.report.conftest import BY_NAME, change_table, demo_fleet
from tests.pipeline.report.judged import (
    ADVICE,
    HEADLINE,
    HEALTHY,
    NIGHTS,
    NOTE,
    REASON,
    WORN,
    YOUNG,
    publish_latest,
)

pytestmark = needs_browser

MOTORS = 6
PAGES = ("index.html", f"motors/{WORN}.html", "glossary.html")
NIGHT = "return document.body.dataset.night"
# Within the width of a scroll bar.
FILLED = """
const plot = document.querySelector('#course .plot');
return Math.abs(plot.clientWidth - plot.querySelector('.main-svg').clientWidth) < 20;
"""


# The fleet


def test_motors_are_searched_and_sorted_and_both_stand_in_the_address(
    browser: Chrome, judged: Path
) -> None:
    visit(browser, judged / "index.html")
    every = shown(browser)
    assert len(every) == MOTORS
    assert every[0] == WORN
    (entry,) = browser.find_elements(By.CSS_SELECTOR, ".attention li")
    assert f"alarm\n{WORN}\n{HEADLINE} {ADVICE}" in entry.text
    assert f"Acknowledged: {NOTE}" in entry.text
    # A state has its words beside it, and old data are marked: 11 UTC is noon in the fleet's zone.
    cells = browser.find_elements(By.CSS_SELECTOR, "#fleet tbody td:nth-child(2)")
    assert cells[0].text == f"alarm\n{ADVICE}"
    assert "insufficient\n3 of 8 nights. Wait." in [cell.text for cell in cells]
    old = [element.text for element in browser.find_elements(By.CSS_SELECTOR, "time.old")]
    assert old[0].startswith("2026-01-05 12:00 (")
    assert old[0].endswith(" days ago)")
    assert len(old) == 1 + MOTORS
    find = browser.find_element(By.ID, "find")
    find.send_keys("cb560 insufficient")
    assert shown(browser) == ["CB560-02"]
    assert browser.find_element(By.ID, "shown").text == f"1 of {MOTORS} shown"
    # Who is searched for leaves the others above the table, too.
    assert not entry.is_displayed()
    browser.find_element(By.CSS_SELECTOR, "[type=reset]").click()
    wait(browser, "return document.getElementById('shown').textContent === ''")
    header = browser.find_elements(By.CSS_SELECTOR, "#fleet thead th")[3]
    assert header.text.startswith("Leakage at its usual operating point")
    button = header.find_element(By.TAG_NAME, "button")
    for keys, order in ((Keys.ENTER, [WORN, HEALTHY]), (Keys.SPACE, [HEALTHY, WORN])):
        button.send_keys(keys)
        # What is absent comes last, whichever way.
        assert shown(browser)[:2] == order
    assert header.get_dom_attribute("aria-sort") == "ascending"
    find.send_keys("cb")
    # The page's own word: the browser's address follows a moment later.
    address = browser.execute_script("return location.hash")
    seen = shown(browser)
    visit(browser, judged / "index.html", address)
    assert shown(browser) == seen
    visit(browser, judged / "index.html", "#find=none&sort=99%20up&type=%E0<b>")
    assert shown(browser) == []
    assert browser.find_element(By.ID, "nothing").is_displayed()


# A motor


def test_every_chart_is_drawn_before_it_is_scrolled_to(browser: Chrome, judged: Path) -> None:
    visit(browser, judged / "motors" / f"{WORN}.html")
    wait(browser, NIGHT)
    # The leakage has three of five: on the right the axis of l/min, and one of the marks.
    for name, n_panels in (("course", 5), ("samples", 4), ("residuals", 4)):
        chart = browser.find_element(By.ID, name)
        assert chart.get_dom_attribute("data-drawn") == "chart"
        assert len(chart.find_elements(By.CSS_SELECTOR, ".cartesianlayer > .subplot")) == n_panels
        assert chart.find_elements(By.CSS_SELECTOR, ".scatterlayer path.js-line")
    assert set(drawn(browser).values()) == {"chart"}
    # No button sends a chart away.
    buttons = browser.find_elements(By.CSS_SELECTOR, ".modebar-btn")
    wanted = {"Zoom", "Pan", "Zoom in", "Zoom out", "Reset axes", "Download plot as a PNG"}
    assert {button.get_dom_attribute("data-title") for button in buttons} == wanted
    assert browser.find_elements(By.CSS_SELECTOR, "[href^=http], [src^=http]") == []
    assert HEADLINE in browser.find_element(By.ID, "headline").text
    assert f"L{REASON[1:]}." in browser.find_element(By.ID, "sentence").text
    aside = browser.find_element(By.TAG_NAME, "aside").text
    for words in ("balance sleeve 95 %", "0.40, model supported"):
        assert words in aside
    assert browser.find_element(By.CSS_SELECTOR, ".marks").text.splitlines() == [
        "2026-01-04 alarm",
        "2026-01-05 change detected: balance sleeve",
    ]
    changed = browser.find_element(By.CSS_SELECTOR, "#alarm-table tbody tr")
    assert "leakage ok alarm +21 % [17, 25], balance sleeve" in " ".join(changed.text.split())
    changed.find_element(By.TAG_NAME, "summary").click()
    assert REASON in changed.text
    decided = browser.find_element(By.ID, "decision-table").text
    for words in (NOTE, "Worn: balance sleeve. Sound: piston ring."):
        assert words in decided


def test_a_night_is_chosen_from_the_list_by_button_by_address_and_in_the_chart(
    browser: Chrome, report: Path
) -> None:
    # An address that is no night leads to the newest.
    visit(browser, report / "motors" / "CB400-02.html", "#../../../etc/passwd%E0")
    assert wait(browser, NIGHT) == NIGHTS[2]
    Select(browser.find_element(By.ID, "choose")).select_by_value(NIGHTS[0])
    wait(browser, f"{NIGHT} === '{NIGHTS[0]}'")
    words = browser.find_element(By.ID, "words").text
    for part in (f"CB400-02, night of {NIGHTS[0]}: fitted", "at the reference (200 bar", "Paths"):
        assert part in words
    assert not browser.find_element(By.ID, "earlier").is_enabled()
    browser.find_element(By.ID, "later").send_keys(Keys.ENTER)
    wait(browser, f"{NIGHT} === '{NIGHTS[1]}'")
    browser.back()
    wait(browser, f"{NIGHT} === '{NIGHTS[0]}'")
    visit(browser, report / "motors" / "CB400-02.html", f"#{NIGHTS[1]}")
    assert wait(browser, NIGHT) == NIGHTS[1]
    drawn(browser)
    browser.execute_script("window.scrollTo(0, 0)")
    browser.execute_script(
        "document.querySelector('#course .plot')"
        ".emit('plotly_click', {points: [{x: arguments[0]}]})",
        NIGHTS[0],
    )
    wait(browser, f"{NIGHT} === '{NIGHTS[0]}'")
    # It comes into view, and is marked in the chart over the nights.
    top = "return document.getElementById('night').getBoundingClientRect().top"
    assert 0 <= browser.execute_script(top) < 100
    marked = browser.execute_script(
        "return document.querySelector('#course .plot').layout"
        ".shapes.filter((shape) => shape.name === 'chosen night').map((one) => one.x0)"
    )
    assert marked == [NIGHTS[0]]


def test_a_motor_s_page_prints_as_a_work_order_on_one_sheet(browser: Chrome, judged: Path) -> None:
    # The fullest page, and that of a motor of which little is known.
    for motor in (WORN, YOUNG[0]):
        page = judged / "motors" / f"{motor}.html"
        visit(browser, page)
        drawn(browser)
        asked = {"preferCSSPageSize": True}
        sheets = base64.b64decode(browser.execute_cdp_cmd("Page.printToPDF", asked)["data"])
        assert sheets.count(b"/Type /Page\n") == 1, page.stem
        # On the screen the chart fills its place again.
        wait(browser, FILLED)
        sheet = browser.find_element(By.CLASS_NAME, "sheet")
        assert not sheet.is_displayed()
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
        parts = [element.text for element in sheet.find_elements(By.CSS_SELECTOR, "tbody th")]
        assert parts == ["piston ring", "balance piston", "balance sleeve", "cam roller"]
        for words in ("Not opened", "Measured gap", "Signature", f"ack fleet.toml {page.stem}"):
            assert words in sheet.text
        assert browser.find_element(By.ID, "headline").is_displayed()
        assert browser.find_element(By.ID, "course").is_displayed()
        assert not browser.find_element(By.ID, "night").is_displayed()
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


RANGE = "return document.querySelector('#course .plot').layout.xaxis.range[0].slice(0, 10)"


def test_a_range_of_nights_stands_in_the_address_and_a_night_without_a_file_says_so(
    browser: Chrome, judged: Path, tmp_path: Path
) -> None:
    page = tmp_path / "report" / "motors" / f"{WORN}.html"
    shutil.copytree(judged, tmp_path / "report")
    # As of a motor with more nights than these three.
    content = page.read_text("utf-8")
    page.write_text(content.replace('"ranges":{', '"ranges":{"30":["2026-01-03","2026-01-04"],'))
    visit(browser, page)
    drawn(browser)
    assert browser.execute_script(RANGE) < NIGHTS[0]
    browser.find_element(By.CSS_SELECTOR, "[data-range='30']").click()
    wait(browser, f"{RANGE} === '2026-01-03'")
    assert browser.execute_script("return location.hash") == "#range=30"
    visit(browser, page, f"#{NIGHTS[1]}&range=30")
    assert (wait(browser, NIGHT), browser.execute_script(RANGE)) == (NIGHTS[1], "2026-01-03")
    assert not browser.find_element(By.CSS_SELECTOR, "[data-range='365']").is_enabled()
    assert complaints(browser) == []
    # A night whose file was not copied says so.
    (tmp_path / "report" / "data" / WORN / f"{NIGHTS[2]}.js").unlink()
    browser.find_element(By.ID, "later").click()
    wait(browser, f"{NIGHT} === '{NIGHTS[2]}'")
    assert f"{NIGHTS[2]}.js is not there" in text(browser, "#words")
    assert f"{NIGHTS[2]}.js" in complaints(browser)[0]


def test_motors_are_drawn_in_one_chart_as_they_are_searched(browser: Chrome, judged: Path) -> None:
    visit(browser, judged / "index.html", "#find=cb560&chart=all")
    drawn_motors = "return document.getElementById('overlay').dataset.drawn"
    wait(browser, f"{drawn_motors} === '2'")
    browser.find_element(By.CSS_SELECTOR, "[type=reset]").click()
    wait(browser, f"{drawn_motors} === '{MOTORS}'")
    browser.find_element(By.CSS_SELECTOR, "[data-range='90']").click()
    assert "chart=90" in browser.execute_script("return location.hash")


def test_the_command_that_acknowledges_is_filled_in(browser: Chrome, output: Path) -> None:
    publish_latest(output)
    build_report(demo_fleet(output, WORN), output / "report", config="my/fleet.toml")
    visit(browser, output / "report" / "motors" / f"{WORN}.html")
    drawn(browser)
    browser.find_element(By.CSS_SELECTOR, "details summary").click()
    browser.find_element(By.NAME, "note").send_keys("the customer's rings")
    Select(browser.find_element(By.NAME, "finding")).select_by_value("confirmed")
    browser.find_element(By.CSS_SELECTOR, "#acknowledge button").click()
    wait(browser, "return document.getElementById('copied').textContent")
    command = shlex.split(str(browser.execute_script("return getSelection().toString()")))
    assert command == [
        *("motor-leakage", "ack", "my/fleet.toml", WORN),
        *("--note", "the customer's rings", "--finding", "confirmed"),
    ]


# Strangers' words, small screens

# Would run, were it ever taken for markup, for a part of a script or for a template.
HOSTILE = (
    '</script><script>window.harmed=1</script><img src=x onerror="window.harmed=1">'
    "'\"${window.harmed=1}%{x}<a href='javascript:window.harmed=1'>"
)


# Where a text of a log or a config can stand, by table; of a key it stands before what was there.
WORDS = {
    "nights": ("motor_type", "oil", "oil_circuit", "reason", "sentence", "advice", "log_note"),
    "latest": ("motor_type", "oil", "oil_circuit", "reason", "sentence", "advice", "log_note"),
    "fits": ("interval_status", "fitted_leakage_reason"),
    "parameters": ("reason",),
    "error_budget": ("source",),
    "quality": ("reason",),
    "log_files": ("path", "message"),
    "trends": ("indicator", "unit", "reason"),
    "alarms": ("sentence",),
}


def hostile_output(output: Path) -> None:
    """The tables with a stranger's words in them."""
    for table, names in WORDS.items():
        keys = {column for column in names if column in BY_NAME[table].key}

        def rename(rows: pl.DataFrame, names: Any = names, keys: Any = keys) -> pl.DataFrame:
            mine = rows.filter(motor_id="CB560-01")
            return mine.with_columns(
                (pl.lit(HOSTILE) + pl.col(name) if name in keys else pl.lit(HOSTILE)).alias(name)
                for name in names
            )

        change_table(output, table, rename)


def test_hostile_words_are_shown_and_do_nothing(browser: Chrome, output: Path) -> None:
    hostile_output(output)
    fleet = demo_fleet(output, "CB560-01")
    (spec,) = fleet.motors
    event = Event(date=dt.date(2026, 1, 3), kind="note", note=HOSTILE)
    file = spec.file.model_copy(update={"events": (event,), "motor_type": HOSTILE})
    fleet = replace(fleet, name=HOSTILE, motors=(replace(spec, file=file),))
    build_report(fleet, output / "report")
    visit(browser, output / "report" / "index.html")
    assert browser.find_element(By.TAG_NAME, "h1").text == HOSTILE
    assert complaints(browser) == []
    browser.find_element(By.CSS_SELECTOR, "#fleet tbody a").click()
    drawn(browser)
    for place in ("header", ".marks", "#words"):
        assert HOSTILE in text(browser, place)
    assert browser.find_elements(By.CSS_SELECTOR, "main img, a[href^=javascript], svg a") == []


OVERLAPS = """
const kinds = 'h1, h2, h3, p, .plot, table, dl, #words';
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
# Words above a panel lie on no line: each stands above its panel's axes.
OVER_A_CHART = """
return [...document.querySelectorAll('.plot')].filter((one) => one._fullLayout).flatMap((plot) =>
  plot._fullLayout.annotations.filter((one) => one.y !== 1 || one.yanchor !== 'bottom'));
"""
# The buttons of a chart lie on none of its words.
BUTTONS_ON_WORDS = """
return [...document.querySelectorAll('.modebar')].flatMap((bar) => {
  const box = bar.getBoundingClientRect();
  return [...bar.closest('.plot').querySelectorAll('.annotation-text')]
    .map((words) => [words.textContent, words.getBoundingClientRect()])
    .filter(([, one]) => one.top < box.bottom && one.right > box.left)
    .map(([words]) => words);
});
"""
# Rows that are high, and what is wider than its place.
HIGH = """
return [...document.querySelectorAll('tbody tr, .attention li')]
  .filter((row) => row.checkVisibility() && row.getBoundingClientRect().height > 120)
  .map((row) => row.textContent);
"""
WIDE = """
return [document.documentElement, ...document.querySelectorAll('.scroll, table, li, #words')]
  .filter((one) => one.checkVisibility() && one.scrollWidth > one.clientWidth + 1)
  .map((one) => one.textContent.slice(0, 50));
"""


@pytest.mark.parametrize("page", PAGES)
def test_a_telephone_a_tablet_and_a_desk(browser: Chrome, judged: Path, page: str) -> None:
    """Nothing is wider than its screen, nothing lies on another, no row is high."""
    size = {"height": 1000, "deviceScaleFactor": 1, "mobile": False}
    for place, width in enumerate((390, 768, 1280)):
        resized = {"width": width, **size}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", resized)
        if not place:
            visit(browser, judged / page)
        if page == PAGES[1]:
            drawn(browser)
            wait(browser, FILLED)
            assert browser.execute_script(OVER_A_CHART) == []
            assert browser.execute_script(BUTTONS_ON_WORDS) == []
        for script in (WIDE, OVERLAPS, HIGH):
            assert browser.execute_script(script) == [], width
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_without_scripts_the_pages_say_so_and_hold_the_figures(judged: Path) -> None:
    for page, words in zip(PAGES[:2], (HEADLINE, REASON[1:]), strict=True):
        content = (judged / page).read_text("utf-8")
        assert "need JavaScript" in content.partition("<noscript>")[2].partition("</noscript>")[0]
        assert words in re.sub(r"<script.*?</script>", "", content, flags=re.DOTALL)
