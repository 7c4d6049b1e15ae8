"""The scale of the cam rollers' curve: estimated where a motor's first nights tell it."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from polars.testing import assert_frame_equal

from leakage import OperatingConditions, total_flow_l_per_min
from pipeline.config import MotorSpec
from pipeline.demo import shipped_configs
from pipeline.night.fit_night import NightOutcome
from pipeline.night.refit import PublishedNight, refit, refit_in_form
from pipeline.run.motor_nights import is_roller_free
from pipeline.schema import BLOCK_STATISTICS, FITS, NIGHT_TABLES, frame
from tests.pipeline.night.noise_free import fitted, white
from tests.pipeline.simulated import NIGHT, load_motor, motor_toml, operate

DAYS = [NIGHT + dt.timedelta(days=number) for number in range(8)]
TRUE_SCALE = 0.6


def night(spec: MotorSpec) -> NightOutcome:
    """Two hours of a motor whose rollers leak less than their curve says."""
    operation = operate(minutes=120.0)
    flow = operation.flow(spec.motor(NIGHT, "none"), {"cam_roller": TRUE_SCALE})
    return fitted(spec, operation, flow + white(len(flow), 0.02, seed=5))


def freed(spec: MotorSpec) -> MotorSpec:
    return replace(spec, roller_is_free=True)


def test_the_leakage_of_a_wrong_curve_is_right_with_its_scale_free(spec: MotorSpec) -> None:
    stated = night(spec)
    free = refit_in_form(freed(spec), stated, None)
    assert free is not None
    motor = spec.motor(NIGHT, "none")
    at = spec.settings.reference
    conditions = OperatingConditions.from_bar(at.pressure_bar, at.temperature_c, at.speed_rpm)
    true = float(total_flow_l_per_min(motor, conditions, {"cam_roller": TRUE_SCALE})[0])
    (before,), (after,) = stated.rows["fits"], free.rows["fits"]
    assert abs(before["reference_leakage_l_per_min"] / true - 1.0) > 0.05
    assert after["reference_leakage_l_per_min"] == pytest.approx(true, rel=0.01)
    assert after["reference_leakage_lower"] < true < after["reference_leakage_upper"]
    assert (before["roller_is_free"], after["roller_is_free"]) == (False, True)
    for row in (before, after):
        assert row["roller_scale"] == pytest.approx(TRUE_SCALE, abs=0.02)
        assert row["roller_verdict"] == "identified"
    # The misfit is that of the model as stated, and so is what it does to K.
    assert after["model_misfit_percent"] == before["model_misfit_percent"] > 2.0
    assert after["is_refitted"] is False


def test_a_night_read_with_its_scale_free_is_the_night_fitted_anew(spec: MotorSpec) -> None:
    read, stated = night(freed(spec)), night(spec)
    anew = refit_in_form(freed(spec), stated, None)
    assert anew is not None
    assert read.rows.keys() == anew.rows.keys()
    for name in read.rows:
        table = next(table for table in NIGHT_TABLES if table.name == name)
        one, two = (frame(table, made.rows[name]) for made in (read, anew))
        assert_frame_equal(one, two, check_exact=True)


def test_other_reference_conditions_need_no_log_with_its_scale_free(spec: MotorSpec) -> None:
    """The ± from the sensors as well, which is that of the new conditions."""
    made = night(spec).rows
    published = PublishedNight(
        NIGHT,
        frame(FITS, made["fits"]).to_dicts(),
        made["sensitivities"],
        frame(BLOCK_STATISTICS, made["block_statistics"]),
    )
    reference = spec.settings.reference.model_copy(update={"pressure_bar": 100.0})
    moved = replace(spec, settings=spec.settings.model_copy(update={"reference": reference}))
    stated = refit(moved, published)
    assert stated is not None
    anew = refit_in_form(freed(moved), stated, published)
    read = refit_in_form(freed(moved), night(moved), None)
    assert anew is not None
    assert read is not None
    (made_anew,), (made_read,) = anew.rows["fits"], read.rows["fits"]
    for name in ("reference_leakage_sensor_half_width", "reference_leakage_l_per_min"):
        assert made_anew[name] == pytest.approx(made_read[name], rel=0.02), name


def gram(upper: list[float], size: int) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    factor = np.zeros((size, size))
    factor[np.triu_indices(size)] = upper
    return factor.T @ factor


def test_it_is_the_fit_of_a_type_whose_scale_is_free(tmp_path: Path, spec: MotorSpec) -> None:
    """From blocks with the rollers known, as from blocks with a column of their own."""
    text = (shipped_configs() / "motor_types" / "CB560.toml").read_text("utf-8")
    text = text.replace('motor_type = "CB560"', 'motor_type = "FREE"')
    text += "scale = { value = 1.0, minimum = 0.0, maximum = 10.0, fixed = false }\n"
    declared = load_motor(tmp_path / "free", motor_toml("M1", "FREE"), {"FREE": text})
    free = refit_in_form(freed(spec), night(spec), None)
    assert free is not None
    (one,), (two,) = free.rows["fits"], night(declared).rows["fits"]
    assert one["columns"] == two["columns"]
    for name in ("coefficients", "coefficient_covariance"):
        assert one[name] == pytest.approx(two[name], rel=1e-6, abs=1e-30), name
    one_gram, two_gram = (gram(row["night_factor"], 7) for row in (one, two))
    assert one_gram == pytest.approx(two_gram, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("tells", "begins", "expected"),
    [
        ((True,) * 5, (), True),
        ((True,) * 4, (), False),
        ((None, *(True,) * 5), (), True),
        # Four of five do.
        ((True, False, True, True, True), (), True),
        ((True, False, False, True, True), (), False),
        # Later nights change nothing of it.
        ((True,) * 5 + (False,) * 3, (), True),
        # A new baseline decides anew, once it has its nights.
        ((True,) * 5 + (False,) * 2, (DAYS[5],), True),
        ((True,) * 2 + (False,) * 6, (DAYS[2],), False),
    ],
)
def test_the_first_nights_of_a_baseline_decide(
    tells: tuple[bool | None, ...], begins: tuple[dt.date, ...], expected: bool
) -> None:
    found = is_roller_free(dict(zip(DAYS, tells, strict=False)), begins, 5)
    assert found is expected
