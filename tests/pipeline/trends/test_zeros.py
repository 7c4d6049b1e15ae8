"""A sensor that drifts is named before wear is."""

from __future__ import annotations

import numpy as np

from pipeline.config import MotorSpec
from pipeline.trends.nights.decisions import FLOW_ZERO, PRESSURE_ZERO, Decision
from pipeline.trends.nights.history import History, blank_records
from pipeline.trends.nights.layout import Layout
from pipeline.trends.states.zeros import Zero, health, sensor_zeros, tolerance
from tests.pipeline.trends.nights import event, motor, named, night_of, reset

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


def watched(
    halts: dict[str, np.ndarray], spec: MotorSpec | None = None, *said: Decision
) -> dict[str, Zero]:
    """Zeros of a motor's sensors over nights with these halts."""
    spec = spec or motor()
    records = blank_records([night_of(place) for place in range(N)])
    for name, values in halts.items():
        records[name] = values
    return sensor_zeros(History(spec, Layout.of(spec, night_of(0)), records, said))


def stepped(size: float) -> dict[str, np.ndarray]:
    return zeros(np.where(np.arange(N) >= AT, size, 0.0))


def test_a_drift_is_told_with_its_size() -> None:
    """A drift of 0.02 l/min moves K of the rings by 11 % (model.md, section 5)."""
    found = watched(stepped(0.02))
    zero = found[FLOW_ZERO]
    # By the end the last thirty halts, all of them after the step, stand against the first thirty.
    assert zero.lower[-1] <= 0.02 <= zero.upper[-1]
    # Half of them lie behind the step once their mean is beyond the tolerance of 0.01 l/min.
    assert AT < zero.state.index("warning") <= AT + 15 + 5
    words = zero.words(N - 1)
    assert words.startswith("the zero of the flow sensor has moved by +0.0")
    assert words.endswith("]: check it before the motor")
    assert zero.words(AT - 1) == ""
    assert set(found[PRESSURE_ZERO].state[10:]) == {"ok"}
    states = [health(list(found.values()), place) for place in (AT - 1, N - 1)]
    assert states == ["ok", "drifted"]


def test_a_move_within_the_stated_tolerance_is_none() -> None:
    stated = motor(more="offset_tolerance = 0.05\n")  # of leakage_flow, the last channel
    assert tolerance(stated, FLOW_ZERO) == 0.05
    assert set(watched(stepped(0.03), stated)[FLOW_ZERO].state[10:]) == {"ok"}
    assert tolerance(motor(), FLOW_ZERO) == 0.01
    assert watched(stepped(0.03))[FLOW_ZERO].state[-1] == "warning"


def test_nights_without_a_halt_hold() -> None:
    halts = stepped(0.03)
    for values in halts.values():
        values[90:] = np.nan
    assert set(watched(halts)[FLOW_ZERO].state[90:]) == {"warning"}


def test_what_a_night_says_hangs_on_no_later_one() -> None:
    whole, first = stepped(0.03), stepped(0.03)
    for values in first.values():
        values[75:] = np.nan
    assert watched(whole)[FLOW_ZERO].state[:75] == watched(first)[FLOW_ZERO].state[:75]


def test_a_sensor_that_was_put_right_begins_anew() -> None:
    halts = zeros(np.where((np.arange(N) >= 40) & (np.arange(N) < 70), 0.03, 0.0))
    found = watched(halts, None, reset(70, note="calibrated"))[FLOW_ZERO]
    assert found.state[69] == "warning"
    assert set(found.state[70:79]) == {"insufficient"}
    assert found.state[-1] == "ok"
    spec = named(motor(), "M1", events=[event(70, "overhaul")])
    assert watched(halts, spec)[FLOW_ZERO].state[-1] == "ok"


def test_where_the_flushing_is_estimated_nobody_can_tell_the_flow_sensors_zero() -> None:
    flushed = motor(more='[flushing]\nmode = "estimated"\nflow_l_per_min = 4.0\n')
    found = watched(stepped(0.3), flushed)
    assert set(found[FLOW_ZERO].state) == {"insufficient"}
    assert found[PRESSURE_ZERO].state[-1] == "ok"
