"""Nights whose columns or units are others than before, and nights that only are unusual."""

from __future__ import annotations

import pytest

from pipeline.config import MotorSpec
from pipeline.night.column_change import COLUMNS, column_change
from tests.pipeline.trends.nights import motor

USUAL = (180.0, 45.0, 6.5, 2.0)


@pytest.fixture(scope="module")
def spec() -> MotorSpec:
    return motor()


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
        pytest.param((80.0, 30.0, 9.0, 1.2), id="light load"),
        pytest.param((180.0, -5.0, 6.5, 2.0), id="below zero"),
    ],
)
def test_unusual_nights_are_not(spec: MotorSpec, now: tuple[float, ...]) -> None:
    assert not told(spec, now)
