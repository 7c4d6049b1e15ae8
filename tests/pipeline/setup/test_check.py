"""`check`: what is wrong with config and logs, before a night depends on them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from pipeline.config import Channel, load_fleet
from pipeline.demo.fleet import correlated_noise
from pipeline.ingest import RawChannel, RawLog
from pipeline.setup.check import MotorCheck, check_motor
from pipeline.setup.samples import (
    ChannelCheck,
    misplaced,
    mostly_refused,
    sampling_note,
    unread,
)
from tests.conftest import OwnFleet
from tests.pipeline.calling import change
from tests.pipeline.simulated import (
    NIGHT,
    load_motor,
    motor_toml,
    operate,
    write_configs,
    write_log,
)

MOTORS = ["CB1120-01", "CB1120-02", "CB400-01", "CB400-02", "CB560-01", "CB560-02"]


def checks_of(fleet_file: Path) -> dict[str, MotorCheck]:
    return {check.motor_id: check for check in map(check_motor, load_fleet(fleet_file).motors)}


def test_a_sound_fleet_of_which_no_log_is_hashed_or_read_to_its_end(
    demo_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A year of logs is looked at in seconds."""

    def forbidden(*_: object) -> object:
        raise AssertionError

    monkeypatch.setattr("pipeline.logs.files.content_hash", forbidden)
    monkeypatch.setattr("pipeline.logs.files.read_log", forbidden)
    checks = checks_of(demo_folder / "configs" / "fleet.toml")
    assert list(checks) == MOTORS
    for motor, check in checks.items():
        assert motor.startswith(check.motor_type)
        assert (check.n_files, check.n_nights) == (3, 3)
        assert (check.first, check.last) == ("2026-01-02", "2026-01-04")
        assert check.faults == ()
        assert check.placeholders
    assert [checks[motor].log_format for motor in MOTORS] == [
        *("parquet", "mcap", "csv", "parquet", "mcap", "csv")
    ]


def logged(
    folder: Path,
    log: str = "a.parquet",
    minutes: float = 40.0,
    files: str = '"M1/*.parquet"',
    **values: ArrayLike,
) -> MotorCheck:
    """Check of a motor with one log, of which some channels are others."""
    operation = operate(minutes=minutes)
    channels = operation.channels(operation.pressure_bar / 100.0)
    for name, value in values.items():
        value = np.broadcast_to(value, channels[name].shape)
        # No sensor shows the same figure for an hour.
        channels[name] = value + 1e-3 * np.sin(np.arange(value.size))
    write_log(folder / "logs" / "M1" / log, operation.time_us, channels)
    return checks_of(write_configs(folder, {"M1": motor_toml("M1", files=files)}))["M1"]


def test_a_name_that_is_absent_is_a_fault_and_a_pattern_without_a_match_a_note(
    tmp_path: Path,
) -> None:
    files = '"M1/a?1?.parquet", "M1/b.parquet", "M1/*/late-*.parquet"'
    check = logged(tmp_path, "a[1].parquet", files=files)
    assert check.n_files == 1
    assert [fault.split(": ")[:2] for fault in check.faults if "log_" in fault] == [
        ["log_missing", "M1/b.parquet"]
    ]
    assert check.notes[-1].startswith("no file matches M1/*/late-*.parquet below ")


OF_UNIT = {"kPa": "pressure_difference", "K": "oil_temperature", "m3/h": "leakage_flow"}


@pytest.mark.parametrize("wrong", [("kPa",), ("m3/h",), ("kPa", "K"), ("K", "m3/h")])
def test_a_wrong_unit_is_suspected_the_right_one_named_and_no_other(
    own_fleet: OwnFleet, wrong: tuple[str, ...]
) -> None:
    """The flow is judged once the units of what it is judged by are right."""
    fleet = own_fleet("CB1120-01")
    for right, other in {"kPa": "bar", "K": "degC", "m3/h": "l/min"}.items():
        if right in wrong:
            change(fleet, "motors/CB1120-01.toml", f'"{right}"', f'"{other}"')
    judged = [right for right in wrong if right != "m3/h"] or ["m3/h"]
    faults = sorted(checks_of(fleet)["CB1120-01"].faults)
    for fault, right in zip(faults, sorted(judged, key=OF_UNIT.__getitem__), strict=True):
        assert fault.startswith(f"unit_unusual: {OF_UNIT[right]}: ")
        assert right in fault


def test_a_flow_that_does_not_fit_wrong_units_of_a_usual_size(own_fleet: OwnFleet) -> None:
    """20 MPa taken for 20 bar and 50 °C for 50 °F are usual; only the flow does not fit them."""
    fleet = own_fleet("CB400-01")
    change(fleet, "motors/CB400-01.toml", 'unit = "bar"', 'unit = "bar"\nscale = 0.1')
    change(fleet, "motors/CB400-01.toml", 'unit = "degC"', 'unit = "degF"')
    header, flow = checks_of(fleet)["CB400-01"].faults
    assert header.startswith("unit_differs: oil_temperature: configured in degF, and the log says")
    assert flow.startswith("unit_unusual: leakage_flow: ")
    assert "l/min, which is unusual where the model has 0.0" in flow


STILL = {"pressure_difference": 150.0, "speed": 30.0, "oil_temperature": 50.0}
HALTED = {"speed": operate(minutes=60.0).speed_rpm * (np.arange(3600) < 240)}


@pytest.mark.parametrize(
    ("minutes", "values", "words"),
    [
        (40.0, {}, ("40 minutes", "279 bar (93 %)", "; first verdict on a change after 8 nights")),
        # 5 minutes of training are 80 % of a night.
        (60.0, HALTED, ("4 minutes", "too little for a fit, which needs 6.25 minutes")),
        (60.0, STILL, ("150 to 150 bar (0 %), speed 30 to 30 rpm (0 %)",)),
    ],
    ids=["long", "halted", "one condition"],
)
def test_what_a_night_has(
    tmp_path: Path, minutes: float, values: dict[str, ArrayLike], words: tuple[str, ...]
) -> None:
    note = logged(tmp_path, minutes=minutes, **values).notes[0]
    assert all(word in note for word in words), note


def test_a_flow_that_follows_neither_pressure_nor_viscosity(tmp_path: Path) -> None:
    spec = load_motor(tmp_path, motor_toml("M1"))
    flow = operate(minutes=40.0).flow(spec.motor(NIGHT, "none"))
    strange = 1.5 + 0.3 * np.sin(np.arange(2400) ** 2)
    for values, is_odd in ((flow, False), (strange, True)):
        notes = "".join(logged(tmp_path, leakage_flow=values).notes)
        assert ("the drain flow follows neither" in notes) == is_odd


def daily_logs(tmp_path: Path, header_of: Callable[[int], str]) -> Path:
    """Logs of 10 to 19 March, each of a few rows in the evening; returns the fleet file."""
    fleet = write_configs(
        tmp_path,
        {"M1": motor_toml("M1", files='"*.csv"').replace('"parquet"', '"csv"\nunit_rows = 1')},
    )
    for day in range(10, 20):
        rows = [f"2026-03-{day}T22:00:0{i}Z,150.{i},50.5,30.5,1.2" for i in range(9)]
        log = tmp_path / "logs" / f"2026-03-{day}.csv"
        log.write_text("\n".join([header_of(day), *rows]) + "\n", "utf-8")
    return fleet


COLUMNS = "time,pressure_difference,oil_temperature,speed,leakage_flow\n,bar,degC,rpm,l/min"


@pytest.mark.parametrize(
    ("changed", "faults"),
    [
        pytest.param({}, [], id="nothing"),
        pytest.param(
            {("oil_temperature", "T_OIL"): range(14, 20)},
            [
                "column_gone: the log of 15 March 2026 (2026-03-14.csv) has no column "
                "'oil_temperature'; new in it: 'T_OIL'; no longer in it: 'oil_temperature'"
            ],
            id="renamed",
        ),
        pytest.param(
            {("leakage_flow", "q"): range(12), ("speed", "n_motor"): range(17)},
            [
                "column_gone: the log of 18 March 2026 (2026-03-17.csv) is the first with column "
                "'speed'; new in it: 'speed'; no longer in it: 'n_motor'",
                "column_gone: the log of 13 March 2026 (2026-03-12.csv) is the first with column "
                "'leakage_flow'; new in it: 'leakage_flow'; no longer in it: 'q'",
            ],
            id="each by itself",
        ),
        pytest.param(
            {(",bar,", ",psi,"): range(17, 20)},
            [
                "unit_changed: the log of 18 March 2026 (2026-03-17.csv) gives "
                "'pressure_difference' in 'psi'; the log before has 'bar': "
                "earlier_units date a unit",
                "unit_differs: pressure_difference: configured in bar, and the log says psi of "
                "pressure_difference",
            ],
            id="unit",
        ),
        pytest.param(
            {(",rpm,", ",L/min,"): range(20)},
            [
                "unit_dimension: speed: configured in rpm, and the log says l/min of speed, which "
                "is no speed: another column?"
            ],
            id="unit of another dimension",
        ),
    ],
)
def test_a_column_or_unit_of_the_header_that_is_another_one(
    tmp_path: Path, changed: dict[tuple[str, str], range], faults: list[str]
) -> None:
    def header_of(day: int) -> str:
        header = COLUMNS
        for (before, after), days in changed.items():
            header = header.replace(before, after) if day in days else header
        return header

    check = checks_of(daily_logs(tmp_path, header_of))["M1"]
    assert [fault for fault in check.faults if fault.startswith(("column_gone", "unit_"))] == faults


@pytest.mark.parametrize(("example", "is_lost"), [("1 020", True), ("I/O Timeout", False)])
def test_words_for_no_reading_are_no_lost_numbers(example: str, is_lost: bool) -> None:
    blank = np.arange(100) < 5
    channel = RawChannel(np.arange(100), np.ones(100), blank, 5, None, example)
    assert list(unread(RawLog({"speed": channel}, 100))) == ["speed"] * is_lost


@pytest.mark.parametrize("is_fallen", [False, True])
def test_a_date_that_stays_behind_midnight_is_a_fault(is_fallen: bool) -> None:
    time_us = np.arange(100) * 2_000_000 + 10**15
    time_us[50:] -= 86_400_000_000 * is_fallen
    speed = RawChannel(time_us, np.ones(100), np.zeros(100, dtype=np.bool_), 0)
    assert list(unread(RawLog({"speed": speed}, 100))) == ["date"] * is_fallen


SECONDS = np.arange(60)


@pytest.mark.parametrize(
    ("seconds", "values", "reasons"),
    [
        (SECONDS, SECONDS, []),
        ([*SECONDS[:20], *SECONDS[40:], *SECONDS[20:40]], SECONDS, []),
        (np.concatenate([SECONDS[at::3] for at in range(3)]), SECONDS, ["backward_time"]),
        (np.repeat(SECONDS, 2), np.repeat(SECONDS, 2), []),
        (np.repeat(SECONDS, 2), np.arange(120), ["duplicate_time"]),
    ],
    ids=["in order", "late", "of several logs by turns", "twice", "of two motors"],
)
def test_rows_that_order_leaves_out_are_a_fault(
    seconds: Any, values: NDArray[np.int64], reasons: list[str]
) -> None:
    time_us = 10**15 + np.asarray(seconds) * 10**6
    speed = RawChannel(time_us, values * 1.0, np.zeros(len(time_us), dtype=np.bool_), 0)
    assert list(misplaced({"speed": speed})) == reasons


@pytest.mark.parametrize(
    ("name", "share", "n_faults"),
    [("speed", 0.06, 0), ("speed", 0.18, 1), ("leakage_flow", 0.18, 0)],
)
def test_a_direction_out_of_range_is_a_fault(name: str, share: float, n_faults: int) -> None:
    check = ChannelCheck(name, "rpm", 900, 1.0, 9.0, 0.0, share, {"out_of_range": share})
    assert len([*mostly_refused([check])]) == n_faults


# Apparent sampling of a channel, on a flow logged in each way by its definition

Logged = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Times [s] and values."""

STEP_S, RESOLUTION = 0.02, 0.02
FLOW = 1.5 + 0.4 * correlated_noise(np.random.default_rng(7), 360_000, STEP_S, 20.0)
READ = np.round(np.rint(FLOW / RESOLUTION) * RESOLUTION, 9)
SENT = {"sampling": "on_change", "longest_silence_s": 60.0}
TOTAL = {"unit": "count", "volume_per_count_cm3": 1.0}


def sampled(values: NDArray[np.float64], period_s: float) -> Logged:
    """A reading every so often."""
    every = round(period_s / STEP_S)
    return np.arange(0, values.size, every) * STEP_S, values[::every]


def note(logged: Logged, name: str = "leakage_flow", **config: Any) -> str:
    time_us = 1_767_303_000_000_000 + np.rint(logged[0] * 1e6).astype(np.int64)
    blank = np.zeros(time_us.size, dtype=np.bool_)
    channel = Channel.model_validate({"source": "x", "unit": "l/min"} | config)
    return "".join(sampling_note(name, channel, RawChannel(time_us, logged[1], blank, 0)))


def test_readings_of_a_clock_look_as_configured() -> None:
    """At any period, without steps, with stamps that jitter, a third lost, or spikes."""
    rng, (time_s, read) = np.random.default_rng(1), sampled(READ, 0.2)
    kept, is_spike = rng.uniform(size=read.size) >= 0.33, rng.uniform(size=read.size) < 0.002
    jitter = np.sort(time_s[::5] + 0.15 * rng.standard_normal(time_s[::5].size))
    logs = [sampled(READ, period_s) for period_s in (0.2, 1.0, 10.0, 60.0)]
    logs += [sampled(FLOW, 0.2), (jitter, read[::5]), (time_s[kept], read[kept])]
    for logged in [*logs, (time_s, read + 900 * RESOLUTION * is_spike)]:
        assert note(logged) == note(logged, "speed", **TOTAL) == ""
        assert "falls again and again" in note(logged, **TOTAL)


@pytest.mark.parametrize("steps", [5, 20])
def test_values_sent_on_change_look_it(steps: int) -> None:
    """A sample where a scan finds a value further than the dead band from the one last sent."""
    (time_s, scans), kept = sampled(READ, 0.2), [0]
    for i, scan in enumerate(scans.tolist()):
        if abs(scan - scans[kept[-1]]) > steps * RESOLUTION * (1.0 + 1e-9):
            kept.append(i)
    logged = time_s[kept], scans[kept]
    said = note(logged)
    assert 'then sampling = "on_change" and longest_silence_s' in said
    # The longest but for a hundredth: of use as longest_silence_s.
    reach = float(said.split()[-2])
    assert 0.98 < np.mean(np.diff(logged[0]) <= 1.01 * reach) <= 1.0
    assert note(logged, **SENT) == note(logged, "speed", **TOTAL | {"unit": "pulses"}) == ""


@pytest.mark.parametrize(
    ("period_s", "volume_cm3", "rolls_over"),
    [(0.2, 1.0, 1e9), (1.0, 10.0, 1e9), (10.0, 10.0, 1e9), (1.0, 10.0, 10_000.0)],
)
def test_a_running_total(period_s: float, volume_cm3: float, rolls_over: float) -> None:
    total = np.floor(123.0 + np.cumsum(np.maximum(FLOW, 0.0)) * STEP_S / 0.06 / volume_cm3)
    time_s, count = sampled(total, period_s)
    logged = time_s, count % rolls_over
    assert "looks like a running total: then unit = " in note(logged)
    assert note(logged, **TOTAL) == ""
