"""A recording as a file: CSV and Parquet, each in the dialect that the motor's config states."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq

from pipeline.config import Channel, MotorFile
from pipeline.demo.mcap_writer import mcap_bytes
from pipeline.demo.noise import FloatArray
from pipeline.demo.sensors import Recording
from pipeline.units import from_canonical

STAMP_FORMAT: Final = "%Y-%m-%dT%H:%M:%S%.3fZ"


def write_log(path: Path, recording: Recording, motor: MotorFile) -> None:
    """Write a recording to a file that is whole or not there."""
    write = {"csv": _write_csv, "parquet": _write_parquet, "mcap": _write_mcap}
    with replacing(path) as partial:
        write[motor.logs.format](partial, recording, motor)


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A name to write to, which takes the file's place when all went well."""
    partial = path.with_name(f".{path.name}.partial")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def as_logged(channel: str, values: FloatArray, source: Channel) -> FloatArray:
    """Values as the log holds them: the inverse of what the reader does."""
    in_unit = from_canonical(channel, values, source.unit)
    return np.round((in_unit - source.offset) / source.scale, 6) + 0.0  # no -0.0


def _write_csv(path: Path, recording: Recording, motor: MotorFile) -> None:
    time = pl.Series(motor.logs.time, recording.time_us).cast(pl.Datetime("us", "UTC"))
    columns = [
        pl.Series(channel.source, as_logged(name, recording.values[name], channel))
        for name, channel in motor.channels.items()
    ]
    pl.DataFrame([time, *columns]).fill_nan(None).write_csv(
        path,
        separator=motor.logs.separator,
        decimal_comma=motor.logs.decimal == ",",
        datetime_format=STAMP_FORMAT,
    )


def _write_parquet(path: Path, recording: Recording, motor: MotorFile) -> None:
    time = pa.array(recording.time_us, pa.timestamp("us", "UTC"))
    if motor.logs.time_format == "epoch_ms":
        time = pa.array(recording.time_us // 1000)
    columns = {
        channel.source: pa.array(as_logged(name, recording.values[name], channel), from_pandas=True)
        for name, channel in motor.channels.items()
    }
    table = pa.table({motor.logs.time: time} | columns)
    pq.write_table(table, path, compression="zstd", write_page_checksum=True)


def _write_mcap(path: Path, recording: Recording, motor: MotorFile) -> None:
    topics = {}
    for name, channel in motor.channels.items():
        values = recording.values[name]
        rows = np.flatnonzero(~np.isnan(values))
        stamps = recording.time_us[rows] + recording.own_delay_us[name][rows]
        topics[channel.source] = (rows, stamps, as_logged(name, values[rows], channel))
    path.write_bytes(mcap_bytes(topics))
