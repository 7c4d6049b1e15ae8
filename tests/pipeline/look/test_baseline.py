"""What new blocks are compared with: the oil as measured, rollers of a free scale, resets."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace

import numpy as np
import pytest

from leakage.course.step_detection import BlockErrors
from leakage.physics.walther import kinematic_viscosity_mm2_per_s, walther_coefficients
from pipeline.config import Channel, MotorSpec
from pipeline.config.hashes import model_hash
from pipeline.config.oil_samples import OilSample
from pipeline.look.baseline import LookBaseline, _outdated
from pipeline.look.blocks import Blocks, blocks_within
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.trend_record import Record
from tests.pipeline.simulated import NIGHT, load_motor, motor_toml, night_of, operate, raw
from tests.pipeline.workshop import DAY

# 20 % thinner than VG 68 (68 and 8.7 mm²/s), 15 % at 100 °C.
THIN = walther_coefficients(40.0, 54.4, 100.0, 7.4)
SAMPLE = OilSample(date=NIGHT, viscosity_40_c_mm2_per_s=54.4, viscosity_100_c_mm2_per_s=7.4)
SENSOR = Channel(source="nu", unit="cSt")


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> MotorSpec:
    return load_motor(tmp_path_factory.mktemp("configs"), motor_toml("M1"))


@pytest.mark.parametrize("by", ["analysis", "sensor"])
def test_new_blocks_have_the_oil_as_measured_as_those_of_the_baseline_do(
    spec: MotorSpec, by: str
) -> None:
    operation, motor = operate(minutes=10.0), spec.motor(NIGHT, "none")
    oil = replace(motor.oil, walther_a=THIN[0], walther_b=THIN[1])
    values = operation.channels(operation.flow(replace(motor, oil=oil)))
    more: dict[str, object] = {"oil_samples": (SAMPLE,)}
    if by == "sensor":
        nu = kinematic_viscosity_mm2_per_s(operation.temperature_c, *THIN)
        values["kinematic_viscosity"] = nu
        more = {"channels": {**spec.file.channels, "kinematic_viscosity": SENSOR}}
    measured = replace(spec, file=spec.file.model_copy(update=more))
    night, channels = night_of(), raw(operation.time_us, values)
    found, why = blocks_within(measured, night, channels, night.start_us, night.end_us)
    assert (len(found.start_us), why) == (5, "")
    true = [*(path.configured_coefficient for path in motor.column_paths), 0.0, 1.0]
    np.testing.assert_allclose(found.means[:, :-1] @ true, found.means[:, -1], rtol=2e-3)


def baseline(spec: MotorSpec, known_scale: float | None = None) -> LookBaseline:
    """One of a single path, whose loss factors fall by 1 % a kelvin."""
    hashed = model_hash(spec, spec.motor(NIGHT, "none"), NIGHT)
    errors, begin = BlockErrors(0.0, 0.0, 1.0), NIGHT - 30 * DAY
    figures = ((2.0, 0.0), -0.01, 50.0, errors, 10.0, (0.0,) * 3, (99.0,) * 3)
    return LookBaseline("made", begin, NIGHT - DAY, hashed, *figures, known_scale=known_scale)


def test_rollers_of_a_free_scale_change_with_temperature_as_the_gaps_do(spec: MotorSpec) -> None:
    # Columns: path, one, known, measured; 10 K above T₀.
    one = Blocks(np.zeros(1, np.int64), np.array([[3.0, 1.0, 4.0, 9.0]]), np.array([[60.0, 1, 1]]))
    for scale, expected in ((None, 0.9 * 2.0 * 3.0 + 4.0), (1.5, 0.9 * (2.0 * 3.0 + 1.5 * 4.0))):
        assert baseline(spec, scale).flows(one)[1] == pytest.approx(expected)


@pytest.mark.parametrize(("indicator", "is_new"), [("", True), ("baseline_deviation", False)])
def test_a_reset_of_the_drain_flow_alone_does_not_end_the_looks(
    spec: MotorSpec, indicator: str, is_new: bool
) -> None:
    record, time = Record("", NIGHT + DAY), dt.datetime(2026, 1, 2, tzinfo=dt.UTC)
    reset = Decision("M1", indicator, time, "baseline_reset", NIGHT, None, "")
    assert bool(_outdated(spec, baseline(spec), [reset], record)) is is_new
