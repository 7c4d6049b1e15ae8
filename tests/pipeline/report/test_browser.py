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
from tests.pipeline.report.conftest import BY_NAME, NOTE, change_table, demo_fleet
from tests.scenarios.fleets import ScenarioFleet

pytestmark = needs_browser

NIGHTS = ["2026-01-02", "2026-01-03", "2026-01-04"]
WORN = "broken"
PAGES = ("index.html", f"motors/{WORN}.html", "glossary.html")
LEAKAGE = "own_leakage_l_per_min"
NIGHT = "return document.body.dataset.night"
# Within the width of a scroll bar.
FILLED = """
const plot = document.querySelector('#course .plot');
return Math.abs(plot.clientWidth - plot.querySelector('.main-svg').clientWidth) < 20;
"""


# The fleet


def page_of(judged: ScenarioFleet, name: str = "index") -> Path:
    return judged.output / "report" / f"{name}.html"


def test_motors_are_searched_and_sorted_and_both_stand_in_the_address(
    browser: Chrome, judged: ScenarioFleet
) -> None:
    visit(browser, page_of(judged))
    newest = judged.newest(WORN)
    assert shown(browser) == ["worn", WORN, "calm"]
    (entry,) = (
        entry
        for entry in browser.find_elements(By.CSS_SELECTOR, ".attention li")
        if f"warning\n{WORN}\n" in entry.text
    )
    assert newest["advice"] in entry.text
    assert f"Acknowledged: {NOTE}" in entry.text
    # A state has its words beside it, and old data are marked, in the fleet's zone.
    cell = browser.find_elements(By.CSS_SELECTOR, "#fleet tbody td:nth-child(2)")[1]
    assert cell.text == f"warning\n{newest['advice']}"
    old = [element.text for element in browser.find_elements(By.CSS_SELECTOR, "time.old")]
    assert old[0].startswith("2026-01-20 23:09\n(")
    assert old[0].endswith(" days ago)")
    find = browser.find_element(By.ID, "find")
    find.send_keys("cb400 calm")
    assert shown(browser) == ["calm"]
    assert browser.find_element(By.ID, "shown").text == "1 of 3 shown"
    # Who is searched for leaves the others above the table, too.
    assert not entry.is_displayed()
    browser.find_element(By.CSS_SELECTOR, "[type=reset]").click()
    wait(browser, "return document.getElementById('shown').textContent === ''")
    header = browser.find_elements(By.CSS_SELECTOR, "#fleet thead th")[3]
    assert header.text.startswith("Leakage at its usual operating point")
    button = header.find_element(By.TAG_NAME, "button")
    by_leakage = sorted(judged.motors, key=lambda name: judged.newest(name)[LEAKAGE])
    for keys, order in ((Keys.ENTER, by_leakage[::-1]), (Keys.SPACE, by_leakage)):
        button.send_keys(keys)
        assert shown(browser) == order
    assert header.get_dom_attribute("aria-sort") == "ascending"
    find.send_keys("warning")
    # The page's own word: the browser's address follows a moment later.
    address = browser.execute_script("return location.hash")
    seen = shown(browser)
    assert len(seen) == 2
    visit(browser, page_of(judged), address)
    assert shown(browser) == seen
    visit(browser, page_of(judged), "#find=none&sort=99%20up&type=%E0<b>")
    assert shown(browser) == []
    assert browser.find_element(By.ID, "nothing").is_displayed()


# A motor


def test_every_chart_is_drawn_before_it_is_scrolled_to(
    browser: Chrome, judged: ScenarioFleet
) -> None:
    visit(browser, page_of(judged, f"motors/{WORN}"))
    wait(browser, NIGHT)
    newest = judged.newest(WORN)
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
    assert newest["sentence"][1:] in browser.find_element(By.ID, "sentence").text
    headline = browser.find_element(By.ID, "headline").text
    assert f" since 15 January 2026, balance sleeve. {newest['advice']}" in headline
    assert "balance sleeve > 99 %" in browser.find_element(By.TAG_NAME, "aside").text
    alarm = judged.table("alarms").filter(motor_id=WORN, to_state="warning").row(0, named=True)
    marks = browser.find_element(By.CSS_SELECTOR, ".marks").text.splitlines()
    assert f"{alarm['night']} change detected: balance sleeve" in marks
    changed = browser.find_element(By.CSS_SELECTOR, "#alarm-table tbody tr").text
    assert f"{alarm['night']} leakage ok warning" in changed
    assert alarm["sentence"] in changed
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


def test_a_motor_s_page_prints_as_a_work_order_on_one_sheet(
    browser: Chrome, judged: ScenarioFleet
) -> None:
    # The fullest page, and that of a motor to which nothing has happened.
    for motor in (WORN, "calm"):
        page = page_of(judged, f"motors/{motor}")
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
        command = f"ack configs/fleet.toml {page.stem}"
        for words in ("Not opened", "Measured gap", "Signature", command):
            assert words in sheet.text
        assert browser.find_element(By.ID, "headline").is_displayed()
        assert browser.find_element(By.ID, "course").is_displayed()
        assert not browser.find_element(By.ID, "night").is_displayed()
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


RANGE = "return document.querySelector('#course .plot').layout.xaxis.range[0].slice(0, 10)"


def test_a_range_of_nights_stands_in_the_address_and_a_night_without_a_file_says_so(
    browser: Chrome, judged: ScenarioFleet, tmp_path: Path
) -> None:
    page, (*_, earlier, last) = tmp_path / "motors" / f"{WORN}.html", judged.nights(WORN)
    nights = [str(row["night"]) for row in (earlier, last)]
    shutil.copytree(judged.output / "report", tmp_path, dirs_exist_ok=True)
    # As of a motor with more nights than these twenty.
    content = page.read_text("utf-8")
    page.write_text(content.replace('"ranges":{', '"ranges":{"30":["2026-01-12","2026-01-21"],'))
    visit(browser, page)
    drawn(browser)
    assert browser.execute_script(RANGE) < NIGHTS[0]
    browser.find_element(By.CSS_SELECTOR, "[data-range='30']").click()
    wait(browser, f"{RANGE} === '2026-01-12'")
    assert browser.execute_script("return location.hash") == "#range=30"
    visit(browser, page, f"#{nights[0]}&range=30")
    assert (wait(browser, NIGHT), browser.execute_script(RANGE)) == (nights[0], "2026-01-12")
    assert not browser.find_element(By.CSS_SELECTOR, "[data-range='365']").is_enabled()
    assert complaints(browser) == []
    # A night whose file was not copied says so.
    (tmp_path / "data" / WORN / f"{nights[1]}.js").unlink()
    browser.find_element(By.ID, "later").click()
    wait(browser, f"{NIGHT} === '{nights[1]}'")
    assert f"{nights[1]}.js is not there" in text(browser, "#words")
    assert f"{nights[1]}.js" in complaints(browser)[0]


def test_motors_are_drawn_in_one_chart_as_they_are_searched(
    browser: Chrome, judged: ScenarioFleet
) -> None:
    visit(browser, page_of(judged), "#find=warning&chart=all")
    drawn_motors = "return document.getElementById('overlay').dataset.drawn"
    wait(browser, f"{drawn_motors} === '2'")
    browser.find_element(By.CSS_SELECTOR, "[type=reset]").click()
    wait(browser, f"{drawn_motors} === '3'")
    browser.find_element(By.CSS_SELECTOR, "[data-range='90']").click()
    assert "chart=90" in browser.execute_script("return location.hash")


def test_the_command_that_acknowledges_is_filled_in(browser: Chrome, judged: ScenarioFleet) -> None:
    visit(browser, page_of(judged, "motors/worn"))
    drawn(browser)
    browser.find_element(By.CSS_SELECTOR, "details summary").click()
    browser.find_element(By.NAME, "note").send_keys("the customer's rings")
    Select(browser.find_element(By.NAME, "finding")).select_by_value("confirmed")
    browser.find_element(By.CSS_SELECTOR, "#acknowledge button").click()
    wait(browser, "return document.getElementById('copied').textContent")
    command = shlex.split(str(browser.execute_script("return getSelection().toString()")))
    assert command == [
        *("motor-leakage", "ack", "configs/fleet.toml", "worn"),
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
  .filter((row) => row.checkVisibility() && row.getBoundingClientRect().height > 160)
  .map((row) => row.textContent);
"""
WIDE = """
return [document.documentElement, ...document.querySelectorAll('.scroll, table, li, #words')]
  .filter((one) => one.checkVisibility() && one.scrollWidth > one.clientWidth + 1)
  .map((one) => one.textContent.slice(0, 50));
"""


@pytest.mark.parametrize("page", PAGES)
def test_a_telephone_a_tablet_and_a_desk(browser: Chrome, judged: ScenarioFleet, page: str) -> None:
    """Nothing is wider than its screen, nothing lies on another, no row is high."""
    size = {"height": 1000, "deviceScaleFactor": 1, "mobile": False}
    for place, width in enumerate((390, 768, 1280)):
        resized = {"width": width, **size}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", resized)
        if not place:
            visit(browser, judged.output / "report" / page)
        if page == PAGES[1]:
            drawn(browser)
            wait(browser, FILLED)
            assert browser.execute_script(OVER_A_CHART) == []
            assert browser.execute_script(BUTTONS_ON_WORDS) == []
        for script in (WIDE, OVERLAPS, HIGH):
            assert browser.execute_script(script) == [], width
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_without_scripts_the_pages_say_so_and_hold_the_figures(judged: ScenarioFleet) -> None:
    newest = judged.newest(WORN)
    for page, words in zip(PAGES[:2], (newest["advice"], newest["sentence"][1:]), strict=True):
        content = (judged.output / "report" / page).read_text("utf-8")
        assert "need JavaScript" in content.partition("<noscript>")[2].partition("</noscript>")[0]
        assert words in re.sub(r"<script.*?</script>", "", content, flags=re.DOTALL)
