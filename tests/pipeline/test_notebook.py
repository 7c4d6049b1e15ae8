"""A frame prepared and fitted is the nightly run's night, to the last bit."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from numpy.typing import NDArray

from leakage.frame.result import FrameFit
from pipeline.config import MotorSpec
from pipeline.errors import UsageError
from pipeline.night.fit import tolerances
from pipeline.night.fit_night import fit_night
from pipeline.notebook import open_tables, prepare, prepare_log
from pipeline.schema import ALARMS, FITS, OK, Row, frame
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
from tests.pipeline.written import write_nights

FRAME_NAMES = {
    "pressure_difference": "pressure_bar",
    "oil_temperature": "oil_temperature_c",
    "speed": "speed_rpm",
    "leakage_flow": "leakage_l_per_min",
}


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


def differences(fitted: FrameFit, rows: dict[str, list[Row]]) -> dict[str, object]:
    """Figures of a fit to a frame that are not those of the night's rows."""
    (fit,) = rows["fits"]
    figures: dict[str, object] = {}
    for part, judged in (("training", fitted.training), ("validation", fitted.validation)):
        figures[f"n_{part}"] = judged.n
        figures[f"{part}_fit_percent"] = judged.fit_percent
        figures[f"{part}_rmse_l_per_min"] = judged.rmse_l_per_min
    differing = {name: figure for name, figure in figures.items() if figure != fit[name]}
    columns = fitted.columns()
    for at, name in enumerate(columns["parameter"]):
        (row,) = [row for row in rows["parameters"] if row["parameter"] == name]
        for column in ("value", "lower", "upper", "verdict"):
            if columns[column][at] != row.get(column):
                differing[f"{column} {name}"] = columns[column][at]
    return differing


@pytest.mark.parametrize("more", ["", "[override.smoothing]\nwindow_s = 5.0\n"])
def test_the_same_figures_as_the_nightly_run_to_the_last_bit(tmp_path: Path, more: str) -> None:
    spec = load_motor(tmp_path, motor_toml("M1", more=more))
    time_us, values = night_like_the_demo_s(spec)
    prepared = prepare(as_frame(time_us, values), settings=spec.settings)
    prepared = replace(prepared, tolerances=tolerances(spec, NIGHT))
    outcome = fit_night(spec, night_of(), raw(time_us, values))
    assert outcome.status == OK
    fitted = prepared.fit(spec.motor(NIGHT, "none"))
    assert differences(fitted, outcome.rows) == {}

    refused = {(row["channel"], row["reason"]): row["n_refused"] for row in outcome.rows["quality"]}
    for row in prepared.refused.iter_rows(named=True):
        assert refused[row["channel"], row["reason"]] == row["n_refused"]
    assert {"out_of_range", "standstill"} <= set(prepared.refused["reason"])


def test_logs_are_prepared_as_a_frame_of_them_is(tmp_path: Path, spec: MotorSpec) -> None:
    time_us, values = night_like_the_demo_s(spec)
    write_log(tmp_path / "logs" / "M1" / "night.parquet", time_us, values)
    prepared = prepare_log(tmp_path / "configs" / "fleet.toml", "M1", NIGHT)
    assert prepared.frame.equals(prepare(as_frame(time_us, values)).frame)
    assert prepared.motor == spec.motor(NIGHT, "none")
    with pytest.raises(UsageError, match="no motor M2; there are M1"):
        prepare_log(tmp_path / "configs" / "fleet.toml", "M2", NIGHT)


def test_disorder_is_cleaned_and_an_empty_channel_is_reported(spec: MotorSpec) -> None:
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
    short = prepare(frame[:1])
    assert short.notes == (f"night of {NIGHT}: fewer than two samples in this night",)
    with pytest.raises(UsageError, match="can be used: night of 2026-03-02: fewer than two"):
        short.fit(spec.motor(NIGHT, "none"))


def test_tables_hold_all_nights_and_fits_the_primary_ones(tmp_path: Path) -> None:
    nights = [dt.date(2026, 1, 31), dt.date(2026, 2, 1)]  # in two months, so in two files
    rows = [
        {"motor_id": "M1", "night": night, "flushing_mode": mode, "is_primary": mode == "none"}
        for night in nights
        for mode in ("none", "fixed")
    ]
    write_nights(tmp_path, FITS, frame(FITS, rows))
    tables = open_tables(tmp_path)
    assert tables.table("fits").collect().height == 4
    fitted = tables.fits().collect()
    assert (fitted["night"].to_list(), fitted["is_primary"].all()) == (nights, True)
    # What has no files is empty, with its columns.
    assert tables.table("alarms").collect().schema == pl.Schema(ALARMS.schema)
    with pytest.raises(UsageError, match="no table fit; there are nights"):
        tables.table("fit")
    with pytest.raises(UsageError, match="run fit-fleet first"):
        open_tables(tmp_path / "nowhere")
