"""A frame prepared and fitted is the nightly run's night, to the last bit."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from numpy.typing import NDArray

from leakage.frame_fit import fit_frame
from leakage.sample_blocks import DefaultWindows
from pipeline.config import MotorSpec, Windows
from pipeline.errors import UsageError
from pipeline.night.fit_night import fit_night
from pipeline.night.rows import Row
from pipeline.night.tolerances import tolerances
from pipeline.notebook import Prepared, prepare, prepare_log
from pipeline.schema.fits import OK
from tests.pipeline.simulated import (
    NIGHT,
    Array,
    load_motor,
    motor_toml,
    night_of,
    operate,
    raw,
    write_log,
)

FRAME_NAMES = {
    "pressure_difference": "pressure_bar",
    "oil_temperature": "oil_temperature_c",
    "speed": "speed_rpm",
    "leakage_flow": "leakage_l_per_min",
}


@pytest.fixture
def spec(tmp_path: Path) -> MotorSpec:
    return load_motor(tmp_path, motor_toml("M1"))


def night_like_the_demo_s(
    spec: MotorSpec, minutes: float = 90.0
) -> tuple[NDArray[np.int64], dict[str, Array]]:
    """Noise, spikes, a stuck sensor and a halt: the rules have something to refuse."""
    rng, operation = np.random.default_rng(3), operate(minutes=minutes)
    values = operation.channels(operation.flow(spec.motor(NIGHT, "none")))
    values = {name: value.copy() for name, value in values.items()}
    n = len(operation.time_us)
    values["leakage_flow"] += 0.02 * rng.standard_normal(n)
    values["pressure_difference"][rng.integers(0, n, 20)] = 900.0
    values["oil_temperature"][1200:1500] = 50.0
    values["speed"][3000:3300] = 0.0
    return operation.time_us, values


def as_frame(time_us: NDArray[np.int64], values: dict[str, Array]) -> pl.DataFrame:
    columns = {FRAME_NAMES[name]: value for name, value in values.items()}
    time = pl.Series("time", time_us).cast(pl.Datetime("us", "UTC"))
    return pl.DataFrame({"time": time} | columns)


def compare_with_the_night(prepared: Prepared, spec: MotorSpec, rows: dict[str, list[Row]]) -> None:
    motor, sensors = spec.motor(NIGHT, spec.file.flushing.mode), tolerances(spec, NIGHT)
    found = fit_frame(prepared.frame, motor, tolerances=sensors)
    (fit,) = rows["fits"]
    names = [path.coefficient_name for path in found.motor.column_paths]
    assert list(found.params.values())[: len(names)] == fit["coefficients"][: len(names)]
    assert (found.training.n, found.validation.n) == (fit["n_training"], fit["n_validation"])
    assert found.training.fit_percent == fit["training_fit_percent"]
    assert found.validation.fit_percent == fit["validation_fit_percent"]
    assert found.structured is not None
    assert 100.0 * found.structured.share == fit["model_misfit_percent"]
    intervals = found.conf_int()
    for row in rows["parameters"]:
        if row["parameter"] in names:
            judged = found.judgements[row["parameter"]]
            assert intervals[row["parameter"]] == (row["lower"], row["upper"])
            assert judged.verdict == row["verdict"]
    reference = found.leakage(200.0, 50.0, 30.0)
    assert reference.leakage_l_per_min == fit["reference_leakage_l_per_min"]
    assert reference.interval is not None
    assert reference.verdict == fit["reference_verdict"]
    assert reference.interval.half_width == fit["reference_leakage_statistical_half_width"]


def test_the_same_figures_as_the_nightly_run_to_the_last_bit(spec: MotorSpec) -> None:
    time_us, values = night_like_the_demo_s(spec)
    prepared = prepare(as_frame(time_us, values))
    outcome = fit_night(spec, night_of(), raw(time_us, values), {})
    assert outcome.status == OK
    compare_with_the_night(prepared, spec, outcome.rows)
    told = {(row["channel"], row["reason"]): row["n_refused"] for row in outcome.rows["quality"]}
    for row in prepared.refused.iter_rows(named=True):
        assert told[row["channel"], row["reason"]] == row["n_refused"]
    assert {"out_of_range", "standstill"} <= set(prepared.refused["reason"])


def test_a_long_night_of_merged_blocks_is_fitted_as_the_nightly_run_does(spec: MotorSpec) -> None:
    """Short means are stored in single precision, and tell of slow errors."""
    time_us, values = night_like_the_demo_s(spec, 240.0)
    values["leakage_flow"] += 0.05 * np.sin(np.arange(len(time_us)) / 400.0)
    outcome = fit_night(spec, night_of(), raw(time_us, values), {})
    assert any(row["short_means"] for row in outcome.rows["block_statistics"])
    found = fit_frame(prepare(as_frame(time_us, values)).frame, spec.motor(NIGHT, "none"))
    assert found.identification.slow.are_slow
    (fit,) = outcome.rows["fits"]
    assert found.identification.slow.memory == fit["slow_error_memory"]
    assert list(found.params.values()) == pytest.approx(fit["coefficients"], rel=1e-5)


def test_logs_are_prepared_as_a_frame_of_them_is(tmp_path: Path, spec: MotorSpec) -> None:
    time_us, values = night_like_the_demo_s(spec)
    write_log(tmp_path / "logs" / "M1" / "night.parquet", time_us, values)
    prepared = prepare_log(tmp_path / "configs" / "fleet.toml", "M1", NIGHT)
    assert prepared.frame.equals(prepare(as_frame(time_us, values)).frame)
    assert prepared.motor == spec.motor(NIGHT, "none")
    assert prepared.tolerances is not None
    with pytest.raises(UsageError, match="no motor M2; there are M1"):
        prepare_log(tmp_path / "configs" / "fleet.toml", "M2", NIGHT)


def test_disorder_is_cleaned_and_an_empty_channel_is_told(spec: MotorSpec) -> None:
    time_us, values = night_like_the_demo_s(spec)
    frame = as_frame(time_us, values)
    twice = pl.concat([frame, frame[:10]])
    assert prepare(twice).frame.height == prepare(frame).frame.height
    silent = prepare(frame.with_columns(speed_rpm=pl.lit(None, pl.Float64)))
    assert silent.frame.height == 0
    missing = silent.refused.filter(channel="speed", reason="missing")
    assert missing["n_refused"].to_list() == [frame.height]
    with pytest.raises(UsageError, match="no rows"):
        prepare(frame[:0])


def test_the_windows_of_a_frame_are_those_of_a_fleet_that_states_none() -> None:
    stated = Windows().model_dump()
    assert asdict(DefaultWindows()) == {name: stated[name] for name in asdict(DefaultWindows())}
