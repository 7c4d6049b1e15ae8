"""Nights whose columns or units are others than before, and nights that only are unusual."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.config import load_fleet
from pipeline.config.channels import PORT_PRESSURES
from pipeline.night.column_change import COLUMNS, column_change
from pipeline.setup.check import check_motor
from tests.pipeline.simulated import CANONICAL, NIGHT, load_motor, motor_toml, write_log
from tests.pipeline.workshop import DAY, Workshop

USUAL = (180.0, 45.0, 6.5, 2.0)
# A motor with a gauge at each port, and what it reads in bar.
GAUGES = dict.fromkeys(PORT_PRESSURES, "bar") | {
    name: unit for name, unit in CANONICAL.items() if name != "pressure_difference"
}
PORTS = (*COLUMNS, *PORT_PRESSURES)
WITH_PORTS = (*USUAL, 195.0, 15.0)


@pytest.mark.parametrize(
    ("usual", "now", "words"),
    [
        (USUAL, (180.0, 6.4, 45.0, 1.8), "oil temperature and speed look swapped"),
        (USUAL, (48.0, 170.0, 6.5, 2.1), "pressure difference and oil temperature look swapped"),
        (USUAL, (18.1, 44.0, 6.0, 1.9), "if the log now has it in MPa"),
        (USUAL, (2610.0, 44.0, 6.0, 1.9), "if the log now has it in psi"),
        (USUAL, (180.0, 113.0, 6.5, 2.0), "if the log now has it in degF"),
        (USUAL, (180.0, 45.0, 0.681, 2.0), "if the log now has it in rad/s"),
        (USUAL, (160.0, 47.0, 7.0, 118.0), "if the log now has it in l/h"),
        (USUAL, (175.0, 45.0, 6.5, 0.53), "if the log now has it in us_gal/min"),
        # Nights that only are unusual: idle (the flow falls with the load), a fast cold start (it
        # falls with the oil), ten times the speed, worn, broken, light load, another duty, frost.
        (USUAL, USUAL, ""),
        (USUAL, (18.1, 45.0, 6.5, 0.4), ""),
        (USUAL, (180.0, 8.0, 40.0, 0.3), ""),
        (USUAL, (180.0, 45.0, 65.0, 2.2), ""),
        (USUAL, (180.0, 45.0, 6.5, 5.0), ""),
        (USUAL, (180.0, 45.0, 6.5, 7.1), ""),
        (USUAL, (180.0, 45.0, 6.5, 16.0), ""),
        (USUAL, (80.0, 30.0, 9.0, 1.2), ""),
        (USUAL, (23.7, 44.0, 30.0, 0.4), ""),
        (USUAL, (180.0, -5.0, 6.5, 2.0), ""),
        # High and low port in MPa, the low one, the high one; of the last one only the difference
        # is known in a night.
        (WITH_PORTS, (18.0, *USUAL[1:], 19.5, 1.5), "difference 18 bar, usually 180 bar: as usual"),
        (WITH_PORTS, (193.5, *USUAL[1:], 195.0, 1.5), "low port pressure 1.5 bar, usually 15 bar"),
        (WITH_PORTS, (4.5, *USUAL[1:], 19.5, 15.0), "high port pressure 19.5 bar, usually 195 bar"),
        (WITH_PORTS, (4.5, *USUAL[1:]), "difference 4.5 bar, usually 180 bar: of one of its two"),
        (WITH_PORTS, (17.0, *USUAL[1:]), "in MPa where the config has bar (earlier_units of both"),
        (WITH_PORTS, WITH_PORTS, ""),
        (WITH_PORTS, (90.5, *USUAL[1:], 195.0, 104.5), ""),
        # A light night of which the flow is mostly flushing.
        (WITH_PORTS, (40.0, *USUAL[1:]), ""),
        (WITH_PORTS, (4.5, *USUAL[1:3], 0.1), ""),
        # A low port without charge pressure may be anything.
        ((*USUAL, 185.1, 5.1), (*USUAL, 180.51, 0.51), "low port pressure 0.51 bar"),
        ((*USUAL, 184.9, 4.9), (*USUAL, 180.49, 0.49), ""),
    ],
)
def test_other_columns_and_units_are_distinguished_from_unusual_nights(
    tmp_path: Path, usual: tuple[float, ...], now: tuple[float, ...], words: str
) -> None:
    units = GAUGES if len(usual) > len(USUAL) else CANONICAL
    spec = load_motor(tmp_path, motor_toml("M1", units=units))
    before, readings = (dict(zip(PORTS, means, strict=False)) for means in (usual, now))
    change = column_change(spec, before, readings)
    assert (change is None) == (words == "")
    assert change is None or (words in change.words and not change.is_of_others)


@pytest.mark.parametrize(
    ("channel", "unit", "other", "as_read"),
    [
        ("leakage_flow", "us_gal/min", "l/min", 2.0 * 3.785),
        ("leakage_flow", "m3/h", "l/min", 2.0 * 1000.0 / 60.0),
        ("leakage_flow", "l/min", "us_gal/min", 2.0 / 3.785),
        ("speed", "rad/s", "rpm", 6.5 * 9.549),
        ("speed", "rpm", "rad/s", 6.5 / 9.549),
        ("pressure_difference", "psi", "bar", 180.0 / 14.504),
        ("oil_temperature", "degF", "degC", 7.2),
    ],
)
def test_nights_of_the_unit_before_are_named_whichever_is_configured(
    tmp_path: Path, channel: str, unit: str, other: str, as_read: float
) -> None:
    spec = load_motor(tmp_path, motor_toml("M1", units=CANONICAL | {channel: unit}))
    right = dict(zip(COLUMNS, USUAL, strict=True))
    wrong = right | {channel: as_read}
    for usual, now in ((right, wrong), (wrong, right)):
        change = column_change(spec, usual, now)
        assert change is not None
        assert f"has it in {other} where the config has {unit}" in change.words
        assert change.is_of_others == (now is right)


# Speeds of 24 to 32 rpm before: 4 to 5.3 if they were in deg/s, and read in rpm.
VARIED = {"speed": 27.1, "speed lowest": 23.7, "speed highest": 31.7}


@pytest.mark.parametrize(
    ("usual", "now", "is_fitted", "words"),
    [
        (VARIED, {"speed": 4.2}, True, "as usual if the log now has it in rad/s"),
        (VARIED, {"speed": 4.2}, False, "as usual if the log now has it in rad/s"),
        (VARIED, {"speed": 5.08}, False, ""),
        # Nearer is 215 psi to 17 bar than 17 MPa to 215 bar, and the flow is that of 215 bar.
        (
            {"pressure_difference": 17.0},
            {"pressure_difference": 215.0, "leakage_flow": 2.35},
            True,
            "as now if the log usually has it in MPa",
        ),
    ],
)
def test_of_two_units_the_likelier_is_named(
    tmp_path: Path, usual: dict[str, float], now: dict[str, float], is_fitted: bool, words: str
) -> None:
    spec, rest = load_motor(tmp_path, motor_toml("M1")), dict(zip(COLUMNS, USUAL, strict=True))
    change = column_change(spec, rest | usual, rest | now, is_fitted=is_fitted)
    assert (change is None) == (words == "")
    assert change is None or words in change.words


def test_a_run_and_a_check_tell_a_gauge_in_mpa_from_one_night_on(tmp_path: Path) -> None:
    shop = Workshop.at(tmp_path)
    shop.take(motor_toml("M1", "MINI", units=GAUGES))
    labels = [NIGHT + n * DAY for n in range(5)]
    for label in labels:
        operation, values = shop.night(label)
        low = np.full_like(operation.pressure_bar, 15.0) + 0.2 * np.sin(operation.speed_rpm)
        high = values.pop("pressure_difference") + low
        in_mpa = high / 10.0 if label >= labels[3] else high
        values |= {"high_port_pressure": in_mpa, "low_port_pressure": low}
        write_log(shop.logs / f"{label}.parquet", operation.time_us, values)
    shop.run()
    assert [shop.statuses()[label] for label in labels] == ["ok"] * 3 + ["failed"] * 2
    assert "of one of its two gauges?" in shop.rows("nights")["reason"][-1]
    (spec,) = load_fleet(shop.fleet).motors
    (fault,) = [fault for fault in check_motor(spec).faults if fault.startswith("columns_changed")]
    name = f"{shop.logs.name}/{labels[3]}.parquet"
    assert fault.startswith(f"columns_changed: from the night {labels[3]} ({name}) on: ")
    assert "high port pressure" in fault
