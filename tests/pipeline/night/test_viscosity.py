"""The oil as measured: a channel of the log, or analyses, in place of the data sheet."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from leakage.physics.oil import density_kg_per_m3
from leakage.physics.walther import kinematic_viscosity_mm2_per_s, walther_coefficients
from pipeline.config import Channel, MotorSpec
from pipeline.config.oil_samples import OilSample
from pipeline.night.fit_night import NightOutcome
from pipeline.night.refit import PublishedNight, refit
from pipeline.schema import BLOCK_STATISTICS, FITS, frame
from tests.pipeline.night.noise_free import fit
from tests.pipeline.simulated import NIGHT, load_motor, motor_toml, operate

# 20 % thinner than VG 68 (68 and 8.7 mm²/s), 15 % at 100 °C.
THIN = walther_coefficients(40.0, 54.4, 100.0, 7.4)
SAMPLE = OilSample(date=NIGHT, viscosity_40_c_mm2_per_s=54.4, viscosity_100_c_mm2_per_s=7.4)
UNITS = {"kinematic_viscosity": "cSt", "dynamic_viscosity": "mPa.s"}
OPERATION = operate(minutes=60.0)
Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> MotorSpec:
    folder: Path = tmp_path_factory.mktemp("configs")
    return load_motor(folder, motor_toml("M1"))


def thin_flow(spec: MotorSpec) -> Array:
    motor = spec.motor(NIGHT, "none")
    oil = replace(motor.oil, walther_a=THIN[0], walther_b=THIN[1])
    return OPERATION.flow(replace(motor, oil=oil))


def with_sample(spec: MotorSpec) -> MotorSpec:
    return replace(spec, file=spec.file.model_copy(update={"oil_samples": (SAMPLE,)}))


def with_sensor(spec: MotorSpec, name: str) -> MotorSpec:
    channels = {**spec.file.channels, name: Channel(source=name, unit=UNITS[name])}
    return replace(spec, file=spec.file.model_copy(update={"channels": channels}))


def readings(spec: MotorSpec, name: str) -> Array:
    """What a sensor without error reads."""
    value = kinematic_viscosity_mm2_per_s(OPERATION.temperature_c, *THIN)
    if name == "dynamic_viscosity":
        value = value * density_kg_per_m3(OPERATION.temperature_c, spec.oil_on(NIGHT).oil()) / 1e3
    return value


def night(spec: MotorSpec, **more: Array) -> NightOutcome:
    return fit(spec, OPERATION, OPERATION.channels(thin_flow(spec)) | more)


def off(spec: MotorSpec, found: NightOutcome) -> Array:
    """Relative errors of the loss factors."""
    (row,) = found.rows["fits"]
    paths = spec.motor(NIGHT, "none").column_paths
    true = np.array([path.configured_coefficient for path in paths])
    estimates: Array = np.array(row["coefficients"][: len(true)])
    return np.abs(estimates / true - 1.0)


def test_with_an_analysis_the_loss_factors_are_the_true_ones(spec: MotorSpec) -> None:
    found = night(with_sample(spec))
    assert off(spec, found).max() < 1e-3
    (row,) = found.rows["fits"]
    assert row["viscosity_ratio"] == pytest.approx(0.81, abs=0.01)
    # One factor a block, in which the temperature moves by up to 5 K here.
    assert row["training_fit_percent"] > 99.5
    # At the reference conditions, with the data sheet's oil: model.md, section 3.
    assert row["reference_leakage_l_per_min"] == pytest.approx(1.371423, rel=1e-3)


@pytest.mark.parametrize("name", UNITS)
def test_a_viscosity_in_the_log_does_the_same(spec: MotorSpec, name: str) -> None:
    found = night(with_sensor(spec, name), **{name: readings(spec, name)})
    assert off(spec, found).max() < 0.02
    assert found.rows["block_statistics"][0]["viscosity_ratio"] == pytest.approx(0.81, abs=0.01)


def test_an_analysis_that_comes_late_needs_no_log(spec: MotorSpec) -> None:
    before, after = night(spec), night(with_sample(spec))
    blocks = frame(BLOCK_STATISTICS, before.rows["block_statistics"])
    fits = frame(FITS, before.rows["fits"]).to_dicts()
    published = PublishedNight(NIGHT, fits, (), blocks)
    anew = refit(with_sample(spec), published)
    assert anew is not None
    for column in ("coefficients", "night_factor", "viscosity_ratio", "training_fit_percent"):
        (made,), (read,) = anew.rows["fits"], after.rows["fits"]
        assert made[column] == pytest.approx(read[column], rel=1e-9, abs=1e-12)
    # Blocks are those of the data sheet, whatever was measured.
    assert after.rows["block_statistics"] == before.rows["block_statistics"]


@pytest.mark.parametrize(
    ("factor", "constant", "words"),
    [
        (0.0, np.nan, "is credible in only 0 % of the kept samples"),
        (0.0, 31.0, "is credible in only"),  # frozen
        (0.0, 0.3, "is credible in only 0 %"),  # below any oil
        (3.8, 0.0, "times that of ISO VG 68 hydraulic oil: another unit, oil or place"),
    ],
)
def test_a_sensor_that_tells_nothing_makes_no_figure(
    spec: MotorSpec, factor: float, constant: float, words: str
) -> None:
    name = "kinematic_viscosity"
    value = factor * readings(spec, name) + constant
    found = night(with_sensor(spec, name), **{name: value})
    assert found.status == "insufficient_data"
    for one in (name, words, "the data sheet holds"):
        assert one in (found.reason or "")


@pytest.mark.parametrize(
    ("factor", "share", "is_enough"),
    # Within a factor of three of the data sheet, in a tenth of the samples.
    [(3.6, 1.0, True), (1.0, 0.11, True), (1.0, 0.09, False)],
)
def test_what_a_sensor_has_to_tell(
    spec: MotorSpec, factor: float, share: float, is_enough: bool
) -> None:
    name = "kinematic_viscosity"
    told = np.arange(len(OPERATION.time_us)) < share * len(OPERATION.time_us)
    value = np.where(told, factor * readings(spec, name), np.nan)
    found = night(with_sensor(spec, name), **{name: value})
    assert (found.status == "ok") == is_enough
    if is_enough:
        ratio = found.rows["block_statistics"][0]["viscosity_ratio"]
        assert ratio == pytest.approx(0.81 * factor, rel=0.02)
