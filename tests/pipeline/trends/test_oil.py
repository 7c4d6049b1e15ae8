"""Words on the oil as measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.config import Channel, MotorSpec
from pipeline.config.oil_samples import OilSample
from pipeline.trends.nights.history import History, blank_records
from pipeline.trends.nights.layout import Layout
from pipeline.trends.rows.trend_rows import oil_as_measured, viscosity_ratio
from tests.pipeline.trends.nights import motor, night_of

N = 20


def with_samples(*samples: OilSample) -> MotorSpec:
    file = motor().file.model_copy(update={"oil_samples": samples})
    return replace(motor(), file=file)


def sample(place: int, at_40: float | None = None, water: float | None = None) -> OilSample:
    return OilSample(date=night_of(place), viscosity_40_c_mm2_per_s=at_40, water_mg_per_kg=water)


def history(spec: MotorSpec, ratio: float | None) -> History:
    """Nights that from the sixth on have a viscosity over the data sheet's."""
    records = blank_records([night_of(place) for place in range(N)])
    records["viscosity"][5:] = np.nan if ratio is None else ratio
    return History(spec, Layout.of(spec, night_of(0)), records)


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
    said = oil_as_measured(history(with_samples(*samples), ratio), N - 1)
    assert expected in said
    assert bool(said) == bool(expected)


def test_a_sensor_measures_every_night() -> None:
    channels = {
        **motor().file.channels,
        "kinematic_viscosity": Channel(source="nu", unit="cSt"),
    }
    spec = replace(motor(), file=motor().file.model_copy(update={"channels": channels}))
    found = history(spec, 0.9)
    assert oil_as_measured(found, N - 1).startswith("oil as measured by the log: 10 % thinner")
    assert viscosity_ratio(found, N - 1) == 0.9
    assert viscosity_ratio(found, 4) is None
