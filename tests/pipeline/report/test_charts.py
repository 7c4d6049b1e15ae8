"""The charts of a motor and of a night, and how Plotly gets them."""

from __future__ import annotations

import datetime as dt
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.config.motors import Event
from pipeline.report.charts import Chart, Line, Mark, Panel, night_chart, watch_chart
from pipeline.report.fleet_page import HEIGHT, MARGIN, WIDTH, sparkline
from pipeline.report.plotly_json import figure, numbers, script_json
from pipeline.schema import PREDICTIONS
from pipeline.store.tables import night_file, read_table
from tests.pipeline.report.nights import (
    FIRST,
    ONE_DAY,
    baseline,
    fit,
    history,
    trend,
    unfitted,
    watch,
)

PATHS = ("piston_ring", "balance_piston", "balance_sleeve", "cam_roller")


def alarm(number: int, to_state: str, indicator: str = "leakage") -> dict[str, Any]:
    row = {"motor_id": "M", "night": FIRST + number * ONE_DAY, "indicator": indicator}
    row |= {"time": dt.datetime(2026, 1, 1 + number, 6, tzinfo=dt.UTC), "from_state": "ok"}
    return row | {"to_state": to_state, "reason": f"night {number}"}


def lines(chart: Chart, title: str) -> dict[str, Line]:
    (panel,) = [one for one in chart.panels if one.title.startswith(title)]
    return {one.name: one for one in panel.lines}


def test_the_chart_of_a_motor_has_the_watch_s_figures_and_those_of_the_nights_own_fits() -> None:
    nights = [watch(n, 2.0 + n, evidence_limit=9.1) for n in range(3)]
    nights[0] |= {"evidence": -np.inf}
    nights[1] |= {"evidence": 4.0, "told_on": FIRST + ONE_DAY, "goes_on": False, "cause": "tank"}
    nights[2] |= {"evidence": 80.0, "told_on": FIRST + ONE_DAY, "goes_on": False}
    nights[2] |= {"cause": "balance_sleeve"}
    gated = {"gated_reason": "too little of it is known"}
    gap = "gap_change_balance_sleeve"
    trends = [trend(n, gap, float(n), **(gated if n == 1 else {})) for n in range(3)]
    motor = history([fit(n) for n in range(3)], nights, trends, baselines=[baseline(2.0)])
    changes = [alarm(1, "warning"), alarm(2, "alarm"), alarm(2, "alarm", "flow_zero")]
    event = Event(date=FIRST, kind="oil_change", oil="vg68", note="of the whole tank")
    chart = watch_chart(motor, PATHS, [event], changes)
    leakage = lines(chart, "Leakage at its own conditions")
    assert leakage["leakage"].value.tolist() == [2.0, 3.0, 4.0]
    assert leakage["baseline"].value.tolist() == [2.0] * 3
    evidence = lines(chart, "Evidence")["evidence"]
    # Far beyond the limit it is cut, and its words have all of it; none is no number.
    assert evidence.value.tolist() == pytest.approx([np.nan, 4.0, 2.5 * 9.1], nan_ok=True)
    assert evidence.words[2] == "80.0"
    sleeve = lines(chart, "Change of the gap")["balance sleeve"]
    assert sleeve.value.tolist() == pytest.approx([0.0, np.nan, 2.0], nan_ok=True)
    assert sleeve.colour == "#009e73"  # third of Okabe and Ito's here, wherever the path is shown
    assert chart.shaded == ((FIRST, FIRST + ONE_DAY),)
    # A change goes by its last cause, an alarm by its own night.
    assert [(one.night - FIRST, one.words) for one in chart.marks] == [
        (0 * ONE_DAY, "oil change: of the whole tank"),
        (ONE_DAY, "change detected: balance sleeve"),
        (2 * ONE_DAY, "alarm"),
    ]


def test_a_motor_without_a_baseline_shows_its_drain_flow_under_its_own_name() -> None:
    motor = history([fit(0), unfitted(1, "failed", "the log is cut"), fit(2)])
    chart = watch_chart(motor, ())
    assert [one.title for one in chart.panels] == ["Drain flow, mean of the night"]
    (flow,) = lines(chart, "Drain flow").values()
    assert flow.value.tolist() == pytest.approx([5.0, np.nan, 5.0], nan_ok=True)
    assert figure(watch_chart(history([]), ())) == {}


def test_noise_of_the_leakage_looks_like_noise() -> None:
    """An axis reaches 15 % of the middle value, 2.01, each way, and a twentieth of it beyond."""
    motor = history([fit(n) for n in range(3)], [watch(n, 2.0 + 0.01 * n) for n in range(3)])
    (panel,) = watch_chart(motor, ()).panels
    assert panel.ends == pytest.approx((1.67835, 2.34165))
    wide = [watch(n, 2.0, own_leakage_lower=1.0, own_leakage_upper=3.0 - n) for n in range(2)]
    (panel,) = watch_chart(history([fit(n) for n in range(2)], wide), ()).panels
    assert panel.ends == pytest.approx((1.0, 2.33))


def test_a_night_of_the_watch_without_a_fit_is_none_of_the_motor_s_nights() -> None:
    motor = history([fit(n) for n in range(3)], [watch(1, 5.0), watch(7, 9.0)])
    assert motor.leakage[0].tolist() == pytest.approx([np.nan, 5.0, np.nan], nan_ok=True)


def test_samples_of_a_night_are_those_of_the_table_broken_where_some_are_missing(
    fitted_output: Path,
) -> None:
    path = night_file(fitted_output, PREDICTIONS, dt.date(2026, 1, 3))
    rows = read_table(path, PREDICTIONS).filter(motor_id="CB560-02")
    chart = night_chart(rows)
    flow = lines(chart, "Drain flow")
    measured = flow["measured"].value
    np.testing.assert_array_equal(measured[~np.isnan(measured)], rows["measured_l_per_min"])
    for part in ("training", "validation"):
        model = flow[f"model, {part} data"].value
        expected = rows.filter(part=part)["predicted_l_per_min"]
        np.testing.assert_array_equal(model[~np.isnan(model)], expected)
    start = rows["time"][0]
    even = rows[:100].with_columns(time=start + pl.int_range(100) * dt.timedelta(seconds=1))
    broken = lines(night_chart(pl.concat([even[:30], even[80:]])), "Speed")["Speed"].value
    assert np.flatnonzero(np.isnan(broken)).tolist() == [30]
    assert night_chart(rows.clear()).panels == ()


# Plotly's JSON


def test_every_panel_has_its_place_and_every_event_its_number() -> None:
    time = np.array(["2026-01-01", "2026-01-03"], dtype="datetime64[D]")
    hostile = "<b>%{x} & co"
    value, lower, upper = np.array([[1.0, 2.0], [0.5, 1.0], [1.25, 4.0]])
    line = Line(hostile, value, "#123456", lower, upper, words=(hostile, ""))
    panels = tuple(Panel(f"panel {n}", "%", (line, line)) for n in range(3))
    marks = tuple(Mark(FIRST + n * ONE_DAY, "alarm", "#000000") for n in range(3))
    made = figure(Chart(time, panels, ((FIRST, FIRST + ONE_DAY),), marks))
    assert made["x"] == ["2026-01-01", "2026-01-03"]
    assert [one["yaxis"] for one in made["data"]] == ["y", "y", "y2", "y2", "y3", "y3"]
    bars = made["data"][0]["error_y"]
    assert (bars["array"], bars["arrayminus"]) == ([0.25, 2.0], [0.5, 1.0])
    layout = made["layout"]
    domains = [layout[f"yaxis{n}"]["domain"] for n in ("", "2", "3")]
    assert 1.0 > domains[0][1] > domains[0][0] > domains[1][1] > domains[1][0] > domains[2][1]
    assert domains[2][0] == 0.0
    words = [one["text"] for one in layout["annotations"]]
    assert words[-3:] == ["1", "2", "3"]
    for text in (*words, made["data"][0]["name"], made["data"][0]["text"][0]):
        assert "<b>%" not in text
        assert "%{" not in text
    assert layout["xaxis"]["range"][0] < "2026-01-01"


def test_what_no_chart_can_show_is_no_number() -> None:
    assert numbers(np.array([1.23456789, np.nan, np.inf, -np.inf])) == [1.23457, None, None, None]
    with pytest.raises(ValueError, match="JSON"):
        script_json({"value": float("nan")})


@given(
    st.text() | st.sampled_from(["</script><img src=x>", "<!--<script>", "]]>", "\u2028", "&lt;"])
)
def test_no_name_ends_the_script_it_stands_in(name: str) -> None:
    text = script_json({name: [name]})
    assert json.loads(text) == {name: [name]}
    assert not set(text) & set("<>&\u2028\u2029")


# The small picture of the fleet page


def course(values: Any, first: int = 0, **more: Any) -> Any:
    numbered = list(enumerate(values, first))
    watches = [watch(n, value) for n, value in numbered if value is not None]
    return history([fit(n) for n, _ in numbered], watches, **more)


def points(picture: str) -> np.ndarray:
    (line,) = re.findall(r'<path d="([^"]+)"', picture)
    return np.array(re.findall(r"(-?[\d.]+) (-?[\d.]+)", line), dtype=float).reshape(-1, 2)


def span(n: int) -> tuple[dt.date, dt.date]:
    return FIRST, FIRST + (n - 1) * ONE_DAY


def test_noise_of_one_percent_looks_flat_and_a_third_more_does_not() -> None:
    noise = 1.4 * (1 + 0.01 * np.random.default_rng(1).standard_normal(60))
    flat = points(sparkline(course(noise.tolist()), span(60)))
    noise[40:] *= 1.33
    risen = points(sparkline(course(noise.tolist()), span(60)))
    assert np.ptp(flat[:, 1]) < 0.25 * HEIGHT
    assert np.ptp(risen[:, 1]) > 0.4 * HEIGHT
    # Up is more.
    assert risen[-1, 1] < risen[0, 1]


def test_weeks_without_a_value_break_the_line_and_all_motors_share_one_time() -> None:
    broken = course([1.0] * 3 + [None] * 27 + [1.1] * 3, baselines=[baseline(1.05)])
    made = sparkline(broken, span(33))
    assert made.count("M") == 3  # of the baseline, and of each part of the line
    assert f'd="M{MARGIN:g} {HEIGHT / 2:.1f}H{WIDTH - MARGIN:g}"' in made
    assert "Leakage 1.00 to 1.10 l/min" in made
    assert sparkline(course([None, None]), span(2)) == ""
    middle = points(sparkline(course([1.0] * 10, first=45), span(100)))[:, 0]
    assert middle.min() == pytest.approx(MARGIN + 45 / 99 * (WIDTH - 2 * MARGIN), abs=0.06)
    assert middle.max() == pytest.approx(MARGIN + 54 / 99 * (WIDTH - 2 * MARGIN), abs=0.06)
