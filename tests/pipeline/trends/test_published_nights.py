"""What the watch gets of a motor: blocks, zeros, measured oil, baselines; nights made anew."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import polars as pl
import pytest

from leakage import OperatingConditions, regressors
from leakage.watch import Estimate, NightBlocks
from pipeline.config import Channel, MotorSpec
from pipeline.config.motor_types import OilSample
from pipeline.config.motors import CARRIED, Event
from pipeline.config.settings import Conditions
from pipeline.store.state import open_state
from pipeline.trends.checkpoint import blank_records
from pipeline.trends.course import Course
from pipeline.trends.decisions import FLOW_ZERO, PRESSURE_ZERO, Decision
from pipeline.trends.night_state import NightState
from pipeline.trends.nights import HALF, LONGEST_SILENCE, PublishedNights, every_night, period_at
from pipeline.trends.tasks import (
    NewestNight,
    Record,
    TrendMotor,
    circuit_of,
    note_touched,
    read_records,
    trend_hash,
    with_spans,
    write_record,
)
from pipeline.trends.trend_rows import (
    Zero,
    oil_as_measured,
    sensor_zeros,
    tolerance,
    viscosity_ratio,
)
from pipeline.trends.watch_columns import WatchColumns
from tests.pipeline.simulated import with_file
from tests.pipeline.trends.nights import (
    DAY,
    FIRST,
    N_BLOCKS,
    PATHS,
    SAMPLES,
    block_rows,
    event,
    motor,
    named,
    night_of,
    reset,
)

ESTIMATED = '[flushing]\nmode = "estimated"\nflow_l_per_min = 4.0\n'
FIXED = '[flushing]\nmode = "fixed"\nflow_l_per_min = 4.0\n'
REFERENCE = Conditions(200.0, 50.0, 30.0)


def read_by(spec: MotorSpec, rows: pl.DataFrame) -> tuple[WatchColumns, NightBlocks]:
    watch_columns = WatchColumns.of(spec, FIRST)
    return watch_columns, watch_columns.night_blocks(watch_columns.blocks(spec, rows))


def blocks(spec: MotorSpec) -> tuple[WatchColumns, NightBlocks, pl.DataFrame]:
    rows = block_rows(spec)
    return *read_by(spec, rows), rows


def theta_of(spec: MotorSpec, mode: str = "none") -> list[float]:
    return [path.configured_coefficient for path in spec.motor(FIRST, mode).column_paths]


def test_means_are_those_of_the_samples() -> None:
    """Flow and drives of a block by the law of each path, without the statistics in between."""
    spec = motor()
    watch_columns, night, rows = blocks(spec)
    assert (watch_columns.watched, watch_columns.gaps) == ((*PATHS, "known"), PATHS)
    assert night.day == FIRST.toordinal()
    names = ("temperature_c", "pressure_bar", "speed_rpm")
    celsius, bar, rpm = (rows[f"mean_{name}"][3] for name in names)
    at = OperatingConditions.from_bar(
        bar + np.linspace(-10.0, 10.0, SAMPLES), np.full(SAMPLES, celsius), np.full(SAMPLES, rpm)
    )
    columns = regressors(spec.motor(FIRST, "none"), at).mean(axis=0)
    assert night.drives[3] == pytest.approx(columns[[0, 1, 2, 4]])
    assert night.flow[3] == pytest.approx(columns @ [*theta_of(spec), 0.0, 1.0])
    assert night.conditions[3] == pytest.approx([celsius, bar, rpm])
    assert night.middle_s == pytest.approx(120.0 + 240.0 * np.arange(N_BLOCKS))


def test_an_estimated_flushing_is_a_path_and_a_stated_one_is_taken_off() -> None:
    _, without, rows = blocks(motor())
    flushed = motor(more=ESTIMATED)
    watch_columns, estimated, _ = blocks(flushed)
    assert watch_columns.watched == (*PATHS, "flushing", "known")
    assert estimated.drives[:, 3] == pytest.approx(1.0)
    flow = flushed.motor(FIRST, "estimated").constant.configured_coefficient
    assert estimated.flow == pytest.approx(without.flow + flow)
    watch_columns, fixed, _ = blocks(motor(more=FIXED))
    assert watch_columns.watched == (*PATHS, "known")
    assert fixed.flow == pytest.approx(without.flow)
    # Statistics of other columns do not count.
    assert WatchColumns.of(flushed, FIRST).blocks(flushed, rows) is not None
    other = rows.with_columns(factor_columns=rows["factor_columns"].list.head(3))
    assert watch_columns.blocks(motor(), other) is None
    # Design.md's placeholders at the reference conditions: 1.371423 l/min, without the flushing.
    drives = WatchColumns.of(flushed, FIRST).drives_at(flushed, FIRST, REFERENCE)
    leakage = np.asarray(drives) @ [*theta_of(flushed, "estimated"), 4.0, 1.0]
    assert leakage == pytest.approx(1.371423, rel=1e-6)


def test_a_roller_whose_scale_is_free_is_a_path_of_its_own() -> None:
    spec = motor()
    _, stated, rows = blocks(spec)
    free = replace(spec, roller_is_free=True)
    watch_columns, night = read_by(free, rows)
    (roller,) = set(watch_columns.paths) - set(PATHS)
    assert roller not in watch_columns.gaps
    assert watch_columns.watched == watch_columns.paths
    at = watch_columns.paths.index(roller)
    assert theta_of(free)[at] * night.drives[:, at] == pytest.approx(stated.drives[:, -1])
    assert night.flow == pytest.approx(stated.flow)


def logged(spec: MotorSpec) -> MotorSpec:
    """With a sensor of the oil's viscosity."""
    sensor = {"kinematic_viscosity": Channel(source="nu", unit="cSt")}
    return with_file(spec, channels=spec.file.channels | sensor)


def test_an_oil_that_is_measured_scales_what_it_drives_and_is_no_cause() -> None:
    """Thinner by a fifth than the data sheet: drives are larger by a quarter, near 40 °C."""
    spec = motor()
    sample = OilSample(date=FIRST, viscosity_40_c_mm2_per_s=0.8 * 68.0)
    watch_columns, sheet, rows = blocks(spec)
    _, night = read_by(with_file(spec, oil_samples=(sample,)), rows)
    assert (night.drives / sheet.drives).min() > 1.15
    assert night.flow == pytest.approx(sheet.flow)
    # Kinematic viscosity of the VG 68 of the data sheet at 40 and 100 °C.
    assert watch_columns.machine(spec, FIRST).oil == pytest.approx((68.0, 8.7), rel=1e-3)
    assert watch_columns.machine(logged(spec), FIRST).oil is None


N, AT, FEW = 100, 60, 20
SCATTER = 0.002


def nights_with(
    columns: Mapping[str, Any], spec: MotorSpec | None = None, *decisions: Decision, n: int = N
) -> PublishedNights:
    """Nights in a row, with columns of what is remembered of them."""
    records = blank_records([night_of(place) for place in range(n)])
    for name, values in columns.items():
        records[name] = values
    return PublishedNights(TrendMotor(spec or motor(), decisions), records=records)


def halts(moved: np.ndarray | float, pressure: np.ndarray | float = 0.0) -> dict[str, np.ndarray]:
    """Zeros of every night's halts: how far flow [l/min] and pressure [bar] have moved."""
    generator = np.random.default_rng(3)
    flow = moved + SCATTER * generator.standard_normal(N)
    zero = pressure + 0.1 * generator.standard_normal(N)
    return {
        "flow_zero_l_per_min": flow,
        "flow_zero_upper": flow + HALF * SCATTER,
        "pressure_zero_bar": zero,
        "pressure_zero_upper": zero + HALF * 0.1,
    }


def moved(size: float, first: int = AT, end: int = N) -> np.ndarray:
    places = np.arange(N)
    return np.where((places >= first) & (places < end), size, 0.0)


def zeros_of(
    columns: dict[str, np.ndarray], spec: MotorSpec | None = None, *decisions: Decision
) -> dict[str, Zero]:
    return sensor_zeros(nights_with(columns, spec, *decisions))


def test_a_drift_is_reported_with_its_size() -> None:
    """A drift of 0.02 l/min moves K of the rings by 11 % (model.md, section 5)."""
    zeros = zeros_of(halts(moved(0.02)))
    zero = zeros[FLOW_ZERO]
    # By the end the last thirty halts, all of them after the step, stand against the first thirty.
    assert zero.lower[-1] <= 0.02 <= zero.upper[-1]
    # Half of them lie behind the step once their mean is beyond the tolerance of 0.01 l/min.
    assert AT < zero.state.index("warning") <= AT + 15 + 5
    words = zero.words(N - 1)
    assert words.startswith("the zero of the flow sensor has moved by +0.0")
    assert words.endswith("]: check it before the motor")
    assert (zero.state[AT - 1], zero.words(AT - 1)) == ("ok", "")
    assert set(zeros[PRESSURE_ZERO].state[10:]) == {"ok"}


@pytest.mark.parametrize(("half_width", "is_notice"), [(0.02, True), (0.001, False)])
def test_a_pressure_zero_is_a_notice_until_it_moves_the_leakage(
    *, half_width: float, is_notice: bool
) -> None:
    """A bar at 200 bar is some 0.3 % of the leakage: work beside an interval of 0.1 %."""
    spec = motor()
    watch_columns, sensors = WatchColumns.of(spec, FIRST), zeros_of(halts(0.0, moved(1.0)), spec)
    drives = SimpleNamespace(drives_at=lambda at, _: watch_columns.drives_at(spec, FIRST, at))
    night = SimpleNamespace(
        place=N - 1,
        baseline=SimpleNamespace(own=REFERENCE, coefficients=(*theta_of(spec), 1.0)),
        verdict=SimpleNamespace(present=Estimate(0.0, half_width / 1.96)),
    )
    course, state = cast(Course, drives), cast(NightState, night)
    zero = sensors[PRESSURE_ZERO]
    assert zero.state[-1] == "warning"
    assert zero.is_notice(course, state) == is_notice
    assert not sensors[FLOW_ZERO].is_notice(course, state)
    assert ("check it" in zero.words(N - 1, is_notice=is_notice)) != is_notice


def test_a_move_within_the_stated_tolerance_is_none() -> None:
    stated = motor(more="offset_tolerance = 0.05\n")  # of leakage_flow, the last channel
    assert (tolerance(stated, FLOW_ZERO), tolerance(motor(), FLOW_ZERO)) == (0.05, 0.01)
    assert set(zeros_of(halts(moved(0.03)), stated)[FLOW_ZERO].state[10:]) == {"ok"}


def test_nights_without_a_halt_hold_and_no_night_hangs_on_a_later_one() -> None:
    whole, first = halts(moved(0.03)), halts(moved(0.03))
    for values in first.values():
        values[90:] = np.nan
    state = zeros_of(first)[FLOW_ZERO].state
    assert set(state[90:]) == {"warning"}
    assert state[:90] == zeros_of(whole)[FLOW_ZERO].state[:90]


def test_a_sensor_that_was_put_right_begins_anew() -> None:
    wrong = halts(moved(0.03, 40, 70))
    state = zeros_of(wrong, None, reset(70, note="calibrated"))[FLOW_ZERO].state
    assert (state[69], set(state[70:79]), state[-1]) == ("warning", {"insufficient"}, "ok")
    overhauled = named(motor(), "M1", events=[event(70, "overhaul")])
    assert zeros_of(wrong, overhauled)[FLOW_ZERO].state[-1] == "ok"


def test_where_the_flushing_is_estimated_nobody_knows_the_flow_sensors_zero() -> None:
    zeros = zeros_of(halts(moved(0.3)), motor(more=ESTIMATED))
    assert set(zeros[FLOW_ZERO].state) == {"insufficient"}
    assert zeros[PRESSURE_ZERO].state[-1] == "ok"


def sample(place: int, at_40: float) -> OilSample:
    return OilSample(date=night_of(place), viscosity_40_c_mm2_per_s=at_40)


def sampled(*samples: OilSample) -> MotorSpec:
    return with_file(motor(), oil_samples=samples)


@pytest.mark.parametrize(
    ("spec", "ratio", "expected"),
    [
        (sampled(), None, ""),
        (
            sampled(sample(0, 54.4)),
            0.8,
            "oil as measured on 2 January 2026: 20 % thinner than its data sheet",
        ),
        (
            sampled(sample(5, 75.0)),
            1.1,
            "oil as measured on 7 January 2026: 10 % thicker than its data sheet",
        ),
        (logged(motor()), 0.9, "oil as measured by the log: 10 % thinner than its data sheet"),
    ],
)
def test_words_on_a_measured_oil(spec: MotorSpec, ratio: float | None, expected: str) -> None:
    """Of nights that from the sixth on have a viscosity over the data sheet's."""
    ratios = [np.nan if place < 5 or ratio is None else ratio for place in range(FEW)]
    nights = nights_with({"viscosity": ratios}, spec, n=FEW)
    assert oil_as_measured(nights, FEW - 1) == expected
    assert viscosity_ratio(nights, FEW - 1) == ratio
    assert viscosity_ratio(nights, 4) is None


Begins = list[tuple[int, str]]


def begins(
    spec: MotorSpec,
    *decisions: Decision,
    models: Mapping[int, str] | None = None,
    of: str = "leakage",
) -> Begins:
    """Baseline periods of nights with statistics of these models, else of their oil's."""
    made = [(models or {}).get(n, spec.file.oil_on(night_of(n))).encode() for n in range(FEW)]
    nights = nights_with({"known": True, "model": made}, spec, *decisions, n=FEW)
    periods = nights.periods(of)
    for period in periods:
        assert period_at(periods, period.first) is period_at(periods, period.end - 1) is period
    return [(period.first, period.reason) for period in periods]


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
def test_what_begins_a_baseline(events: tuple[Event, ...], further: Begins) -> None:
    assert begins(named(motor(), "M1", events=events)) == [(0, "first nights"), *further]


def test_other_settings_of_the_statistics_begin_one() -> None:
    models = dict.fromkeys(range(12, FEW), "other")
    periods = begins(motor(), models=models)
    assert periods == [(0, "first nights"), (12, f"other settings from {night_of(12)}")]
    # A night without statistics is of none.
    assert begins(motor(), models=models | {12: ""})[1][0] == 13


@pytest.mark.parametrize(
    ("of", "expected"),
    [("leakage", [0, 5, 8]), ("flow_zero", [0, 5, 11]), ("pressure_zero", [0, 5])],
)
def test_a_reset_is_of_the_leakage_or_of_a_sensor(of: str, expected: list[int]) -> None:
    resets = reset(5), reset(8, "K_piston_ring"), reset(11, "flow_zero")
    periods = begins(motor(), *resets, of=of)
    assert [first for first, _ in periods] == expected
    assert periods[1][1] == f"reset from {night_of(5)}"


def test_every_night_is_one_until_a_motor_was_silent_for_long() -> None:
    records = blank_records([night_of(0), night_of(3)])
    records["known"] = True
    until = night_of(3 + LONGEST_SILENCE + 50)
    every = every_night(records, until)
    assert every["night"].tolist() == [night_of(0) + n * DAY for n in range(4 + LONGEST_SILENCE)]
    assert every["known"].nonzero()[0].tolist() == [0, 3]
    assert len(every_night(records, night_of(-1))) == 0
    # Once more, as a run finds them kept: blank nights are no nights of a log.
    assert every_night(every, until).tobytes() == every.tobytes()


# Nights whose trends are made anew


def test_a_motor_whose_flow_is_all_flushing_has_no_leakage_by_any_oil() -> None:
    watch = SimpleNamespace(frozen_leakage_at=lambda *_: 0.0)
    baseline = SimpleNamespace(own=Conditions(100.0, 50.0, 30.0), end=night_of(7), own_leakage=0.0)
    course: Any = SimpleNamespace(
        watch=watch,
        baseline=baseline,
        nights=SimpleNamespace(place_from=lambda _: 7),
        drives_at=lambda *_: np.zeros(1),
    )
    assert Course.first_leakage(course, 20) == 0.0


SPECS = (named(motor(), "A", "t"), named(motor(), "B", "t"))
OTHER_OIL = (named(motor(), "A", "t", [event(20, "oil_change", oil="vg46")]), SPECS[1])
RESET = reset(20, motor_id="A")
ALL = (dt.date.min, night_of(39))


def span(first: int, last: int = 39) -> tuple[dt.date, dt.date]:
    return night_of(first), night_of(last)


@pytest.mark.parametrize(
    ("last", "changed", "decisions", "specs", "expected"),
    [
        pytest.param(None, {"A": 0, "B": None}, (), SPECS, {"A": ALL, "B": ALL}, id="at first"),
        pytest.param(
            37, {"A": 38, "B": None}, (), SPECS, {"A": span(38), "B": span(38)}, id="new nights"
        ),
        pytest.param(
            39, {"A": 20, "B": None}, (), SPECS, {"A": span(20), "B": span(20)}, id="a late log"
        ),
        pytest.param(
            39, {"A": None, "B": None}, (RESET,), SPECS, {"A": ALL}, id="a reset: that motor"
        ),
        pytest.param(
            39,
            {"A": None, "B": None},
            (replace(RESET, kind="acknowledged"),),
            SPECS,
            {},
            id="an acknowledgement",
        ),
        pytest.param(
            35, {"A": 30}, (), SPECS, {"A": span(30), "B": span(30, 35)}, id="not asked for"
        ),
        pytest.param(
            39, {"A": 20, "B": None}, (), OTHER_OIL, {"A": ALL}, id="settings of its own: no other"
        ),
    ],
)
def test_which_nights_are_to_be_made(
    tmp_path: Path,
    last: int | None,
    changed: dict[str, int | None],
    decisions: tuple[Decision, ...],
    specs: tuple[object, ...],
    expected: dict[str, tuple[dt.date, dt.date]],
) -> None:
    asked = {name: None if place is None else night_of(place) for name, place in changed.items()}
    assert to_be_made(tmp_path, asked, last, decisions, specs) == expected


def to_be_made(
    output: Path,
    changed: dict[str, dt.date | None],
    last: int | None,
    decisions: tuple[Decision, ...] = (),
    specs: tuple[object, ...] = SPECS,
    touched: tuple[tuple[str, dt.date], ...] = (),
) -> dict[str, tuple[dt.date, dt.date]]:
    """Spans of nights to be made, of motors whose trends are published up to a last one."""
    with open_state(output) as state:
        for spec in SPECS if last is not None else ():
            write_record(state, spec.motor_id, Record(trend_hash(spec, ()), night_of(last)))
        note_touched(state, touched)
        circuit = circuit_of(specs, decisions, read_records(state), {})
    motors = with_spans(circuit, changed, NewestNight(night_of(39)))
    asked = (motor for motor in motors if motor.first is not None)
    return {motor.spec.motor_id: (motor.first, motor.until) for motor in asked}


def test_what_a_broken_run_left_is_done_by_the_next(tmp_path: Path) -> None:
    touched = (("B", night_of(25)), ("B", night_of(31)), ("C", night_of(0)))
    spans = to_be_made(tmp_path, {"A": None, "B": None}, 39, touched=touched)
    assert spans == {"A": span(25), "B": span(25)}
