"""Words and rows on the oil as measured, and on a grade that nobody declared."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.config import Channel, MotorSpec
from pipeline.config.oil_samples import OilSample
from pipeline.trends.figures.indicators import REFERENCE
from pipeline.trends.rows.trend_rows import trend_rows
from pipeline.trends.states.standing import Standing
from pipeline.trends.why.oil import oil_as_measured, viscosity_ratio
from pipeline.trends.why.reasons import path_behind, why_state
from tests.pipeline.trends.nights import OIL, Nights, histories, motor, night_of, standing, step

N, AT = 110, 80


def with_samples(*samples: OilSample) -> MotorSpec:
    file = motor().file.model_copy(update={"oil_samples": samples})
    return replace(motor(), file=file)


def sample(place: int, at_40: float | None = None, water: float | None = None) -> OilSample:
    return OilSample(date=night_of(place), viscosity_40_c_mm2_per_s=at_40, water_mg_per_kg=water)


def nights(spec: MotorSpec, factor: float, ratio: float | None = None) -> Nights:
    changes = {} if ratio is None else {n: {"viscosity_ratio": ratio} for n in range(90, N)}
    return Nights(spec, N, {OIL: step(N, AT, factor - 1.0)}, changes=changes)


def words(found: Standing) -> str:
    return why_state(found, REFERENCE, N - 1, path_behind(found, REFERENCE, N - 1))


def row(found: Standing, name: str) -> dict[str, object]:
    return next(one for one in trend_rows(found, [N - 1]) if one["indicator"] == name)


def test_an_oil_that_was_measured_is_no_cause() -> None:
    """Analysed after the change, and as its data sheet has it: a sensor, not the oil."""
    found = standing(nights(with_samples(sample(90, 68.0, 900.0)), 1.25, 1.0))
    said = words(found)
    assert ": as if the temperature sensor read 5 °C low, or the meter 25 % high" in said
    assert "oil as measured on 2 April 2026: as its data sheet" in said
    assert "water 900 mg/kg; no path" in said
    told = row(found, "oil_viscosity")
    assert (told["value"], told["unit"], told["state"]) == (
        0.0,
        "%",
        row(found, REFERENCE)["state"],
    )
    assert row(found, REFERENCE)["likely_iso_vg"] is None


def test_another_grade_is_proposed_and_not_applied() -> None:
    """VG 46 lets 43 % more through than VG 68 at 50 °C (model.md, section 2)."""
    found = standing(nights(with_samples(sample(20, water=900.0)), 1.43))
    said = words(found)
    assert "as if the oil were 30 % thinner" in said
    assert "water 900 mg/kg; ISO VG 46 would do so: if it was filled in" in said
    assert row(found, REFERENCE)["likely_iso_vg"] == 46
    assert row(found, REFERENCE)["oil"] == "vg68"
    assert all(one["indicator"] != "oil_viscosity" for one in trend_rows(found, [N - 1]))


@pytest.mark.parametrize(
    ("samples", "ratio", "expected"),
    [
        ((), None, ""),
        ((sample(0, 54.4),), 0.8, "oil as measured on 2 January 2026: 20 % thinner"),
        ((sample(5, 75.0),), 1.1, "10 % thicker than its data sheet, by which the nights before "),
        ((sample(0, water=70.0),), None, ""),
    ],
)
def test_words_on_a_measured_oil(
    samples: tuple[OilSample, ...], ratio: float | None, expected: str
) -> None:
    one = Nights(
        with_samples(*samples),
        20,
        changes={n: {"viscosity_ratio": ratio} for n in range(5, 20)} if ratio else {},
    )
    (history,) = histories(one).values()
    said = oil_as_measured(history, 19)
    assert expected in said
    assert bool(said) == bool(expected)
    # Not measured since a later change.
    assert oil_as_measured(history, 19, 10) == ""


def test_a_sensor_measures_every_night() -> None:
    channels = {
        **motor().file.channels,
        "kinematic_viscosity": Channel(source="nu", unit="cSt"),
    }
    spec = replace(motor(), file=motor().file.model_copy(update={"channels": channels}))
    one = Nights(spec, 20, changes={n: {"viscosity_ratio": 0.9} for n in range(20)})
    (history,) = histories(one).values()
    assert oil_as_measured(history, 19, 10).startswith("oil as measured by the log: 10 % thinner")
    assert viscosity_ratio(history, 19, 10) == 0.9
    assert np.isfinite(history.records["viscosity"]).all()
