"""Rows of `trends`: figures, slopes and the time to a limit, against their truth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats

from pipeline.trends.figures.indicators import REFERENCE
from pipeline.trends.rows.trend_rows import trend_rows
from pipeline.trends.states.standing import Standing
from tests.pipeline.trends.nights import (
    HOURS,
    PATHS,
    Nights,
    event,
    motor,
    named,
    night_of,
    ramp,
    standing,
    step,
)

N = 130
SLEEVE_SHARE = 32 * 1.529589e-2 / 1.371423  # of the CB560's reference leakage (model.md, section 3)


def rows(found: Standing, place: int) -> dict[str, dict[str, Any]]:
    return {row["indicator"]: row for row in trend_rows(found, [place])}


@pytest.fixture(scope="module")
def healthy() -> Standing:
    return standing(Nights(motor(), N))


def test_figures_of_a_night(healthy: Standing) -> None:
    nights = Nights(motor(), N)
    theta, found = nights.estimates(), rows(healthy, N - 1)
    for number, path in enumerate(PATHS):
        row = found[f"K_{path}"]
        assert row["value"] == theta[-1, number]
        mean = row["baseline_mean"]
        assert mean == pytest.approx(np.mean(theta[:60, number]), rel=0.002)
        assert row["deviation_percent"] == pytest.approx(100 * (row["value"] / mean - 1))
        gap = found[f"gap_change_{path}"]
        assert gap["value"] == pytest.approx(100 * ((row["value"] / mean) ** (1 / 3) - 1))
        assert gap["unit"] == "%"
    # 32 sleeves with the worked value of one interface.
    leakage = found["leakage_balance_sleeve"]
    truth = nights.truth()[0, 2]
    assert leakage["value"] == pytest.approx(32 * 1.529589e-2 * theta[-1, 2] / truth, rel=1e-6)
    assert found[REFERENCE]["value"] == pytest.approx(1.371423, rel=0.03)
    assert found[REFERENCE]["oil"] == "vg68"
    assert found[REFERENCE]["coverage"] == pytest.approx(1.0)
    assert found[REFERENCE]["n_nights"] == 1


def test_a_healthy_year_has_no_trend(healthy: Standing) -> None:
    row = rows(healthy, N - 1)[REFERENCE]
    assert row["slope_per_year_lower"] < 0 < row["slope_per_year_upper"]
    assert row["p_value"] > 0.01
    assert row["days_to_limit_status"] in ("no_trend", "not_before", "beyond_horizon")
    assert (row["days_to_limit"], row["days_to_limit_upper"]) == (None, None)
    assert row["n_slope"] == N
    assert not row["provisional"]


def test_slope_and_time_to_the_limit_hold_the_truth() -> None:
    """Sleeves that wear evenly: +36 % of their share in 129 nights; the limit is +30 %."""
    wear = {"balance_sleeve": ramp(N, 0, 0.36)}
    spec = motor(limits="[limits]\nalarm_l_per_min = 1.6\n")
    row = rows(standing(Nights(spec, N, wear)), N - 1)[REFERENCE]
    per_night = 1.371423 * SLEEVE_SHARE * 0.36 / (N - 1)
    assert row["slope_per_year_lower"] <= 365.25 * per_night <= row["slope_per_year_upper"]
    per_1000_h = 1000.0 / HOURS * per_night
    assert row["slope_per_1000_h_lower"] <= per_1000_h <= row["slope_per_1000_h_upper"]
    assert row["p_value"] < 1e-6
    days = (1.6 - 1.371423 * (1 + 0.36 * SLEEVE_SHARE)) / per_night
    assert row["limit"] == 1.6
    assert row["days_to_limit_status"] == "finite"
    assert row["days_to_limit_lower"] <= days <= row["days_to_limit_upper"]
    assert row["days_to_limit_lower"] <= row["days_to_limit"] <= row["days_to_limit_upper"]


def test_theil_sens_slope_is_scipys() -> None:
    found = standing(Nights(motor(), N, {"balance_sleeve": ramp(N, 0, 0.36)}))
    row = rows(found, N - 1)[REFERENCE]
    first = found.line_start(REFERENCE, N - 1)
    years = np.arange(first, N) / 365.25
    expected = stats.theilslopes(found.watched[REFERENCE].series[first:], years).slope
    assert row["theil_sen_per_year"] == pytest.approx(expected)
    assert row["slope_start"] == night_of(first)


def test_a_step_is_no_slope() -> None:
    """Across it there would be a steep one; since it began there is none."""
    found = standing(Nights(motor(), N, {"balance_sleeve": step(N, 80, 0.4)}))
    row = rows(found, N - 1)["K_balance_sleeve"]
    assert row["slope_start"] >= night_of(79)
    assert row["slope_per_year_lower"] < 0 < row["slope_per_year_upper"]
    assert row["state"] == "alarm"
    assert row["days_to_limit_status"] == "already_crossed"
    # Just after it there are too few nights for any.
    row = rows(found, 90)["K_balance_sleeve"]
    assert row["slope_per_year"] is None
    assert row["n_slope"] < 20
    assert row["days_to_limit_status"] == "insufficient"


@pytest.mark.parametrize("n", [3, 14])
def test_fewer_than_twenty_nights_have_a_status_and_no_slope(n: int) -> None:
    row = rows(standing(Nights(motor(), n)), n - 1)["K_piston_ring"]
    assert row["slope_per_year"] is None
    assert row["p_value"] is None
    assert row["theil_sen_per_year"] is None
    assert row["n_slope"] == n
    assert row["days_to_limit_status"] == "insufficient"
    assert row["state_reason"].startswith(f"{n} of 15 good nights for a baseline")


def test_between_twenty_and_sixty_nights_a_slope_is_provisional(healthy: Standing) -> None:
    assert rows(healthy, 19)[REFERENCE]["provisional"]
    assert rows(healthy, 58)[REFERENCE]["provisional"]
    assert not rows(healthy, 59)[REFERENCE]["provisional"]


def test_after_an_overhaul_everything_begins_anew() -> None:
    spec = named(motor(), "M1", events=[event(90, "overhaul")])
    wear = {"balance_sleeve": np.where(np.arange(N) < 90, ramp(N, 0, 0.5), 1.0)}
    found = standing(Nights(spec, N, wear))
    assert rows(found, 89)[REFERENCE]["days_to_limit_status"] in ("finite", "not_before")
    after = rows(found, 95)[REFERENCE]
    assert after["days_to_limit_status"] == "insufficient"
    assert after["slope_per_year"] is None
    assert not {"baseline_mean", "limit", "days_to_limit"} & after.keys()
    assert after["state"] == "insufficient"
    later = rows(found, 125)[REFERENCE]
    assert later["slope_start"] == night_of(90)
    assert later["baseline_start"] == night_of(90)
    assert later["n_slope"] == 36
    # Running hours are the motor's and go on.
    assert later["running_hours"] == pytest.approx(126 * HOURS)


def test_weeks_without_a_log_count_as_hours_and_are_flagged() -> None:
    found = standing(Nights(motor(), N, absent=frozenset(range(60, 81))))
    before, after = rows(found, 59)[REFERENCE], rows(found, 81)[REFERENCE]
    assert not before["running_hours_estimated"]
    assert after["running_hours_estimated"]
    # The first night after them: it and 21 nights that are taken to be as the 30 before.
    assert after["running_hours"] - before["running_hours"] == pytest.approx(22 * HOURS)
    assert [rows(found, place)[REFERENCE]["state"] for place in (66, 67, 80, 81)] == [
        "ok",
        "stale",
        "stale",
        "ok",
    ]
    silent = rows(found, 70)[REFERENCE]
    assert silent["gated_reason"] == "no new data: no log covers this night"
    row = rows(found, N - 1)[REFERENCE]
    assert row["n_slope"] == N - 21
    assert row["slope_per_year_lower"] < 0 < row["slope_per_year_upper"]


def test_confounders_are_columns() -> None:
    spec = named(motor(), "M1", events=[event(20, "oil_change", oil="vg46")])
    warm = {"mean_temperature_c": np.linspace(40.0, 60.0, 40)}
    found = standing(Nights(spec, 40, operation=warm))
    assert rows(found, 19)[REFERENCE]["oil"] == "vg68"
    last = rows(found, 39)[REFERENCE]
    assert last["oil"] == "vg46"
    assert last["mean_temperature_c"] == 60.0
    assert last["share_reversed"] == 0.25
    assert last["flushing_mode"] == "none"


def test_own_conditions_are_told_from_the_night_on_which_they_are_known(healthy: Standing) -> None:
    name = "own_reference_leakage"
    before, known = rows(healthy, 13)[name], rows(healthy, 14)[name]
    assert before["value"] is None
    assert before["gated_reason"] == "no baseline yet"
    assert known["value"] > 0
    assert known["lower"] < known["value"] < known["upper"]
