"""What the watch is told of a motor: its blocks, zeros, oil as measured, and new baselines."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import polars as pl
import pytest

from leakage import OperatingConditions, regressors
from leakage.watch import Estimate, NightBlocks
from pipeline.config import Channel, MotorSpec
from pipeline.config.motors import Event
from pipeline.config.oil_samples import OilSample
from pipeline.config.settings import Conditions
from pipeline.schema import BLOCKS
from pipeline.trends.nights.decisions import FLOW_ZERO, PRESSURE_ZERO, Decision
from pipeline.trends.nights.history import (
    CARRIED,
    LONGEST_SILENCE,
    History,
    blank_records,
    every_night,
    period_at,
    periods_of,
)
from pipeline.trends.nights.watch_columns import WatchColumns
from pipeline.trends.rows.trend_rows import oil_as_measured, viscosity_ratio
from pipeline.trends.states.course import Course
from pipeline.trends.states.night_state import NightState
from pipeline.trends.states.zeros import HALF, Zero, sensor_zeros, tolerance
from tests.pipeline.simulated import with_file
from tests.pipeline.trends.nights import (
    FIRST,
    N_BLOCKS,
    PATHS,
    SAMPLES,
    Nights,
    event,
    motor,
    named,
    night_of,
    reset,
)

ESTIMATED = '[flushing]\nmode = "estimated"\nflow_l_per_min = 4.0\n'
FIXED = '[flushing]\nmode = "fixed"\nflow_l_per_min = 4.0\n'


def read_by(spec: MotorSpec, rows: pl.DataFrame) -> tuple[WatchColumns, NightBlocks]:
    watch_columns = WatchColumns.of(spec, FIRST)
    stored = watch_columns.blocks(spec, rows)
    return watch_columns, watch_columns.night_blocks(stored)


def blocks(spec: MotorSpec, **more: Any) -> tuple[WatchColumns, NightBlocks, pl.DataFrame]:
    rows = Nights(spec, 1, noise=0.0, **more).frames()[BLOCKS.name]
    return *read_by(spec, rows), rows


def test_means_are_those_of_the_samples() -> None:
    """Flow and drives of a block by the law of each path, without the statistics in between."""
    spec = motor()
    watch_columns, found, rows = blocks(spec)
    assert watch_columns.watched == (*PATHS, "known")
    assert watch_columns.gaps == PATHS
    assert found.day == night_of(0).toordinal()
    bar = rows["mean_pressure_bar"][3] + np.linspace(-10.0, 10.0, SAMPLES)
    at = OperatingConditions.from_bar(
        bar,
        np.full(SAMPLES, rows["mean_temperature_c"][3]),
        np.full(SAMPLES, rows["mean_speed_rpm"][3]),
    )
    columns = regressors(spec.motor(FIRST, "none"), at).mean(axis=0)
    assert found.drives[3] == pytest.approx(columns[[0, 1, 2, 4]])
    theta = [path.configured_coefficient for path in spec.motor(FIRST, "none").column_paths]
    assert found.flow[3] == pytest.approx(columns @ [*theta, 0.0, 1.0])
    assert found.conditions[3] == pytest.approx(
        [rows[f"mean_{name}"][3] for name in ("temperature_c", "pressure_bar", "speed_rpm")]
    )
    assert found.middle_s == pytest.approx(120.0 + 240.0 * np.arange(N_BLOCKS))


def test_an_estimated_flushing_is_a_path_and_a_stated_one_is_taken_off() -> None:
    _, without, _ = blocks(motor())
    watch_columns, estimated, _ = blocks(motor(more=ESTIMATED), wear={"C_f": np.ones(1)})
    assert watch_columns.watched == (*PATHS, "flushing", "known")
    assert estimated.drives[:, 3] == pytest.approx(1.0)
    flow = motor(more=ESTIMATED).motor(FIRST, "estimated").constant
    assert estimated.flow == pytest.approx(without.flow + flow.configured_coefficient)
    watch_columns, fixed, _ = blocks(motor(more=FIXED))
    assert watch_columns.watched == (*PATHS, "known")
    assert fixed.flow == pytest.approx(without.flow)


def test_a_roller_whose_scale_is_free_is_a_path_of_its_own() -> None:
    spec = motor()
    _, stated, rows = blocks(spec)
    free = replace(spec, roller_is_free=True)
    watch_columns, found = read_by(free, rows)
    (roller,) = set(watch_columns.paths) - set(PATHS)
    assert roller not in watch_columns.gaps
    assert watch_columns.watched == watch_columns.paths
    at = watch_columns.paths.index(roller)
    scale = free.motor(FIRST, "none").column_paths[at].configured_coefficient
    assert scale * found.drives[:, at] == pytest.approx(stated.drives[:, -1])
    assert found.flow == pytest.approx(stated.flow)


def test_a_measured_oil_scales_what_it_drives() -> None:
    """Thinner by a fifth than the data sheet: drives are larger by a quarter, near 40 °C."""
    spec = motor()
    oil = spec.oil_on(FIRST).oil()
    sample = OilSample(date=FIRST, viscosity_40_c_mm2_per_s=0.8 * 68.0)
    measured = with_file(spec, oil_samples=(sample,))
    _, sheet, rows = blocks(spec)
    _, found = read_by(measured, rows)
    assert (found.drives / sheet.drives).min() > 1.15
    assert found.flow == pytest.approx(sheet.flow)
    assert oil.walther_b == pytest.approx(measured.oil_on(FIRST).oil().walther_b)


def test_statistics_of_other_columns_do_not_count() -> None:
    _, _, rows = blocks(motor())
    flushed = motor(more=ESTIMATED)
    assert WatchColumns.of(flushed, FIRST).blocks(flushed, rows) is not None
    other = rows.with_columns(factor_columns=rows["factor_columns"].list.head(3))
    assert WatchColumns.of(motor(), FIRST).blocks(motor(), other) is None


def logged(spec: MotorSpec) -> MotorSpec:
    """With a sensor of the oil's viscosity."""
    sensor = {"kinematic_viscosity": Channel(source="nu", unit="cSt")}
    return with_file(spec, channels=spec.file.channels | sensor)


def test_the_oil_is_a_cause_unless_it_is_measured() -> None:
    """Kinematic viscosity of the VG 68 of the data sheet at 40 and 100 °C."""
    spec = motor()
    watch_columns = WatchColumns.of(spec, FIRST)
    assert watch_columns.machine(spec, FIRST).oil == pytest.approx((68.0, 8.7), rel=1e-3)
    assert watch_columns.machine(logged(spec), FIRST).oil is None


def test_drives_at_conditions_are_without_the_flushing() -> None:
    spec = motor(more=ESTIMATED)
    watch_columns = WatchColumns.of(spec, FIRST)
    at = Conditions(200.0, 50.0, 30.0)
    found = watch_columns.drives_at(spec, FIRST, at)
    theta = [path.configured_coefficient for path in spec.motor(FIRST, "estimated").column_paths]
    # Design.md's placeholders: 1.371423 l/min at the reference conditions.
    assert np.asarray(found) @ [*theta, 4.0, 1.0] == pytest.approx(1.371423, rel=1e-6)


N, AT = 100, 60
FEW = 20
SCATTER = 0.002


def history(
    columns: Mapping[str, Any], spec: MotorSpec | None = None, *said: Decision, n: int = N
) -> History:
    """Nights in a row, with columns of what is remembered of them."""
    spec = spec or motor()
    records = blank_records([night_of(place) for place in range(n)])
    for name, values in columns.items():
        records[name] = values
    return History(spec, WatchColumns.of(spec, night_of(0)), records, said)


def zeros(moved: np.ndarray, seed: int = 3) -> dict[str, np.ndarray]:
    """Halts of every night: the zero of the flow has moved so far [l/min], the other has not."""
    generator = np.random.default_rng(seed)
    flow = moved + SCATTER * generator.standard_normal(N)
    pressure = 0.1 * generator.standard_normal(N)
    return {
        "flow_zero_l_per_min": flow,
        "flow_zero_upper": flow + HALF * SCATTER,
        "pressure_zero_bar": pressure,
        "pressure_zero_upper": pressure + HALF * 0.1,
    }


def watched(
    halts: dict[str, np.ndarray], spec: MotorSpec | None = None, *said: Decision
) -> dict[str, Zero]:
    """Zeros of a motor's sensors over nights with these halts."""
    return sensor_zeros(history(halts, spec, *said))


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
    assert zero.state[AT - 1] == "ok"


@pytest.mark.parametrize(("half_width", "is_notice"), [(0.02, True), (0.001, False)])
def test_a_pressure_zero_is_a_notice_until_it_moves_the_leakage(
    *, half_width: float, is_notice: bool
) -> None:
    """A bar at 200 bar is some 0.3 % of the leakage: work beside an interval of 0.1 %."""
    halts = zeros(np.zeros(N))
    halts["pressure_zero_bar"][AT:] += 1.0
    halts["pressure_zero_upper"][AT:] += 1.0
    spec, at = motor(), Conditions(200.0, 50.0, 30.0)
    layout, sensors = WatchColumns.of(spec, FIRST), watched(halts, spec)
    paths = spec.motor(FIRST, "none").column_paths
    course = cast(
        Course,
        SimpleNamespace(drives_at=lambda at, _: np.asarray(layout.drives_at(spec, FIRST, at))),
    )
    n_known = len(course.drives_at(at, 0)) - len(paths)
    theta = (*(path.configured_coefficient for path in paths), *[1.0] * n_known)
    night = cast(
        NightState,
        SimpleNamespace(
            place=N - 1,
            baseline=SimpleNamespace(own=at, coefficients=theta),
            verdict=SimpleNamespace(present=Estimate(0.0, half_width / 1.96)),
        ),
    )
    zero = sensors[PRESSURE_ZERO]
    assert zero.state[-1] == "warning"
    assert zero.is_notice(course, night) == is_notice
    assert not sensors[FLOW_ZERO].is_notice(course, night)
    words = zero.words(N - 1, is_notice=is_notice)
    assert ("check it" in words) != is_notice


def test_a_move_within_the_stated_tolerance_is_none() -> None:
    stated = motor(more="offset_tolerance = 0.05\n")  # of leakage_flow, the last channel
    assert tolerance(stated, FLOW_ZERO) == 0.05
    assert set(watched(stepped(0.03), stated)[FLOW_ZERO].state[10:]) == {"ok"}
    assert tolerance(motor(), FLOW_ZERO) == 0.01
    assert watched(stepped(0.03))[FLOW_ZERO].state[-1] == "warning"


def test_nights_without_a_halt_hold_and_no_night_hangs_on_a_later_one() -> None:
    whole, first = stepped(0.03), stepped(0.03)
    for values in first.values():
        values[90:] = np.nan
    state = watched(first)[FLOW_ZERO].state
    assert set(state[90:]) == {"warning"}
    assert state[:90] == watched(whole)[FLOW_ZERO].state[:90]


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


def sample(place: int, at_40: float | None = None, water: float | None = None) -> OilSample:
    return OilSample(date=night_of(place), viscosity_40_c_mm2_per_s=at_40, water_mg_per_kg=water)


def with_ratio(spec: MotorSpec, ratio: float | None) -> History:
    """Nights that from the sixth on have a viscosity over the data sheet's."""
    ratios = [np.nan if place < 5 or ratio is None else ratio for place in range(FEW)]
    return history({"viscosity": ratios}, spec, n=FEW)


@pytest.mark.parametrize(
    ("samples", "ratio", "expected"),
    [
        ((), None, ""),
        ((sample(0, 54.4),), 0.8, "oil as measured on 2 January 2026: 20 % thinner"),
        ((sample(5, 75.0),), 1.1, "10 % thicker than its data sheet"),
        ((sample(0, water=70.0),), None, ""),
    ],
)
def test_words_on_a_measured_oil(
    samples: tuple[OilSample, ...], ratio: float | None, expected: str
) -> None:
    said = oil_as_measured(with_ratio(with_file(motor(), oil_samples=samples), ratio), FEW - 1)
    assert expected in said
    assert bool(said) == bool(expected)


def test_a_sensor_measures_every_night() -> None:
    found = with_ratio(logged(motor()), 0.9)
    assert oil_as_measured(found, FEW - 1).startswith("oil as measured by the log: 10 % thinner")
    assert viscosity_ratio(found, FEW - 1) == 0.9
    assert viscosity_ratio(found, 4) is None


def of_models(
    spec: MotorSpec | None = None, *said: Decision, models: Mapping[int, str] | None = None
) -> History:
    """Nights with statistics of these models, else of their oil's."""
    spec = spec or motor()
    made = [(models or {}).get(n, spec.file.oil_on(night_of(n))).encode() for n in range(FEW)]
    return history({"known": True, "model": made}, spec, *said, n=FEW)


def begins(found: History, of_what: str = "leakage") -> list[tuple[int, str]]:
    return [(one.first, one.reason) for one in periods_of(found, of_what)]


@pytest.mark.parametrize(
    ("events", "further"),
    [
        ((), []),
        ((event(9, "overhaul", note="new rings"),), [(9, f"overhaul on {night_of(9)}: new rings")]),
        # Before the first night, or after the last.
        ((event(-5, "overhaul"), event(FEW, "overhaul")), []),
        ((event(5, "note", note="filter changed"),), []),
        # Neither the event nor its other hash: the motor is the same (model.md, 7c.6).
        *((((event(9, kind, oil="vg46"),), [])) for kind in CARRIED),
    ],
)
def test_what_begins_an_era(events: tuple[Event, ...], further: list[tuple[int, str]]) -> None:
    found = of_models(named(motor(), "M1", events=events))
    assert begins(found) == [(0, "first nights"), *further]
    for place, reason in further:
        assert period_at(periods_of(found), place - 1).reason == "first nights"
        assert period_at(periods_of(found), place).reason == reason


def test_other_settings_of_the_statistics_begin_one() -> None:
    models = dict.fromkeys(range(12, FEW), "other")
    found = of_models(models=models)
    assert begins(found) == [(0, "first nights"), (12, f"other settings from {night_of(12)}")]
    # A night without statistics is of none.
    assert begins(of_models(models=models | {12: ""}))[1][0] == 13


def test_a_reset_is_of_the_leakage_or_of_a_sensor() -> None:
    every, ring, zero = reset(5), reset(8, "K_piston_ring"), reset(11, "flow_zero")
    found = of_models(None, every, ring, zero)
    assert [first for first, _ in begins(found)] == [0, 5, 8]
    assert [first for first, _ in begins(found, "flow_zero")] == [0, 5, 11]
    assert [first for first, _ in begins(found, "pressure_zero")] == [0, 5]
    assert begins(found)[1][1] == f"reset from {night_of(5)}"


def test_every_night_is_one_until_a_motor_was_silent_for_long() -> None:
    records = blank_records([night_of(0), night_of(3)])
    records["known"] = True
    until = night_of(3 + LONGEST_SILENCE + 50)
    found = every_night(records, until)
    assert found["night"].tolist() == [
        night_of(0) + dt.timedelta(days=n) for n in range(4 + LONGEST_SILENCE)
    ]
    assert found["known"].nonzero()[0].tolist() == [0, 3]
    assert len(every_night(records, night_of(-1))) == 0
    # Once more, as a run finds them kept: blank nights are no nights of a log.
    assert every_night(found, until).tobytes() == found.tobytes()
