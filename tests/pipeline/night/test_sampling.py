"""Kinds of samples: counts, values sent on change, means, bad quality, and limits in every unit."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.config import MotorSpec
from pipeline.config.logs import Logs
from pipeline.night.cleaning import HAMPEL_THRESHOLD
from pipeline.night.masks import flow_from_counts, out_of_range
from pipeline.night.on_grid import on_grid
from pipeline.night.time_base import grid_period_us
from pipeline.schema import FAILED, OK
from pipeline.units import CHANNELS, QUANTITIES, UNITS, from_canonical, to_canonical
from tests.pipeline.night.channels import SECOND, Floats, Times, as_read, refused_by, stamps
from tests.pipeline.night.noise_free import configured_flow, fit, fit_of, fitted
from tests.pipeline.simulated import CANONICAL, Array, load_motor, motor_toml, operate, with_channel

MOVING = operate(minutes=60.0)


# A meter of 1 cm³ a pulse, read at 10 Hz: at 0.35 l/min a reading is 0 or 0.6 l/min, the MAD is 0.
FLOW = 0.35
PULSE_TIME = stamps(36_000)
TOTAL = np.floor(FLOW * 1000 / 60 * PULSE_TIME / SECOND)
PULSES = np.diff(TOTAL, prepend=0.0)
PULSED: dict[str, Any] = {"unit": "pulses", "volume_per_count_cm3": 1.0}
COUNTED: dict[str, Any] = PULSED | {"unit": "count"}
MEANS: dict[str, Any] = {"sampling": "mean", "mean_of_s": 10.0}
ON_CHANGE: dict[str, Any] = {"sampling": "on_change", "longest_silence_s": 300.0}
HELD: dict[str, Any] = ON_CHANGE | {"between": "hold"}


def seconds(n: int) -> Times:
    return stamps(n, 1.0)


@pytest.mark.parametrize(
    ("logged", "keys", "refused"),
    [
        (PULSES * 0.6, {"resolution": 0.6}, {}),
        # The step shows in the readings, also after a conversion from m³/h or gallons.
        *((PULSES * 0.6 * unit / unit, {}, {}) for unit in (1.0, 0.06, 1 / 3.785411784)),
        (PULSES, PULSED, {"no_interval": 1, "any": 1}),
        (TOTAL, COUNTED, {"no_interval": 1, "any": 1}),
    ],
)
def test_a_pulse_meter_keeps_its_mean(
    logged: Array, keys: dict[str, Any], refused: dict[str, int]
) -> None:
    found = as_read("leakage_flow", PULSE_TIME, logged, **keys)
    assert refused_by(found) == refused
    kept = found.value[~found.refused]
    assert kept.mean() == pytest.approx(FLOW, rel=1e-3 if refused else 0.01)


@given(
    st.lists(st.integers(0, 400), min_size=2, max_size=60),
    st.lists(st.integers(200_000, 1_800_000), min_size=60, max_size=60),
    st.floats(0.01, 1000.0),
)
def test_volume_is_kept_whatever_the_jitter(
    fresh: list[int], steps: list[int], volume: float
) -> None:
    time = np.cumsum(steps[: len(fresh)]).astype(np.int64)
    total = np.cumsum(fresh).astype(np.float64)
    middle, flow, masks = flow_from_counts(time, total, 5e6, volume, is_total=True)
    _, pulses, _ = flow_from_counts(time, np.array(fresh, float), 5e6, volume, is_total=False)
    np.testing.assert_allclose(flow, pulses, rtol=1e-9)
    litres = np.nansum(flow[1:] * np.diff(time) / 60e6)
    assert litres == pytest.approx((total[-1] - total[0]) * volume / 1000, rel=1e-9, abs=1e-12)
    assert masks["no_interval"].tolist() == [True] + [False] * (len(fresh) - 1)
    assert not masks["counter_reset"].any()
    assert (np.diff(middle) > 0).all()


def counted(reset_at: int | None = None, bad: dict[int, float] | None = None) -> Array:
    """A running total of three counts a second, with wrong readings."""
    total = np.arange(100.0) * 3.0
    if reset_at is not None:
        total[reset_at:] -= total[reset_at]
    for row, value in (bad or {}).items():
        total[row] = value
    return total


INFINITE = {"not_finite": 1, "out_of_range": 1, "counter_reset": 1, "any": 3}


@pytest.mark.parametrize(
    ("logged", "bad", "keys", "refused"),
    [
        (counted(60), [], COUNTED, {"counter_reset": 1, "any": 2}),
        (counted(bad={20: np.inf}), [], COUNTED, INFINITE),
        (counted(bad={30: 7.0}), [30], COUNTED, {"bad_quality": 1, "no_interval": 2, "any": 3}),
        (
            np.where(np.arange(60) == 30, 500.0, 3.0), [30], PULSED,
            {"bad_quality": 1, "any": 2},
        ),
        # A counter that stopped is frozen, and a steady one is not.
        (np.repeat([3.0, 0.0], 300), [], PULSED, {"frozen": 300, "any": 301}),
    ],
)  # fmt: skip
def test_a_counter_loses_what_it_cannot_tell(
    logged: Array, bad: list[int], keys: dict[str, Any], refused: dict[str, int]
) -> None:
    found = as_read("leakage_flow", seconds(len(logged)), logged, bad, **keys)
    assert refused_by(found) == {"no_interval": 1} | refused
    np.testing.assert_allclose(found.value[~found.refused], 0.18)
    assert (np.diff(found.time_us) > 0).all()


def test_a_gap_leaves_no_interval_of_a_counter() -> None:
    left = np.delete(np.arange(100), np.arange(40, 60))
    found = as_read("leakage_flow", seconds(100)[left], counted()[left], **COUNTED)
    assert refused_by(found) == {"no_interval": 2, "any": 2}
    np.testing.assert_allclose(found.value[~found.refused], 0.18)


def test_the_same_value_for_longer_than_the_longest_silence_is_frozen() -> None:
    time = np.array([0, 250, 500, 750], dtype=np.int64) * SECOND
    stuck = as_read("pressure_difference", time, np.full(4, 80.0), **ON_CHANGE)
    assert stuck.counts["frozen"] == 4
    heartbeat = as_read("pressure_difference", time[:2], np.full(2, 80.0), **ON_CHANGE)
    assert heartbeat.counts["frozen"] == 0


def test_it_has_no_rate_to_set_the_time_base_by() -> None:
    slow = as_read("speed", seconds(50), np.arange(50.0))
    burst = as_read("pressure_difference", stamps(50), np.arange(50.0), **ON_CHANGE)
    assert grid_period_us({"speed": slow, "p": burst}) == SECOND
    assert grid_period_us({"p": burst}) == SECOND // 10


@pytest.mark.parametrize(("mean_of_s", "code"), [(10.0, None), (10.1, "means_too_long")])
def test_means_of_a_period_above_the_limit_are_refused_by_name(
    spec: MotorSpec, mean_of_s: float, code: str | None
) -> None:
    spec = with_channel(spec, "speed", sampling="mean", mean_of_s=mean_of_s)
    outcome = fit(spec, MOVING, MOVING.channels(configured_flow(spec, MOVING)))
    assert (outcome.status, outcome.error_code) == (FAILED if code else OK, code)
    assert not code or "speed is logged as means of 10.1 s" in (outcome.reason or "")


def test_a_mean_holds_over_its_period_and_is_not_averaged_again() -> None:
    time = np.arange(5, 100, 10, dtype=np.int64) * SECOND
    found = as_read("speed", time, np.arange(10.0), **MEANS)
    grid = np.array([-2, 1, 9, 12, 58, 61, 99, 102]) * SECOND
    value, present, silent = on_grid(found, grid, SECOND)
    assert value[present].tolist() == [0, 0, 1, 5, 6, 9]
    assert np.flatnonzero(silent).tolist() == [0, 7]
    lost = as_read("speed", np.delete(time, 4), np.delete(np.arange(10.0), 4), **MEANS)
    _, present, _ = on_grid(lost, np.array([35, 44, 46, 55]) * SECOND, SECOND)
    assert present.tolist() == [True, False, False, True]


def test_a_night_of_a_counter_of_litres(tmp_path: Path, spec: MotorSpec) -> None:
    """The flow from differences of a running total gives the loss factors of the flow itself."""
    keys = "volume_per_count_cm3 = 1000.0\ntime_offset_s = 0.5\n"
    text = motor_toml("M1", units=CANONICAL | {"leakage_flow": "count"})
    text = text.replace("[channels.leakage_flow]\n", f"[channels.leakage_flow]\n{keys}")
    flow = configured_flow(spec, MOVING)
    reference = fitted(spec, MOVING, flow)
    counted = fitted(load_motor(tmp_path, text), MOVING, 1e4 + np.cumsum(flow) / 60.0)
    thetas = [fit_of(sampled.rows)["coefficients"] for sampled in (counted, reference)]
    np.testing.assert_allclose(*thetas, rtol=1e-4)


LONG = Logs(format="csv", files=("*.csv",), layout="long")


def swinging(n: int) -> Array:
    return 100.0 + 20.0 * np.sin(np.arange(n) / 3.0)


def test_bad_samples_judge_no_others_and_blank_cells_are_none_however_bad() -> None:
    """Zeros of a broken sensor, flagged as such, make no spikes of what lies between them."""
    value = swinging(200)
    bad = np.flatnonzero(np.arange(200) % 3 > 0)
    value[bad] = 0.0
    found = as_read("pressure_difference", seconds(200), value, bad)
    assert refused_by(found) == {"bad_quality": len(bad), "any": len(bad)}
    # One column of qualities for all channels of a wide log: the row is of another one.
    slow = np.full(100, np.nan)
    slow[::10] = swinging(10)
    found = as_read("pressure_difference", seconds(100), slow, [3, 14, 15, 20])
    assert found.n_samples == 10
    assert refused_by(found) == {"bad_quality": 1, "any": 1}


SENT_S = np.array([0, 100, 200, 260, 500], dtype=np.int64) * SECOND
SENT = np.array([10.0, 20.0, 30.0, 40.0, 50.0])
LOST = np.array([10.0, 20.0, np.nan, 40.0, 50.0])


@pytest.mark.parametrize(
    ("value", "bad", "logs", "times", "refused", "ends"),
    [
        (SENT, [2], None, SENT_S, {"bad_quality": 1, "any": 1}, [2]),
        # As a historian marks that its source was lost.
        (LOST, [2], None, SENT_S, {"missing": 1, "bad_quality": 1, "any": 1}, [2]),
        # A blank of a wide log says nothing, and a row of its own that there is none.
        (LOST, [], None, np.delete(SENT_S, 2), {}, []),
        (LOST, [], LONG, SENT_S, {"missing": 1, "any": 1}, [2]),
    ],
)
def test_what_ends_a_value(
    value: Array,
    bad: list[int],
    logs: Logs | None,
    times: Times,
    refused: dict[str, int],
    ends: list[int],
) -> None:
    found = as_read("pressure_difference", SENT_S, value, bad, logs, **HELD)
    np.testing.assert_array_equal(found.time_us, times)
    assert (found.n_samples, refused_by(found)) == (len(times), refused)
    assert np.flatnonzero(found.ends).tolist() == ends
    assert np.flatnonzero(found.refused).tolist() == ends


RESOLUTION = {"pressure": 0.1, "temperature": 0.1, "speed": 0.1, "flow": 0.02}


def in_units(channel: str, value: Floats) -> Iterator[tuple[str, Floats]]:
    """Readings as they come out of a log in each unit, with all digits and in float32."""
    for unit in UNITS[QUANTITIES[channel]]:
        written = from_canonical(channel, value, unit)
        yield unit, to_canonical(channel, written, unit)
        single = written.astype(np.float32).astype(np.float64)
        yield f"{unit} float32", to_canonical(channel, single, unit)


def refused_in(channel: str, value: Floats) -> dict[str, int]:
    """Refused readings by rule, at 10 Hz, where no limit but that of spikes is near."""
    wide: dict[str, Any] = {"valid_range": (-1e4, 1e4)}
    resolution = RESOLUTION[QUANTITIES[channel]]
    return refused_by(as_read(channel, stamps(value.size), value, resolution=resolution, **wide))


@pytest.mark.parametrize("channel", CANONICAL)
@pytest.mark.parametrize("level", [1, 433, 1099])
def test_a_reading_as_many_steps_off_as_the_threshold_is_no_spike(channel: str, level: int) -> None:
    step, threshold = RESOLUTION[QUANTITIES[channel]], HAMPEL_THRESHOLD
    steps = np.full(101, float(level))
    steps[10::20] += threshold * np.array([1, -1, 1, -1, 1])
    for unit, value in in_units(channel, np.round(steps * step, 6)):
        assert refused_in(channel, value) == {}, unit
    steps[50] += np.sign(steps[50] - level)
    for unit, value in in_units(channel, np.round(steps * step, 6)):
        assert refused_in(channel, value) == {"spike": 1, "any": 1}, unit


@pytest.mark.parametrize("channel", CHANNELS)
@pytest.mark.parametrize("limits", [(0.0, 16.0), (-1.0, 60.0), (-20.0, 110.0), (-450.0, 450.0)])
def test_the_ends_of_a_range_are_within_it(channel: str, limits: tuple[float, float]) -> None:
    for unit, value in in_units(channel, np.array(limits)):
        # Of a temperature near 0 °C a float32 in K or °F has few digits left.
        if "float32" not in unit or QUANTITIES[channel] != "temperature":
            assert not out_of_range(value, limits).any(), unit
    outside = np.array([limits[0] - 0.02, limits[1] + 0.02])
    for unit, value in in_units(channel, outside):
        assert out_of_range(value, limits).all(), unit
