"""The trend stage over made-up nights: what is told, when, and that looking back changes nothing.

A night's expected value follows from how it was made: K times a relative course, leakage 1.4 l/min
at a course of 1.
"""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from polars.testing import assert_frame_equal

from pipeline.decisions import Decision, record_decision
from pipeline.schema import ALARMS, BASELINES, CHANGE_POINTS, TREND_TABLES, TRENDS
from pipeline.verification import verify_tables
from tests.pipeline.trends.nights import K, Nights, courses, label

UTC = dt.UTC


@pytest.fixture
def nights(tmp_path: Path) -> Nights:
    made = Nights(tmp_path)
    made.configure()
    return made


def states(made: Nights, indicator: str, motor: str = "M1") -> list[str]:
    rows = made.rows(TRENDS, motor).filter(indicator=indicator).sort("night")
    return rows["state"].to_list()


def raised(made: Nights, motor: str = "M1") -> pl.DataFrame:
    return made.rows(ALARMS, motor).filter(pl.col("to_state").is_in(["warning", "alarm"]))


def stepped(n: int, at: int, size: float, seed: int = 1) -> np.ndarray:
    course = courses(n, seed)
    course[at:] *= 1.0 + size
    return course


def test_a_healthy_motor_is_ok_once_it_has_a_baseline(nights: Nights) -> None:
    nights.write({"M1": courses(90)})
    nights.run()
    for name in ("reference_leakage", "own_reference_leakage", "K_gap", "baseline_deviation"):
        # The thirtieth good night makes the provisional baseline, which serves from the next on.
        assert states(nights, name) == ["insufficient"] * 30 + ["ok"] * 60, name
    assert raised(nights).is_empty()
    found = nights.rows(BASELINES).filter(indicator="K_gap")
    assert found["n"].to_list() == [30, 60]
    assert found["provisional"].to_list() == [True, False]
    assert found["start"].to_list() == [label(0)] * 2
    assert found["mean"].to_list() == pytest.approx([K, K], rel=0.005)


def test_figures_of_a_night(nights: Nights) -> None:
    course = courses(50)
    nights.write({"M1": course})
    nights.run()
    last = {row["indicator"]: row for row in nights.rows(TRENDS).filter(night=label(49)).to_dicts()}
    mean = float(np.mean(course[:30]))
    assert last["reference_leakage"]["value"] == pytest.approx(1.4 * course[49])
    assert last["K_gap"]["value"] == pytest.approx(K * course[49])
    assert last["K_gap"]["deviation_percent"] == pytest.approx(
        100 * (course[49] / mean - 1), abs=0.05
    )
    gap = 100 * (np.cbrt(course[49] / mean) - 1)
    assert last["gap_change_gap"]["value"] == pytest.approx(gap, abs=0.02)
    # Measured flow over that of the model fitted to the first thirty nights together.
    assert last["baseline_deviation"]["value"] == pytest.approx(course[49] / mean - 1, abs=1e-3)
    assert last["K_gap"]["running_hours"] == pytest.approx(50 * 20.0)
    assert last["K_gap"]["coverage"] == pytest.approx(1.0)
    assert last["K_gap"]["warning_limit"] == pytest.approx(1.15 * last["K_gap"]["baseline_mean"])
    assert last["K_gap"]["n_slope"] == 50
    assert last["K_gap"]["provisional"]


def test_a_step_is_told_within_days_with_its_path_and_size(nights: Nights) -> None:
    nights.write({"M1": stepped(90, 70, 0.40)})
    nights.run()
    first = raised(nights).filter(indicator="K_gap").sort("night").row(0, named=True)
    assert label(70) <= first["night"] <= label(74)
    assert first["path"] == "gap"
    assert first["reason"].startswith("gap leakage +")
    last = nights.rows(TRENDS).filter(night=label(89), indicator="K_gap").row(0, named=True)
    assert (last["state"], last["path"]) == ("alarm", "gap")
    assert last["deviation_percent"] == pytest.approx(40.0, abs=5.0)
    seen = nights.rows(CHANGE_POINTS).filter(indicator="K_gap")
    assert label(70) in seen["change_night"].to_list()


def test_wear_is_told_before_it_is_large(nights: Nights) -> None:
    """30 % in 60 nights on leakage that scatters by 1 %: a warning long before +15 %."""
    course = courses(120)
    course[60:] *= 1.0 + 0.30 * np.arange(1, 61) / 60
    nights.write({"M1": course})
    nights.run()
    first = raised(nights).sort("night").row(0, named=True)
    assert label(60) < first["night"] < label(60 + 30)
    last = nights.rows(TRENDS).filter(night=label(119), indicator="reference_leakage")
    row = last.row(0, named=True)
    assert row["slope_per_year_lower"] > 0
    assert row["q_value"] < 0.01


def test_looking_back_says_what_the_nights_said(tmp_path: Path) -> None:
    """A year at once and night after night: the same rows of each night."""
    course = stepped(80, 60, 0.25)
    at_once, nightly = Nights(tmp_path / "once"), Nights(tmp_path / "nightly")
    for made in (at_once, nightly):
        made.folder.mkdir()
        made.configure()
    at_once.write({"M1": course})
    at_once.run()
    for first, end in [(0, 29), (29, 31), (31, 59), (59, 60), *((n, n + 1) for n in range(60, 80))]:
        nightly.write({"M1": course[first:end]}, first)
        nightly.run()
    for table in (TRENDS, ALARMS, BASELINES):
        # The false discovery rate is that of the nights published together, of one motor alike.
        assert_frame_equal(at_once.rows(table), nightly.rows(table), check_exact=False)


def test_a_second_run_has_nothing_to_do(nights: Nights) -> None:
    nights.write({"M1": courses(40)})
    nights.run()
    files = {
        path: path.stat().st_mtime_ns
        for table in TREND_TABLES
        for path in (nights.output / "tables" / table.name).rglob("*.parquet")
    }
    nights.run()
    assert all(path.stat().st_mtime_ns == before for path, before in files.items())
    # The made-up tables were not published by a run; what the stage wrote is proven.
    faults = [one for one in verify_tables(nights.output) if one.code != "table_unlisted"]
    assert faults == []


def test_missing_nights_hold_a_state_then_it_is_stale(nights: Nights) -> None:
    course = courses(60)
    course[45:] = np.nan
    nights.write({"M1": course})
    nights.run()
    found = states(nights, "reference_leakage")
    assert found[44] == "ok"
    assert found[52:] == ["stale"] * 8
    rows = nights.rows(TRENDS).filter(indicator="reference_leakage").sort("night")
    assert rows["gated_reason"][50] == "stood still: the motor stood still all night"
    assert rows["value"][50] is None


def test_too_few_nights_have_a_status_and_no_slope(nights: Nights) -> None:
    nights.write({"M1": courses(19)})
    nights.run()
    rows = nights.rows(TRENDS).filter(indicator="K_gap")
    assert rows["slope_per_year"].null_count() == rows.height == 19
    assert set(rows["days_to_limit_status"]) == {"insufficient"}
    assert set(rows["state"]) == {"insufficient"}
    assert "19 of 30 good nights" in rows.sort("night")["state_reason"][-1]


def test_a_reset_starts_a_new_baseline(nights: Nights) -> None:
    nights.write({"M1": stepped(120, 60, 0.4)})
    nights.run()
    assert states(nights, "K_gap")[-1] == "alarm"
    said = Decision(
        "M1", "", dt.datetime(2026, 5, 1, tzinfo=UTC), "baseline_reset", label(60), None, "new ring"
    )
    record_decision(nights.output, said)
    nights.run()
    assert states(nights, "K_gap")[60:90] == ["insufficient"] * 30
    assert states(nights, "K_gap")[-1] == "ok"
    reasons = nights.rows(BASELINES).filter(indicator="K_gap")["reason"].to_list()
    assert any("new ring" in reason for reason in reasons)


def test_an_overhaul_in_the_config_starts_a_new_baseline(nights: Nights) -> None:
    nights.write({"M1": stepped(110, 60, -0.2)})
    nights.configure(more=f'[[events]]\ndate = {label(60)}\nkind = "overhaul"\nnote = "sleeves"\n')
    nights.run()
    starts = nights.rows(BASELINES).filter(indicator="K_gap")
    assert set(starts["start"]) == {label(0), label(60)}
    assert any("overhaul" in reason and "sleeves" in reason for reason in starts["reason"])


def test_an_alarm_that_late_data_take_back_is_closed_and_never_deleted(nights: Nights) -> None:
    course = stepped(80, 70, 0.4)
    nights.write({"M1": course})
    nights.run()
    before = raised(nights).filter(indicator="K_gap")
    assert before.height
    # What had looked like wear was another motor's log: the nights come out healthy after all.
    nights.write({"M1": courses(80)[70:]}, 70)
    for path in (nights.output / "ledger").rglob("trends"):
        path.unlink()
    nights.run()
    after = nights.rows(ALARMS).filter(indicator="K_gap")
    kept = after.join(before, on=["night", "indicator", "to_state"], how="semi")
    assert kept.height == before.height
    assert "recomputed" in after["way"].to_list()
    assert states(nights, "K_gap")[-1] == "ok"


def test_what_moves_all_motors_of_a_circuit_is_a_common_cause(tmp_path: Path) -> None:
    made = Nights(tmp_path, {f"M{n}": "tank" for n in range(1, 5)})
    made.configure()
    made.write({f"M{n}": stepped(110, 80, 0.25, seed=n) for n in range(1, 5)})
    made.run()
    for motor in made.circuits:
        assert states(made, "reference_leakage", motor)[-1] == "common_cause"
        reasons = made.rows(TRENDS, motor).filter(indicator="reference_leakage", night=label(109))
        assert "oil" in reasons["state_reason"][0]


def test_what_moves_one_motor_of_a_circuit_is_its_own(tmp_path: Path) -> None:
    made = Nights(tmp_path, {f"M{n}": "tank" for n in range(1, 5)})
    made.configure()
    worn = {"M1": stepped(110, 80, 0.25)}
    made.write(worn | {f"M{n}": courses(110, seed=n) for n in range(2, 5)})
    made.run()
    assert states(made, "reference_leakage")[-1] in ("warning", "alarm")
    assert {states(made, "reference_leakage", f"M{n}")[-1] for n in range(2, 5)} == {"ok"}
    peer = made.rows(TRENDS).filter(indicator="peer_deviation", night=label(109)).row(0, named=True)
    assert peer["value"] == pytest.approx(0.25, abs=0.05)


def test_a_drifting_sensor_is_named(nights: Nights, monkeypatch: pytest.MonkeyPatch) -> None:
    import tests.pipeline.trends.nights as made

    steady = made.operated

    def drifting(motor: str, night: dt.date) -> dict[str, object]:
        moved = 0.3 if night >= label(40) else 0.0
        return steady(motor, night) | {"flow_zero_l_per_min": moved}

    monkeypatch.setattr(made, "operated", drifting)
    nights.write({"M1": stepped(90, 40, 0.3)})
    nights.run()
    last = nights.rows(TRENDS).filter(night=label(89), indicator="reference_leakage")
    assert last["sensor_health"].to_list() == ["drifted"]
    assert "the zero of the flow sensor has moved by +0.3" in last["state_reason"][0]


def test_a_night_that_went_out_of_range_says_so(nights: Nights) -> None:
    nights.write({"M1": courses(40)})
    nights.write(
        {"M1": courses(2)},
        40,
        reference_verdict="outside_fitted_range",
        reference_reason="pressure 200 bar lies outside the night's 10 to 150 bar",
        reference_leakage_l_per_min=None,
    )
    nights.run()
    row = (
        nights.rows(TRENDS)
        .filter(indicator="reference_leakage", night=label(41))
        .row(0, named=True)
    )
    assert row["outside_fitted_range"]
    assert "lies outside" in row["gated_reason"]
    assert row["value"] is None
