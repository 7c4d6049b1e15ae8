"""The pages as a person meets them: opened from the file system in headless Chromium."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.ui import Select, WebDriverWait

from pipeline.report import KnownMotor, ReportRequest, build_report
from pipeline.schema import (
    ALARMS,
    BASELINES,
    CHANGE_POINTS,
    FITS,
    NIGHT_TABLES,
    TREND_TABLES,
    frame,
)
from pipeline.store.tables import night_file, write_table
from pipeline.trends.decisions import Decision, record_decision
from tests.pipeline.report.browser import installed, opened
from tests.pipeline.report.conftest import change_table

pytestmark = pytest.mark.skipif(
    not installed(), reason="Chromium is not installed: Debian's chromium and chromium-driver"
)

NIGHTS = ["2026-01-02", "2026-01-03", "2026-01-04"]
MOTORS = 6
PATIENCE_S = 30
# Would run, were it ever taken for markup, for a part of a script or for a template.
HOSTILE = (
    '</script><script>window.harmed=1</script><img src=x onerror="window.harmed=1">'
    "'\"${window.harmed=1}%{x}<a href='javascript:window.harmed=1'>"
)


@pytest.fixture(scope="module")
def browser() -> Iterator[Chrome]:
    with opened() as chrome:
        yield chrome


def visit(browser: Chrome, page: Path, fragment: str = "") -> None:
    """Open a page anew; whatever the console said before is forgotten."""
    browser.get("about:blank")
    browser.get_log("browser")
    browser.get(page.resolve().as_uri() + fragment)


def complaints(browser: Chrome) -> list[str]:
    """Messages of the console, and a mark if a text was run as code."""
    said = [entry["message"] for entry in browser.get_log("browser")]
    return [*said, *(["harmed"] if browser.execute_script("return window.harmed") else [])]


def wait(browser: Chrome, script: str) -> Any:
    """The value of a script, as soon as it has one."""
    return WebDriverWait(browser, PATIENCE_S, 0.05).until(lambda one: one.execute_script(script))


def drawn(browser: Chrome) -> dict[str, str]:
    """Result of each figure: a chart, or a reason why there is none."""
    wait(browser, "return document.body.dataset.night")
    browser.execute_script("motorLeakage.drawAll()")
    return wait(
        browser,
        "const all = [...document.querySelectorAll('figure.chart')];"
        "return all.every((one) => one.dataset.drawn)"
        " && Object.fromEntries(all.map((one) => [one.id, one.dataset.drawn]))",
    )


def shown(browser: Chrome) -> list[str]:
    """Ids of the motors that the fleet page shows, from the top."""
    rows = browser.find_elements(By.CSS_SELECTOR, "#fleet tbody tr")
    return [row.find_element(By.TAG_NAME, "a").text for row in rows if row.is_displayed()]


# The fleet


def test_fleet_page_lists_all_motors_and_says_nothing_on_the_console(
    browser: Chrome, report: Path
) -> None:
    visit(browser, report / "index.html")
    assert len(shown(browser)) == MOTORS
    pictures = browser.find_elements(By.CSS_SELECTOR, "td svg.sparkline")
    assert len(pictures) == MOTORS
    assert all(one.get_attribute("aria-label").startswith("Leakage ") for one in pictures)
    assert complaints(browser) == []


def test_filter_by_text_type_and_state(browser: Chrome, report: Path) -> None:
    visit(browser, report / "index.html")
    every = shown(browser)
    find = browser.find_element(By.ID, "find")
    find.send_keys("cb560")
    assert sorted(shown(browser)) == ["CB560-01", "CB560-02"]
    assert browser.find_element(By.ID, "shown").text == f"2 of {MOTORS} shown"
    find.send_keys("-02")
    assert shown(browser) == ["CB560-02"]
    find.send_keys(" nothing")
    assert shown(browser) == []
    browser.find_element(By.ID, "reset").click()
    wait(browser, "return document.getElementById('nothing').hidden")
    assert shown(browser) == every
    Select(browser.find_element(By.ID, "type")).select_by_visible_text("CB1120")
    assert sorted(shown(browser)) == ["CB1120-01", "CB1120-02"]
    for box in browser.find_elements(By.NAME, "state"):
        box.click()
    assert shown(browser) == []
    assert complaints(browser) == []


def test_sort_both_ways_by_keyboard_with_what_is_absent_last(browser: Chrome, output: Path) -> None:
    def forget(rows: pl.DataFrame) -> pl.DataFrame:
        unknown = pl.when(pl.col("motor_id") != "CB1120-02").then("value")
        return rows.with_columns(value=unknown)

    change_table(output, "trends", forget)
    build_report(ReportRequest(output, output / "report"))
    visit(browser, output / "report" / "index.html")
    header = browser.find_elements(By.CSS_SELECTOR, "#fleet thead th")[2]
    assert header.text.startswith("Leakage")
    button = header.find_element(By.TAG_NAME, "button")

    def values() -> list[float]:
        """Those that are there; what is absent comes last."""
        cells = browser.find_elements(By.CSS_SELECTOR, "#fleet tbody td:nth-child(3)")
        told = [cell.get_dom_attribute("data-value") for cell in cells]
        known = [value for value in told if value]
        assert told[: len(known)] == known
        return [float(value) for value in known]

    button.send_keys(Keys.ENTER)
    assert header.get_dom_attribute("aria-sort") == "ascending"
    assert values() == sorted(values())
    button.send_keys(Keys.SPACE)
    assert header.get_dom_attribute("aria-sort") == "descending"
    assert values() == sorted(values(), reverse=True)
    change = browser.find_elements(By.CSS_SELECTOR, "#fleet thead th button")[3]
    change.click()  # three nights are too few for any change: all absent, in their order
    assert len(shown(browser)) == MOTORS
    assert complaints(browser) == []


def test_a_motor_s_page_is_reached_by_keyboard(browser: Chrome, report: Path) -> None:
    visit(browser, report / "index.html")
    browser.find_element(By.LINK_TEXT, "CB560-01").send_keys(Keys.ENTER)
    assert wait(browser, "return document.body.dataset.night") == NIGHTS[-1]
    assert browser.find_element(By.TAG_NAME, "h1").text == "CB560-01"
    browser.find_element(By.CSS_SELECTOR, "header nav a").click()
    assert len(shown(browser)) == MOTORS
    assert complaints(browser) == []


# A motor


def identified(rows: pl.DataFrame) -> pl.DataFrame:
    """Parameters as if the demo's hour of logs had determined them."""
    told = pl.col("parameter").str.contains("^(K|share)_")
    value = pl.coalesce("value", pl.lit(0.25))
    figures = {"value": value, "lower": 0.9 * value, "upper": 1.1 * value}
    return rows.with_columns(
        pl.when(told).then(pl.lit("identified")).otherwise("verdict").alias("verdict"),
        *(
            pl.when(told).then(figure).otherwise(name).alias(name)
            for name, figure in figures.items()
        ),
    )


def test_every_figure_is_drawn(browser: Chrome, output: Path) -> None:
    """Each when it is scrolled to."""
    change_table(output, "parameters", identified)
    night = dt.date.fromisoformat(NIGHTS[0])
    frozen = {"motor_id": "CB560-01", "indicator": "K_piston_ring", "night": night, "start": night}
    path = night_file(output, BASELINES, night)
    write_table(path, frame(BASELINES, [frozen | {"mean": 1e-13}]))
    build_report(ReportRequest(output, output / "report"))
    visit(browser, output / "report" / "motors" / "CB560-01.html")
    wait(browser, "return document.body.dataset.night")
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
        marks = figure.find_elements(By.CSS_SELECTOR, ".plot .scatterlayer path, .bars path")
        assert marks, name
    assert complaints(browser) == []


def test_a_table_stands_under_each_chart_and_can_be_saved(browser: Chrome, report: Path) -> None:
    visit(browser, report / "motors" / "CB560-01.html")
    for name, state in drawn(browser).items():
        details = browser.find_element(By.CSS_SELECTOR, f"#{name} details")
        assert details.is_displayed() == (state == "chart")
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
    assert complaints(browser) == []


def test_a_night_is_chosen_from_the_list_by_button_by_address_and_in_the_chart(
    browser: Chrome, report: Path
) -> None:
    visit(browser, report / "motors" / "CB400-02.html")
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
    drawn(browser)
    browser.execute_script(
        "document.querySelector('#course-leakage .plot')"
        ".emit('plotly_click', {points: [{x: arguments[0]}]})",
        NIGHTS[0],
    )
    wait(browser, f"return document.body.dataset.night === '{NIGHTS[0]}'")
    assert complaints(browser) == []


def test_an_address_that_is_no_night_leads_to_the_newest(browser: Chrome, report: Path) -> None:
    visit(browser, report / "motors" / "CB400-02.html", "#../../../etc/passwd%E0")
    assert wait(browser, "return document.body.dataset.night") == NIGHTS[2]
    assert complaints(browser) == []


def test_keys_zoom_and_move_and_show_all_again(browser: Chrome, report: Path) -> None:
    visit(browser, report / "motors" / "CB400-02.html")
    drawn(browser)
    plot = browser.find_element(By.CSS_SELECTOR, "#course-leakage .plot")

    def span() -> list[float]:
        script = "return arguments[0]._fullLayout.xaxis.range.map((end) => Date.parse(end))"
        low, high = browser.execute_script(script, plot)
        return [low, high]

    whole = span()
    plot.send_keys("+")
    zoomed = span()
    assert zoomed[1] - zoomed[0] == pytest.approx((whole[1] - whole[0]) / 2, rel=1e-3)
    plot.send_keys(Keys.ARROW_RIGHT)
    assert span()[0] > zoomed[0]
    plot.send_keys(Keys.HOME)
    assert span() == pytest.approx(whole)
    assert complaints(browser) == []


def test_no_button_sends_a_chart_away(browser: Chrome, report: Path) -> None:
    visit(browser, report / "motors" / "CB400-02.html")
    drawn(browser)
    buttons = browser.find_elements(By.CSS_SELECTOR, ".modebar-btn")
    titles = {one.get_dom_attribute("data-title") for one in buttons}
    wanted = {"Zoom", "Pan", "Zoom in", "Zoom out", "Reset axes", "Download plot as a PNG"}
    assert titles == wanted
    assert browser.find_elements(By.CSS_SELECTOR, "[href^=http], [src^=http]") == []
    assert complaints(browser) == []


def test_a_night_whose_file_was_not_copied_says_so(
    browser: Chrome, output: Path, tmp_path: Path
) -> None:
    build_report(ReportRequest(output, tmp_path / "r", motors=("CB560-01",)))
    (tmp_path / "r" / "data" / "CB560-01" / f"{NIGHTS[2]}.js").unlink()
    visit(browser, tmp_path / "r" / "motors" / "CB560-01.html")
    told = "return document.getElementById('outcome').textContent"
    assert f"{NIGHTS[2]}.js is not there" in wait(browser, told)
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
    change_table(
        output,
        "input_files",
        lambda rows: rows.with_columns(
            *(pl.lit(value, rows.schema[name]).alias(name) for name, value in unread.items())
        ),
    )
    for table in (*NIGHT_TABLES, *TREND_TABLES):
        if table.name not in ("fits", "input_files", "quality"):
            change_table(output, table.name, lambda rows: rows.clear())
    folder = output / "report"
    build_report(ReportRequest(output, folder, known={"new": KnownMotor("CB400")}))
    visit(browser, folder / "motors" / "CB560-01.html")
    figures = drawn(browser)
    assert {name for name, state in figures.items() if state == "chart"} == {"refused"}
    assert reason in browser.find_element(By.ID, "why").text
    assert reason in browser.find_element(By.ID, "outcome").text
    assert "failed" in browser.find_element(By.ID, "files").text
    assert complaints(browser) == []
    visit(browser, folder / "motors" / "new.html")
    assert "No night of this motor" in browser.find_element(By.ID, "why").text
    assert complaints(browser) == []


# Names of others


def hostile_output(output: Path) -> Path:
    """The tables with a stranger's words wherever a name or a text can stand."""
    texts = {
        "fits": ("motor_type", "oil", "reason", "reference_reason", "interval_status"),
        "parameters": ("reason",),
        "sensitivities": ("source",),
        "starts": ("reason",),
        "quality": ("reason",),
        "input_files": ("path", "message"),
        "trends": ("state_reason", "gated_reason", "path_reason", "unit"),
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
    assert complaints(browser) == []


def text(browser: Chrome, selector: str) -> str:
    """Text of all elements that a selector finds, shown or not."""
    found: list[WebElement] = browser.find_elements(By.CSS_SELECTOR, selector)
    return " ".join(one.get_attribute("textContent") or "" for one in found)


# Poor fits


def test_a_poor_fit_is_marked_wherever_it_is_shown(browser: Chrome, output: Path) -> None:
    mine = (pl.col("motor_id") == "CB560-01") & pl.col("is_primary")

    def poor(rows: pl.DataFrame) -> pl.DataFrame:
        fit = pl.when(mine).then(-1295.0).otherwise("validation_fit_percent")
        return rows.with_columns(validation_fit_percent=fit)

    change_table(output, "fits", poor, NIGHTS[2])
    build_report(ReportRequest(output, output / "report"))
    visit(browser, output / "report" / "index.html")
    marked = browser.find_elements(By.CSS_SELECTOR, "#fleet .poor")
    assert [one.find_element(By.XPATH, "./..").text.split("\n")[0] for one in marked] == [
        "−1295 poor"
    ]
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
    assert complaints(browser) == []


# Trends


def test_trends_alarms_and_what_was_said_are_shown(browser: Chrome, output: Path) -> None:
    """As a run leaves them that has judged thirty nights; the demo's three are too few."""
    key = {"motor_id": "CB560-01", "indicator": "K_piston_ring"}
    nights = [dt.date.fromisoformat(night) for night in NIGHTS]

    def judge(rows: pl.DataFrame) -> pl.DataFrame:
        mine = (pl.col("motor_id") == key["motor_id"]) & (pl.col("indicator") == key["indicator"])
        figures: dict[str, Any] = {
            "value": 7.5e-14,
            "lower": None,
            "upper": None,
            "baseline_mean": 5e-14,
            "deviation_percent": 50.0,
            # Too few nights since the change for days to a limit; its levels stand.
            "limit": None,
            "warning_limit": 5.75e-14,
            "alarm_limit": 6.5e-14,
            "cusum": 9.0,
            "cusum_limit": 7.0,
            "slope_per_year": 4e-14,
            "slope_per_year_lower": 3e-14,
            "slope_per_year_upper": 5e-14,
            "days_to_limit_status": "already_crossed",
            "state": "alarm",
            "state_reason": "piston ring gap +50 %",
        }
        return rows.with_columns(
            pl.when(mine).then(pl.lit(value, rows.schema[name])).otherwise(name).alias(name)
            for name, value in figures.items()
        )

    change_table(output, "trends", judge)
    change = key | {"night": nights[2], "change_night": nights[1], "size_percent": 50.0}
    alarm = key | {"night": nights[2], "time": dt.datetime(2026, 1, 4, 6, tzinfo=dt.UTC)}
    alarm |= {"from_state": "ok", "to_state": "alarm", "reason": "piston ring gap +50 %"}
    baseline = key | {"night": nights[1], "start": nights[0], "end": nights[1], "mean": 5e-14}
    for table, row in {
        CHANGE_POINTS: change | {"model": "step"},
        ALARMS: alarm,
        BASELINES: baseline,
    }.items():
        write_table(night_file(output, table, nights[2]), frame(table, [row]))
    said = dt.datetime(2026, 1, 5, 9, tzinfo=dt.UTC)
    note = "a new ring <b>is ordered</b>"
    record_decision(
        output,
        Decision(key["motor_id"], key["indicator"], said, "acknowledged", nights[2], note=note),
    )
    build_report(ReportRequest(output, output / "report"))
    visit(browser, output / "report" / "index.html")
    assert shown(browser)[0] == key["motor_id"]
    first = browser.find_element(By.CSS_SELECTOR, "#fleet tbody tr").text
    assert f"alarm\npiston ring gap +50 % (acknowledged: {note})" in first
    browser.find_element(By.LINK_TEXT, key["motor_id"]).click()
    assert drawn(browser)["trend-course"] == "chart"
    menu = Select(browser.find_element(By.CSS_SELECTOR, "#trend-course select"))
    assert menu.first_selected_option.text == "piston ring leakage, m³: alarm"
    assert text(browser, "#trend-course .annotation-text") == "+50 % (step)"
    lines = dict(
        browser.execute_script(
            "return document.querySelector('#trend-course .plot').data.map((one) => "
            "[one.name, one.y.at(-1)])"
        )
    )
    # The interval's outline has no name.
    assert [name for name in lines if name] == [
        "piston ring leakage",
        "baseline",
        "level of warning",
        "level of alarm",
        "CUSUM",
        "its limit",
    ]
    assert lines["level of warning"] == pytest.approx(5.75e-14)
    assert lines["level of alarm"] == pytest.approx(6.5e-14)
    row = browser.find_element(By.CSS_SELECTOR, "#trend-table tbody tr").text
    assert "4.00e−14 (3.00e−14 to 5.00e−14)" in row
    assert "already crossed" in row
    assert "no change alarm piston ring gap +50 %" in " ".join(
        browser.find_element(By.CSS_SELECTOR, "#alarm-table tbody tr").text.split()
    )
    assert note in browser.find_element(By.ID, "decision-table").text
    menu.select_by_index(1)
    assert drawn(browser)["trend-course"] in ("chart", "absent")
    assert complaints(browser) == []
