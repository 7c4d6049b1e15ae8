"""The demo's pages without a browser: they draw and say what the tables and `explain` have."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from tests.scenarios.covering import covers
from tests.scenarios.fleets import ScenarioFleet

# A step of a gap; the last holds one pressure.
DAY = np.timedelta64(1, "D")
HEALTHY, WORN, BROKEN, BLIND = "CB400-01", "CB560-02", "CB560-01", "CB1120-02"


def payload(path: Path) -> Any:
    """What a motor's page, or a night's script, gives to the scripts of the page."""
    marks = r'id="payload">(.*?)</script>' if path.suffix == ".html" else r"^\w+\.night\((.*)\);\n$"
    (found,) = re.findall(marks, path.read_text("utf-8"), re.DOTALL)
    return json.loads(found)


def lines(figure: Any) -> dict[str, list[float | None]]:
    """Values of each line of a chart."""
    return {trace["name"]: trace["y"] for trace in figure["data"] if "name" in trace}


def column(rows: list[dict[str, Any]], name: str) -> list[float | None]:
    """A column with the six digits of the pages."""
    return [None if row[name] is None else float(f"{row[name]:.6g}") for row in rows]


def test_the_chart_over_the_nights_is_that_of_the_tables(demo: ScenarioFleet) -> None:
    page = demo.output / "report" / "motors" / f"{WORN}.html"
    chart, nights = payload(page)["course"], demo.nights(WORN)
    assert chart["x"] == [str(row["night"]) for row in nights]
    drawn = lines(chart)
    assert drawn["leakage"] == column(nights, "leakage_change_percent")
    newest = nights[-1]
    band = next(trace for trace in chart["data"] if trace.get("fill") and "0072b2" in str(trace))
    known = [night for night in nights if night["leakage_change_percent"] is not None]
    there = column(known, "leakage_change_lower") + column(known, "leakage_change_upper")[::-1]
    assert band["y"] == there
    level = newest["alarm_level_percent"]
    assert drawn[f"alarm level +{level:g} "] == [level, level]
    (name,) = (name for name in drawn if name.startswith("warning from"))
    assert drawn[name][0] == pytest.approx(newest["detection_limit_percent"], rel=1e-5)
    # On the right stands the flow of the baseline, and of the rise.
    left, right = (chart["layout"][axis]["range"] for axis in ("yaxis", "yaxis9"))
    flow = newest["own_leakage_l_per_min"] / (1.0 + newest["leakage_change_percent"] / 100.0)
    assert right == pytest.approx([flow * (1.0 + end / 100.0) for end in left], rel=0.02)
    gaps = demo.table("trends").filter(
        pl.col("motor_id") == WORN, pl.col("indicator") == "gap_change_balance_piston"
    )
    newest_gap = gaps.sort("night")["value"].to_list()[-1]
    assert drawn["balance piston"][-1] == pytest.approx(newest_gap, rel=1e-5)
    # Marked are the baseline, and the night in which the change was detected.
    shapes = chart["layout"]["shapes"]
    ends = {(shape["x0"], shape["x1"]) for shape in shapes if shape["type"] == "rect"}
    assert ends == {(str(newest["baseline_start"]), str(newest["baseline_end"]))}
    detected = str(min(row["detected_on"] for row in nights if row["detected_on"]))
    assert detected in {shape["x0"] for shape in shapes if shape["type"] == "line"}
    (marks,) = (trace for trace in chart["data"] if trace.get("name") == "marks")
    assert (detected, "change detected: balance piston") in zip(
        marks["x"], marks["customdata"], strict=True
    )


def test_the_projection_reaches_the_alarm_level_on_its_date(demo: ScenarioFleet) -> None:
    seen = 0
    for row in demo.table("latest").to_dicts():
        chart = payload(demo.output / "report" / "motors" / f"{row['motor_id']}.html")["course"]
        projected = [trace for trace in chart["data"] if "projection" in trace.get("name", "")]
        is_dated = row["days_to_limit_status"] in ("finite", "not_before", "beyond_horizon")
        assert len(projected) == (is_dated and row["leakage_change_percent"] < 30.0)
        for trace in projected:
            seen += 1
            days = row["days_to_limit"] or row["days_to_limit_lower"]
            first, last = (np.datetime64(time) for time in trace["x"])
            assert (last - first) / DAY == pytest.approx(days, abs=0.01)
            assert trace["y"][-1] == row["alarm_level_percent"]
            assert trace["y"][0] == pytest.approx(row["leakage_change_percent"], rel=1e-5)
            # The axis of time goes on to the date, by as much as the nights before at most.
            start, end = (np.datetime64(time) for time in chart["ranges"]["all"])
            assert end >= min(last, first + (first - start) * 0.9)
    assert seen


def test_evidence_is_drawn_whole_and_the_end_of_its_axis_is_named(demo: ScenarioFleet) -> None:
    chart = payload(demo.output / "report" / "motors" / f"{BROKEN}.html")["course"]
    evidence = [value for value in column(demo.nights(BROKEN), "evidence") if value is not None]
    assert [value for value in lines(chart)["evidence"] if value is not None] == evidence
    top = chart["layout"]["yaxis2"]["range"][1]
    assert max(evidence) > top
    assert f"ln R, up to {top:.0f}" in str(chart["layout"]["annotations"])


def test_what_stands_beside_the_chart(demo: ScenarioFleet) -> None:
    page = (demo.output / "report" / "motors" / f"{WORN}.html").read_text("utf-8")
    detected = str(min(row["detected_on"] for row in demo.nights(WORN) if row["detected_on"]))
    assert f'<a href="#{detected}">{detected}</a> change detected: balance piston' in page
    assert "30 of 30" in page
    changes = re.findall(r'<tr><td><a href="#([\d-]+)"', page.partition('id="alarm-table"')[2])
    assert len(changes) > 1
    assert changes == sorted(changes, reverse=True)
    newest = demo.newest(WORN)
    for name in ("leakage_change", "mean_change", "gap_change"):
        value, lower, upper = (newest[f"{name}_{end}"] for end in ("percent", "lower", "upper"))
        assert f"{value:+.0f} % [{lower:.0f}, {upper:.0f}]" in page


@covers("explain")
def test_a_night_has_the_words_of_explain_and_the_samples_of_the_tables(
    demo: ScenarioFleet,
) -> None:
    night = demo.label(demo.plan.nights)
    shown = payload(demo.output / "report" / "data" / WORN / f"{night}.js")
    words = [line for title, of in shown["words"] for line in (title, *of) if line]
    explained = demo.run("explain", WORN, night).out.splitlines()
    assert words == [line.strip() for line in explained if line]
    rows = (
        demo.table("predictions")
        .filter(pl.col("motor_id") == WORN, pl.col("night") == night)
        .sort("time")
    )
    drawn = lines(shown["figure"])
    for name, title in (("measured_l_per_min", "measured"), ("speed_rpm", "Speed")):
        # Nothing is drawn where samples are missing.
        values = [value for value in drawn[title] if value is not None]
        assert values == column(rows.to_dicts(), name)
        assert len(drawn[title]) > len(values)
    for part in ("training", "validation"):
        values = [value for value in drawn[f"model, {part} data"] if value is not None]
        assert values == column(rows.filter(part=part).to_dicts(), "predicted_l_per_min")
    pairs = zip(shown["figure"]["x"], drawn["measured"], strict=True)
    times = [time for time, value in pairs if value is not None]
    assert times == rows["time"].dt.strftime("%Y-%m-%dT%H:%M:%S").to_list()


def test_a_motor_of_one_pressure_has_no_figure_of_a_part(demo: ScenarioFleet) -> None:
    page = demo.output / "report" / "motors" / f"{BLIND}.html"
    drawn = {*lines(payload(page)["course"])}
    assert {name for name in drawn if not name.startswith(("alarm", "warning", "marks"))} == {
        "leakage",
        "baseline",
        "evidence",
        "limit: a change is detected above it",
    }
    assert "change detected: one or more of" in page.read_text("utf-8")


def test_noise_looks_like_noise_and_wear_like_wear(demo: ScenarioFleet) -> None:
    """On the small pictures of the fleet, and on the chart of a motor."""
    index = (demo.output / "report" / "index.html").read_text("utf-8")
    heights = {}
    for motor in (HEALTHY, WORN):
        (picture,) = re.findall(rf'<tr data-motor="{motor}">.*?(<svg.*?</svg>)', index, re.DOTALL)
        flows = [row["own_leakage_l_per_min"] for row in demo.nights(motor)]
        known = [flow for flow in flows if flow is not None]
        (ends,) = re.findall(r'aria-label="Leakage ([\d.]+) to ([\d.]+) l/min"', picture)
        assert list(map(float, ends)) == pytest.approx([min(known), max(known)], rel=5e-3)
        (line,) = re.findall(r'<path d="([^"]+)"', picture)
        heights[motor] = [float(one) for one in re.findall(r" ([\d.]+)", line)]
    # Of 28; up is more.
    assert max(heights[HEALTHY]) - min(heights[HEALTHY]) < 7
    assert heights[WORN][0] - heights[WORN][-1] > 8
    chart = payload(demo.output / "report" / "motors" / f"{HEALTHY}.html")["course"]
    low, high = chart["layout"]["yaxis"]["range"]
    changes = [change for change in lines(chart)["leakage"] if change is not None]
    assert max(changes) - min(changes) < 0.1 * (high - low)
