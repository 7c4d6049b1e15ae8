"""A motor fitted to a frame: made samples of known loss factors, in any kind of frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
from numpy.typing import NDArray

import leakage
from leakage.errors import EstimationError, LeakageError, ShapeError, StatisticsError
from leakage.estimation.sensitivities import ChannelTolerance, Tolerances
from leakage.frame.fit import fit_frame
from leakage.frame.result import FrameFit
from leakage.physics.conditions import OperatingConditions
from leakage.physics.motor import total_flow_l_per_min
from tests.leakage.placeholders import placeholder_motor

Samples = dict[str, NDArray[Any]]
NOISE = 0.02
MOTOR = placeholder_motor()
BEGIN = np.datetime64("2026-03-01T22:00", "us")


def made(n: int = 7200, *, flushing: float = 0.0, seed: int = 1) -> Samples:
    """Samples at 1 Hz: load steps, warming oil."""
    rng = np.random.default_rng(seed)
    bar = np.repeat(rng.uniform(15, 300, -(-n // 60)), 60)[:n]
    celsius = np.linspace(42.0, 57.0, n)
    rpm = np.repeat(rng.uniform(3, 110, -(-n // 120)), 120)[:n]
    flow = total_flow_l_per_min(MOTOR, OperatingConditions.from_bar(bar, celsius, rpm))
    return {
        "time": BEGIN + np.arange(n) * np.timedelta64(1, "s"),
        "pressure_bar": bar,
        "oil_temperature_c": celsius,
        "speed_rpm": rpm,
        "leakage_l_per_min": flow + flushing + NOISE * rng.standard_normal(n),
    }


@pytest.fixture(scope="module")
def found() -> FrameFit:
    return fit_frame(made(), MOTOR)


def test_the_true_loss_factors_lie_in_their_intervals(found: FrameFit) -> None:
    intervals = found.conf_int(0.99)
    for path in MOTOR.column_paths:
        interval = intervals[path.coefficient_name]
        assert interval[0] < path.configured_coefficient < interval[1]
    assert found.validation.rmse_l_per_min == pytest.approx(NOISE, rel=0.1)


def by_dates(samples: Samples) -> pd.DataFrame:
    """Dates as the index, of another zone."""
    return pd.DataFrame(samples).set_index("time").tz_localize("UTC").tz_convert("Europe/Berlin")


@pytest.mark.parametrize("kind", [pd.DataFrame, pl.DataFrame, pl.LazyFrame, pa.table, by_dates])
def test_every_kind_of_frame_gives_the_same(kind: Any, found: FrameFit) -> None:
    assert fit_frame(kind(made()), MOTOR).params == found.params


def test_estimates_of_a_chosen_period_are_from_its_samples_alone() -> None:
    samples = made()
    half = (BEGIN, BEGIN + np.timedelta64(1, "h"))
    later = (half[1], half[1] + np.timedelta64(1, "h"))
    first = {name: values[:3600] for name, values in samples.items()}
    alone = fit_frame(first, MOTOR, train=half)
    both = fit_frame(samples, MOTOR, train=half, validate=later)
    assert both.params == alone.params
    assert (alone.validation.n, both.validation.n) == (0, 3600)
    assert "no samples validate this fit" in alone.summary().warnings


def test_flushing_is_estimated_held_or_left_out() -> None:
    samples = made(flushing=1.5)
    assert fit_frame(samples, MOTOR, flushing=1.5).params["C_f"] == 1.5
    estimated = fit_frame(samples, MOTOR, flushing="estimated")
    assert estimated.params["C_f"] == pytest.approx(1.5, abs=0.1)
    assert "C_f" not in fit_frame(samples, MOTOR, flushing="none").params
    at = (200.0, 50.0, 30.0)
    held = fit_frame(samples, MOTOR, flushing=1.5)
    assert held.leakage(*at).leakage_l_per_min == pytest.approx(1.37, rel=0.02)


def test_predictions_and_residuals_stand_on_the_rows_of_the_frame(found: FrameFit) -> None:
    samples = made(100)
    samples["pressure_bar"][7] = np.nan
    predicted, left = found.predict(samples), found.residuals(samples)
    assert np.flatnonzero(np.isnan(predicted)).tolist() == [7]
    np.testing.assert_allclose((predicted + left)[8:], samples["leakage_l_per_min"][8:], rtol=1e-12)
    assert found.residuals().std() == pytest.approx(NOISE, rel=0.05)


def test_tolerances_of_sensors_widen_the_total_alone() -> None:
    sure = Tolerances(temperature_c=ChannelTolerance(offset=2.0))
    plain, wide = fit_frame(made(), MOTOR), fit_frame(made(), MOTOR, tolerances=sure)
    assert wide.conf_int() == plain.conf_int()
    assert wide.columns()["total_half_width"][0] > 2.0 * plain.columns()["total_half_width"][0]


def test_words(found: FrameFit) -> None:
    title, *lines = repr(found).splitlines()
    assert title.startswith("CB560: 7200 samples, 2026-03-01 22:00 to 2026-03-01 23:59 UTC, ")
    speed = made()["speed_rpm"]
    assert title.endswith(f" bar, 42 to 57 °C, {speed.min():.0f} to {speed.max():.0f} rpm")
    for name in ("K_o", "K_p", "K_s"):
        assert any(line.startswith(name) and line.endswith("identified") for line in lines)
    assert "errors of validation: not autocorrelated, independent of every input" in lines


def test_warnings_come_first() -> None:
    samples = made()
    samples["speed_rpm"][:3] = np.nan
    samples["pressure_bar"][:] = 200.0
    lines = str(fit_frame(samples, MOTOR).summary()).splitlines()
    assert lines[1] == "warning: 3 rows lack a value and are left out"
    assert lines[2].startswith("warning: K_o: not excited: ")


def test_five_rows_say_what_they_cannot_know() -> None:
    found = fit_frame(made(5), MOTOR)
    assert {judgement.verdict for judgement in found.judgements.values()} == {"too_little_data"}
    assert set(found.conf_int().values()) == {None}
    with pytest.raises(EstimationError):
        fit_frame(made(2), MOTOR)


def changed(**columns: Any) -> Mapping[str, Any]:
    return made(600) | columns


@pytest.mark.parametrize(
    ("frame", "code", "words"),
    [
        ({"time": [0.0]}, "column_missing", "no column pressure_bar; there are time"),
        (changed(time=np.zeros(600)), "time_order", "time repeats at row 1"),
        (changed(time=-np.arange(600.0)), "time_order", "time falls at row 1"),
        (changed(time=np.full(600, np.nan)), "time_missing", "drop such rows"),
        (changed(time=np.array(["noon"] * 600)), "column_type", "time holds no times"),
        (changed(speed_rpm=np.full(600, np.nan)), "no_samples", "speed_rpm has no values"),
        (changed(speed_rpm=np.array(["fast"] * 600)), "column_type", "speed_rpm holds no numbers"),
    ],
)
@pytest.mark.parametrize("kind", [dict, pd.DataFrame, pl.DataFrame, pa.table])
def test_a_bad_frame_is_refused_with_what_to_do(
    kind: Any, frame: Samples, code: str, words: str
) -> None:
    with pytest.raises((ShapeError, StatisticsError), match=words) as caught:
        fit_frame(kind(frame), MOTOR)
    assert caught.value.code == code


def test_columns_of_other_lengths_and_what_is_no_frame_are_refused() -> None:
    with pytest.raises(ShapeError, match=r"no columns of one frame: .*speed_rpm"):
        fit_frame(changed(speed_rpm=np.zeros(3)), MOTOR)
    with pytest.raises(ShapeError, match="int is no frame"):
        fit_frame(3, MOTOR)


def test_another_unit_by_its_name_is_refused_and_another_name_is_taken(found: FrameFit) -> None:
    samples = made()
    samples["pressure_psi"] = samples.pop("pressure_bar")
    with pytest.raises(ShapeError, match="pressure_psi is not in bar") as caught:
        fit_frame(samples, MOTOR)
    assert caught.value.code == "column_unit"
    named = fit_frame(samples, MOTOR, columns={"pressure_bar": "pressure_psi"})
    assert named.params == found.params


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"train": ("2026-03-05", "2026-03-06")}, "of another time"),
        ({"train": ("2026-03-02", "2026-03-01")}, "ends before it begins"),
        ({"train": ("noon", "2026-03-01")}, "is no date"),
        ({"train": (0, 3600)}, "are dates, not seconds"),
        ({"validate": ("2026-03-01", "2026-03-02")}, "without train="),
        ({"flushing": "some"}, 'say "none"'),
    ],
)
def test_wrong_arguments(keys: Any, words: str) -> None:
    with pytest.raises(LeakageError, match=words):
        fit_frame(made(600), MOTOR, **keys)


def test_plots_show_what_they_say(found: FrameFit) -> None:
    flow = found.plot()
    assert [line.name for line in flow.data] == ["measured", "predicted"]
    assert [len(line.x) for line in flow.data] == [3600, 3600]
    training, validation = flow.layout.shapes
    assert (training.name, validation.name) == ("training", "validation")
    assert flow.data[0].x[0] == training.x0 < training.x1 < validation.x0
    residuals = found.plot_residuals()
    assert residuals.layout.annotations[0].text == "errors:<br>passed"
    assert (residuals.data[2].y == found.residual_tests("validation").whiteness.values).all()
    leaking = found.plot_leakage(50.0, 30.0)
    *_, lower, upper, total = leaking.data
    at_200 = float(np.interp(200.0, total.x, total.y))
    assert at_200 == pytest.approx(found.leakage(200.0, 50.0, 30.0).leakage_l_per_min, rel=1e-3)
    assert (lower.y < total.y).all()
    assert (total.y < upper.y).all()


# Names on top


def test_names_on_top_are_few_and_there() -> None:
    assert len(leakage.__all__) < 20
    assert all(hasattr(leakage, name) for name in leakage.__all__)


def test_an_unknown_name_is_none() -> None:
    with pytest.raises(AttributeError, match="no attribute 'slip'"):
        _ = leakage.slip
