"""Nights whose columns or units are others than before, and nights that only are unusual."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.config import MotorSpec, load_fleet
from pipeline.config.channels import PORT_PRESSURES
from pipeline.night.column_change import COLUMNS, column_change
from pipeline.setup.check import check_motor
from tests.pipeline.simulated import CANONICAL, NIGHT, load_motor, motor_toml, write_log
from tests.pipeline.workshop import DAY, Workshop

USUAL = (180.0, 45.0, 6.5, 2.0)


def told(spec: MotorSpec, now: tuple[float, ...]) -> str:
    usual, readings = (dict(zip(COLUMNS, one, strict=True)) for one in (USUAL, now))
    return column_change(spec, usual, readings) or ""


@pytest.mark.parametrize(
    ("now", "words"),
    [
        pytest.param((180.0, 6.4, 45.0, 1.8), "oil temperature and speed look swapped", id="T, n"),
        pytest.param((48.0, 170.0, 6.5, 2.1), "pressure difference and oil temp", id="p, T"),
        pytest.param((18.1, 44.0, 6.0, 1.9), "if the log is now in MPa", id="MPa"),
        pytest.param((2610.0, 44.0, 6.0, 1.9), "if the log is now in psi", id="psi"),
        pytest.param((180.0, 113.0, 6.5, 2.0), "if the log is now in degF", id="degF"),
        pytest.param((180.0, 45.0, 0.681, 2.0), "if the log is now in rad/s", id="rad/s"),
        pytest.param((160.0, 47.0, 7.0, 118.0), "if the log is now in l/h", id="l/h"),
        pytest.param((175.0, 45.0, 6.5, 0.53), "if the log is now in us_gal/min", id="gal/min"),
    ],
)
def test_other_columns_and_units_are_told(
    spec: MotorSpec, now: tuple[float, ...], words: str
) -> None:
    assert words in told(spec, now)


@pytest.mark.parametrize(
    "now",
    [
        pytest.param(USUAL, id="as usual"),
        pytest.param((18.1, 45.0, 6.5, 0.4), id="an idle night: the flow falls with the load"),
        pytest.param((180.0, 8.0, 40.0, 0.3), id="a fast cold start: the flow falls with the oil"),
        pytest.param((180.0, 45.0, 65.0, 2.2), id="ten times the speed"),
        pytest.param((180.0, 45.0, 6.5, 5.0), id="worn"),
        pytest.param((180.0, 45.0, 6.5, 16.0), id="broken"),
        pytest.param((23.7, 44.0, 30.0, 0.4), id="a light load of another duty"),
        pytest.param((80.0, 30.0, 9.0, 1.2), id="light load"),
        pytest.param((180.0, -5.0, 6.5, 2.0), id="below zero"),
    ],
)
def test_unusual_nights_are_not(spec: MotorSpec, now: tuple[float, ...]) -> None:
    assert not told(spec, now)


# A motor with a gauge at each port, 0.3 to 300 bar apart.

GAUGES = dict.fromkeys(PORT_PRESSURES, "bar") | {
    name: unit for name, unit in CANONICAL.items() if name != "pressure_difference"
}
PORTS = (*COLUMNS, *PORT_PRESSURES)


@pytest.mark.parametrize(
    ("now", "words"),
    [
        # High and low port in MPa, the low one, the high one; of the last one only the difference
        # is known in a night.
        ((18.0, 45.0, 6.5, 2.0, 19.5, 1.5), "difference 18 bar, before 180 bar: as before if the"),
        ((193.5, 45.0, 6.5, 2.0, 195.0, 1.5), "low port pressure 1.5 bar, before 15 bar: as befo"),
        ((4.5, 45.0, 6.5, 2.0, 19.5, 15.0), "high port pressure 19.5 bar, before 195 bar: as be"),
        ((4.5, 45.0, 6.5, 2.0), "difference 4.5 bar, before 180 bar: of one of its two gauges?"),
        ((180.0, 45.0, 6.5, 2.0, 195.0, 15.0), ""),
        ((90.5, 45.0, 6.5, 2.0, 195.0, 104.5), ""),
        # A light night of which the flow is mostly flushing.
        ((40.0, 45.0, 6.5, 2.0), ""),
        ((17.0, 45.0, 6.5, 2.0), "as before if the log is now in MPa"),
        ((4.5, 45.0, 6.5, 0.1), ""),
    ],
)
def test_a_gauge_of_two_in_another_unit(tmp_path: Path, now: tuple[float, ...], words: str) -> None:
    spec = load_motor(tmp_path, motor_toml("M1", units=GAUGES))
    usual = dict(zip(PORTS, (*USUAL, 195.0, 15.0), strict=True))
    found = column_change(spec, usual, dict(zip(PORTS, now, strict=False))) or ""
    assert words in found
    assert bool(found) == bool(words)


@pytest.mark.parametrize(("low_bar", "is_told"), [(5.1, True), (4.9, False)])
def test_a_low_port_without_charge_pressure_may_be_anything(
    tmp_path: Path, low_bar: float, is_told: bool
) -> None:
    spec = load_motor(tmp_path, motor_toml("M1", units=GAUGES))
    before, now = (
        dict(zip(PORTS, (*USUAL, 180.0 + low, low), strict=True)) for low in (low_bar, low_bar / 10)
    )
    assert bool(column_change(spec, before, now)) == is_told


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
    (fault,) = [one for one in check_motor(spec).faults if one.startswith("columns_changed")]
    assert fault.startswith(f"columns_changed: from {shop.logs.name}/{labels[3]}.parquet on: ")
    assert "high port pressure" in fault
