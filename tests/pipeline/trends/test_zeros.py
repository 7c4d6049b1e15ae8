"""A sensor that drifts is named before wear is."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.trends.rows.alarm_rows import alarm_rows
from pipeline.trends.rows.trend_rows import trend_rows
from pipeline.trends.states.standing import Standing
from pipeline.trends.states.zeros import FLOW_ZERO, PRESSURE_ZERO, tolerance
from pipeline.trends.why.reasons import path_behind, why_state
from tests.pipeline.trends.nights import Nights, event, motor, named, ramp, reset, standing, step

N, AT = 100, 60
SCATTER = 0.002


def zeros(moved: np.ndarray, seed: int = 3) -> dict[str, np.ndarray]:
    """Halts of every night: the zero of the flow has moved so far [l/min], the other has not."""
    generator = np.random.default_rng(seed)
    return {
        "flow_zero_l_per_min": moved + SCATTER * generator.standard_normal(N),
        "flow_zero_standard_error_l_per_min": np.full(N, SCATTER),
        "pressure_zero_bar": 0.1 * generator.standard_normal(N),
        "pressure_zero_standard_error_bar": np.full(N, 0.1),
    }


def drifting(size: float = 0.02, **more: object) -> Standing:
    """A drift of 0.02 l/min moves K of the rings by 11 % (model.md, section 5), 3.5 % of h."""
    moved = np.where(np.arange(N) >= AT, size, 0.0)
    wear = {"piston_ring": step(N, AT, 0.11), "balance_piston": step(N, AT, 0.05)}
    return standing(Nights(motor(), N, wear, operation=zeros(moved), **more))  # type: ignore[arg-type]


def test_a_drift_is_named_before_the_ring() -> None:
    found = drifting()
    assert found.states["K_piston_ring"][-1] == "warning"
    said = why_state(found, "K_piston_ring", N - 1, path_behind(found, "K_piston_ring", N - 1))
    first, second, *_ = said.split("; ")
    assert first.startswith("the zero of the flow sensor has moved by +0.0")
    assert (
        first.endswith("l/min [0.0185, 0.0213]: check it before the motor")
        or "]: check it" in first
    )
    assert second.startswith("piston ring gap +3.")
    assert found.health(N - 1) == "drifted"


def test_its_size_holds_the_truth_and_its_state_is_a_change_of_its_own() -> None:
    found = drifting()
    zero = found.zeros[FLOW_ZERO]
    # By the end the last thirty halts, all of them after the step, stand against the first thirty.
    assert zero.lower[-1] <= 0.02 <= zero.upper[-1]
    (changed,) = (
        row
        for row in alarm_rows(found, range(N))
        if row["indicator"] == FLOW_ZERO and row["to_state"] == "warning"
    )
    assert changed["way"] == "drift"
    assert changed["night"] > found.label(AT)
    rows = {row["indicator"]: row for row in trend_rows(found, [N - 1])}
    assert rows[FLOW_ZERO]["value"] == pytest.approx(0.02, abs=4 * SCATTER)
    assert rows[FLOW_ZERO]["baseline_mean"] == pytest.approx(0.0, abs=SCATTER)
    assert rows["reference_leakage"]["sensor_health"] == "drifted"
    assert rows[PRESSURE_ZERO]["state"] == "ok"


@pytest.mark.parametrize("seed", range(4))
def test_a_steady_sensor_is_not_accused(seed: int) -> None:
    found = standing(Nights(motor(), N, operation=zeros(np.zeros(N), seed)))
    assert set(found.states[FLOW_ZERO][10:]) == {"ok"}
    assert set(found.states[PRESSURE_ZERO][10:]) == {"ok"}
    assert found.health(N - 1) == "ok"


def test_a_move_within_the_stated_tolerance_is_none() -> None:
    stated = motor(more="offset_tolerance = 0.05\n")  # of leakage_flow, the last channel
    assert tolerance(stated, FLOW_ZERO) == 0.05
    moved = np.where(np.arange(N) >= AT, 0.03, 0.0)
    assert set(standing(Nights(stated, N, operation=zeros(moved))).states[FLOW_ZERO][10:]) == {"ok"}
    assert tolerance(motor(), FLOW_ZERO) == 0.01
    assert drifting(0.03).states[FLOW_ZERO][-1] == "warning"


def test_without_halts_nothing_is_said_of_the_sensors() -> None:
    found = standing(Nights(motor(), N))
    assert found.health(N - 1) == "unknown"
    assert set(found.states[FLOW_ZERO]) == {"insufficient"}
    assert FLOW_ZERO not in {row["indicator"] for row in trend_rows(found, [N - 1])}


def test_nights_without_a_halt_hold_and_have_no_figure() -> None:
    halts = zeros(np.where(np.arange(N) >= AT, 0.03, 0.0))
    for values in halts.values():
        values[90:] = np.nan
    found = standing(Nights(motor(), N, operation=halts))
    assert set(found.states[FLOW_ZERO][90:]) == {"warning"}
    row = next(row for row in trend_rows(found, [95]) if row["indicator"] == FLOW_ZERO)
    assert (row["value"], row["gated_reason"]) == (None, "no settled halt without pressure")


def test_a_sensor_that_was_put_right_begins_anew() -> None:
    moved = np.where((np.arange(N) >= 40) & (np.arange(N) < 70), 0.03, 0.0)
    found = standing(Nights(motor(), N, operation=zeros(moved)), reset(70, note="calibrated"))
    assert found.states[FLOW_ZERO][69] == "warning"
    assert set(found.states[FLOW_ZERO][70:79]) == {"insufficient"}
    assert found.states[FLOW_ZERO][-1] == "ok"
    spec = named(motor(), "M1", events=[event(70, "overhaul")])
    assert standing(Nights(spec, N, operation=zeros(moved))).states[FLOW_ZERO][-1] == "ok"


def test_where_the_flushing_is_estimated_nobody_can_tell_the_flow_sensors_zero() -> None:
    flushed = motor(more='[flushing]\nmode = "estimated"\nflow_l_per_min = 4.0\n')
    moved = 4.0 + np.where(np.arange(N) >= AT, 0.3, 0.0)
    found = standing(Nights(flushed, N, operation=zeros(moved)))
    assert set(found.states[FLOW_ZERO]) == {"insufficient"}
    assert found.states[PRESSURE_ZERO][-1] == "ok"


def test_a_slow_drift_is_told_once_it_is_beyond_what_matters() -> None:
    found = standing(Nights(motor(), N, operation=zeros(ramp(N, 30, 0.05) - 1.0)))
    states = found.states[FLOW_ZERO]
    first = states.index("warning")
    # It has reached 0.01 l/min at night 44.
    assert 44 <= first <= 75
    assert set(states[first:]) == {"warning"}
