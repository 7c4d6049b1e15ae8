"""A motor's page in headless Chromium, opened from the file system."""

from __future__ import annotations

import shutil
from pathlib import Path

import polars as pl
import pytest
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select, WebDriverWait

from pipeline.report.build import KnownMotor, ReportRequest, build_report
from pipeline.schema import FITS, NIGHT_TABLES, TREND_TABLES, frame
from tests.pipeline.report.browser import (
    PATIENCE_S,
    complaints,
    drawn,
    needs_browser,
    text,
    visit,
    wait,
)
from tests.pipeline.report.conftest import change_table, rows_with
from tests.pipeline.report.judged import NIGHTS, NOTE, REASON, WORN

pytestmark = needs_browser


def test_every_figure_is_drawn_when_it_is_scrolled_to(browser: Chrome, told: Path) -> None:
    visit(browser, told / "motors" / "CB560-01.html")
    wait(browser, "return document.body.dataset.night")
    browser.execute_script("document.getElementById('analyst').open = true")
    figures = browser.find_elements(By.CSS_SELECTOR, "figure.chart")
    assert len(figures) == 17
    assert figures[-1].get_dom_attribute("data-drawn") is None
    for figure in figures:
        browser.execute_script("arguments[0].scrollIntoView()", figure)
        WebDriverWait(browser, PATIENCE_S, 0.05).until(
            lambda _, one=figure: one.get_dom_attribute("data-drawn")
        )
        name = figure.get_dom_attribute("id")
        assert figure.get_dom_attribute("data-drawn") == "chart", name
        drawing = ".plot .scatterlayer path, .bars path, .heatmaplayer image"
        marks = figure.find_elements(By.CSS_SELECTOR, drawing)
        assert marks, name


def test_a_table_stands_under_each_chart_and_can_be_saved(browser: Chrome, report: Path) -> None:
    visit(browser, report / "motors" / "CB560-01.html")
    for name, state in drawn(browser).items():
        details = browser.find_element(By.CSS_SELECTOR, f"#{name} details")
        assert details.is_displayed() == (state == "chart" and name != "course-nights")
    browser.execute_script(
        "document.querySelectorAll('.chart details').forEach((one) => { one.open = true; })"
    )
    tables = wait(
        browser,
        "const all = [...document.querySelectorAll('.chart details:not([hidden])')];"
        "return all.every((one) => one.querySelector('tbody tr')) && all.map((one) => ["
        "  one.querySelectorAll('thead th').length,"
        "  one.querySelector('tbody tr').cells.length,"
        "  one.querySelector('button').textContent,"
        "])",
    )
    assert len(tables) >= 12
    for n_names, n_cells, button in tables:
        assert n_names == n_cells > 1
        assert button == "Save as CSV"


def test_a_night_is_chosen_from_the_list_by_button_by_address_and_in_the_chart(
    browser: Chrome, report: Path
) -> None:
    # An address that is no night leads to the newest.
    visit(browser, report / "motors" / "CB400-02.html", "#../../../etc/passwd%E0")
    assert wait(browser, "return document.body.dataset.night") == NIGHTS[2]
    Select(browser.find_element(By.ID, "choose")).select_by_value(NIGHTS[0])
    wait(browser, f"return document.body.dataset.night === '{NIGHTS[0]}'")
    assert f"Night of {NIGHTS[0]}: fitted" in browser.find_element(By.ID, "outcome").text
    assert not browser.find_element(By.ID, "earlier").is_enabled()
    browser.find_element(By.ID, "later").send_keys(Keys.ENTER)
    wait(browser, f"return document.body.dataset.night === '{NIGHTS[1]}'")
    browser.back()
    wait(browser, f"return document.body.dataset.night === '{NIGHTS[0]}'")
    visit(browser, report / "motors" / "CB400-02.html", f"#{NIGHTS[1]}")
    assert wait(browser, "return document.body.dataset.night") == NIGHTS[1]
    top = "return document.getElementById('night').getBoundingClientRect().top"
    assert 0 <= browser.execute_script(top) < 100
    drawn(browser)
    browser.execute_script("window.scrollTo(0, 0)")
    browser.execute_script(
        "document.querySelector('#course-nights .plot')"
        ".emit('plotly_click', {points: [{x: arguments[0]}]})",
        NIGHTS[0],
    )
    wait(browser, f"return document.body.dataset.night === '{NIGHTS[0]}'")
    # It comes into view, and is marked there and in all charts over the nights.
    assert 0 <= browser.execute_script(top) < 100
    assert browser.find_elements(By.CSS_SELECTOR, "#night.chosen")
    marked = browser.execute_script(
        "return [...document.querySelectorAll('[data-drawn=chart] .over-nights')].map((one) =>"
        " one.layout.shapes.filter((shape) => shape.name === 'chosen night').map((s) => s.x0))"
    )
    assert len(marked) >= 4
    assert all(one == [NIGHTS[0]] for one in marked)


SPANS = (
    "return [...document.querySelectorAll('[data-drawn=chart] .over-nights')].map((one) =>"
    " one._fullLayout.xaxis.range.map((end) => String(end).slice(0, 10)).join(' '))"
)


def test_keys_zoom_all_charts_over_the_nights_and_no_button_sends_one_away(
    browser: Chrome, report: Path
) -> None:
    visit(browser, report / "motors" / "CB400-02.html")
    drawn(browser)
    plot = browser.find_element(By.CSS_SELECTOR, "#course-leakage .plot")

    def span() -> list[float]:
        script = "return arguments[0]._fullLayout.xaxis.range.map((end) => Date.parse(end))"
        low, high = browser.execute_script(script, plot)
        return [low, high]

    whole = span()
    assert len(browser.execute_script(SPANS)) >= 4
    assert set(browser.execute_script(SPANS)) == {"2026-01-01 2026-01-05"}
    plot.send_keys("+")
    zoomed = span()
    assert zoomed[1] - zoomed[0] == pytest.approx((whole[1] - whole[0]) / 2, rel=1e-3)
    assert set(wait(browser, SPANS)) == {"2026-01-02 2026-01-04"}
    plot.send_keys(Keys.ARROW_RIGHT)
    assert span()[0] > zoomed[0]
    plot.send_keys(Keys.HOME)
    assert set(wait(browser, SPANS)) == {"2026-01-01 2026-01-05"}
    buttons = browser.find_elements(By.CSS_SELECTOR, ".modebar-btn")
    wanted = {"Zoom", "Pan", "Zoom in", "Zoom out", "Reset axes", "Download plot as a PNG"}
    assert {one.get_dom_attribute("data-title") for one in buttons} == wanted
    assert browser.find_elements(By.CSS_SELECTOR, "[href^=http], [src^=http]") == []


def test_a_night_whose_file_was_not_copied_says_so(
    browser: Chrome, output: Path, tmp_path: Path
) -> None:
    build_report(ReportRequest(output, tmp_path / "r", motors=("CB560-01",)))
    (tmp_path / "r" / "data" / "CB560-01" / f"{NIGHTS[2]}.js").unlink()
    visit(browser, tmp_path / "r" / "motors" / "CB560-01.html")
    told = "return document.getElementById('outcome').textContent"
    assert f"{NIGHTS[2]}.js is not there" in wait(browser, told)
    assert f"{NIGHTS[2]}.js" in complaints(browser)[0]
    build_report(ReportRequest(output, tmp_path / "r", motors=("CB560-01",), nights=1))
    visit(browser, tmp_path / "r" / "motors" / "CB560-01.html", f"#{NIGHTS[0]}")
    assert "was made with fewer nights" in wait(browser, told)


def test_motors_without_a_good_night_or_any_have_pages_that_say_why(
    browser: Chrome, output: Path
) -> None:
    reason = "CB560-01.mcap: the end is missing"
    known = ("motor_id", "motor_type", "night", "flushing_mode", "is_primary")
    failed = {"status": "failed", "reason": reason, "error_code": "log_truncated"}

    def fail(rows: pl.DataFrame) -> pl.DataFrame:
        kept = rows.filter(motor_id="CB560-01").select(known).to_dicts()
        return frame(FITS, [row | failed for row in kept])

    change_table(output, "fits", fail)
    unread = {"status": "failed", "rows": None, "first_time": None, "last_time": None}
    change_table(output, "input_files", rows_with("CB560-01", **unread))
    for table in (*NIGHT_TABLES, *TREND_TABLES):
        if table.name not in ("fits", "input_files", "quality"):
            change_table(output, table.name, lambda rows: rows.clear())
    shutil.rmtree(output / "tables" / "latest")
    folder = output / "report"
    build_report(ReportRequest(output, folder, known={"new": KnownMotor("CB400")}))
    visit(browser, folder / "motors" / "CB560-01.html")
    charts = [name for name, state in drawn(browser).items() if state == "chart"]
    assert charts == ["course-nights", "refused"]
    assert reason in browser.find_element(By.ID, "why").text
    assert reason in browser.find_element(By.ID, "outcome").text
    assert "failed" in browser.find_element(By.ID, "files").text
    assert complaints(browser) == []
    visit(browser, folder / "motors" / "new.html")
    assert "No night of this motor" in browser.find_element(By.ID, "why").text


def test_a_poor_fit_is_marked_wherever_it_is_shown(browser: Chrome, output: Path) -> None:
    change_table(output, "fits", rows_with("CB560-01", validation_fit_percent=-1295.0), NIGHTS[2])
    build_report(ReportRequest(output, output / "report"))
    visit(browser, output / "report" / "index.html")
    browser.find_element(By.LINK_TEXT, "CB560-01").click()
    drawn(browser)
    assert text(browser, "#quality tr:nth-child(2)").endswith("−1295 poor%")
    assert "mean of these samples describes them better" in text(browser, "#quality")
    assert "fit −1295 % (poor)" in text(browser, "#fit-validation .legendtext")
    assert "poor" not in text(browser, "#fit-training .legendtext")
    assert browser.execute_script(
        "return document.querySelector('#course-fit .plot').data.at(-1).text"
    ) == ["on validation data −1295 %, poor"]
    browser.execute_script("document.querySelector('#course-fit details').open = true")
    last = wait(browser, "return document.querySelector('#course-fit tbody tr:last-child')")
    assert "on validation data" in last.text


def names(browser: Chrome, chart: str) -> list[str]:
    """Names of a chart's lines; an interval's outline has none."""
    script = f"return document.querySelector('#{chart} .plot').data.map((one) => one.name)"
    return [name for name in browser.execute_script(script) if name]


def test_the_first_screen_has_sentence_leakage_evidence_and_gaps(
    browser: Chrome, told: Path
) -> None:
    visit(browser, told / "motors" / f"{WORN}.html")
    figures = drawn(browser)
    assert f"L{REASON[1:]}." in browser.find_element(By.ID, "sentence").text
    charts = ("course-leakage", "course-evidence", "course-gaps", "course-nights")
    assert [figures[name] for name in charts] == ["chart"] * 4
    assert names(browser, "course-leakage") == ["drain flow, measured", "leakage", "baseline"]
    assert names(browser, "course-evidence") == ["evidence", "limit"]
    assert names(browser, "course-gaps") == ["balance sleeve"]
    # 9.1 is the limit; evidence far beyond it is cut, and its table has it whole.
    evidence = "return document.querySelector('#course-evidence .plot').data[0].y[0]"
    assert browser.execute_script(evidence) == pytest.approx(2.5 * 9.1, rel=1e-6)
    aside = browser.find_element(By.TAG_NAME, "aside").text
    for words in ("balance sleeve 95", "+21.0\n+17.0 to +25.0", "0.40"):
        assert words in aside
    marked = browser.execute_script(
        "return document.querySelector('#course-leakage .plot').layout.annotations"
        ".map((one) => one.text)"
    )
    assert marked == ["alarm", "balance sleeve"]


def test_a_young_motor_shows_its_drain_flow_and_says_what_it_waits_for(
    browser: Chrome, told: Path
) -> None:
    visit(browser, told / "motors" / "CB560-02.html")
    figures = drawn(browser)
    assert "3 of 8 nights" in browser.find_element(By.ID, "sentence").text
    assert names(browser, "course-leakage") == ["drain flow, measured"]
    assert figures["course-evidence"] == figures["course-gaps"] == "absent"


def test_other_figures_alarms_and_what_was_said_are_shown(browser: Chrome, told: Path) -> None:
    visit(browser, told / "motors" / f"{WORN}.html")
    assert drawn(browser)["shown-course"] == "chart"
    row = browser.find_element(By.CSS_SELECTOR, "#shown-table tbody tr").get_property("textContent")
    assert "balance sleeve leakage coefficient" in row
    assert "4 (3 to 5)" in row
    assert "already crossed" in row
    changed = browser.find_element(By.CSS_SELECTOR, "#alarm-table tbody tr").text
    assert f"leakage ok alarm {REASON}" in " ".join(changed.split())
    assert NOTE in browser.find_element(By.ID, "decision-table").text
