"""A recording as a file: CSV, Parquet or MCAP, in the dialect that the motor's config states."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
from mcap.writer import CompressionType, Writer

from pipeline.config import Channel, MotorFile
from pipeline.demo.recording import FloatArray, Recording
from pipeline.units import from_canonical

STAMP_FORMAT: Final = "%Y-%m-%dT%H:%M:%S%.3fZ"
RECORDING_DELAY_NS: Final = 1_500_000  # from a message's publication to its record
SCHEMA: Final = b'{"type":"object","properties":{"value":{"type":"number"}},"required":["value"]}'
WIDTH: Final = 10  # of a value with three decimals


def write_log(path: Path, recording: Recording, motor: MotorFile) -> None:
    """Write a recording to a file that is whole or not there."""
    write = {"csv": _write_csv, "parquet": _write_parquet, "mcap": _write_mcap}
    partial = path.with_name(f".{path.name}.partial")
    write[motor.logs.format](partial, recording, motor)
    partial.replace(path)


def as_logged(channel: str, values: FloatArray, source: Channel) -> FloatArray:
    """Return values as the log holds them: the inverse of what the reader does."""
    in_unit = from_canonical(channel, values, source.unit)
    return np.round((in_unit - source.offset) / source.scale, 6) + 0.0  # no -0.0


def _columns(recording: Recording, motor: MotorFile) -> dict[str, FloatArray]:
    return {
        channel.source: as_logged(name, recording.values[name], channel)
        for name, channel in motor.channels.items()
    }


def _write_csv(path: Path, recording: Recording, motor: MotorFile) -> None:
    time = pl.Series(recording.time_us).cast(pl.Datetime("us", "UTC"))
    rows = pl.DataFrame({motor.logs.time: time} | _columns(recording, motor))
    rows.fill_nan(None).write_csv(
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
        name: pa.array(values, from_pandas=True)
        for name, values in _columns(recording, motor).items()
    }
    table = pa.table({motor.logs.time: time} | columns)
    pq.write_table(table, path, compression="zstd", write_page_checksum=True)


def _write_mcap(path: Path, recording: Recording, motor: MotorFile) -> None:
    """Messages of one length, in the order in which they were recorded."""
    messages: list[tuple[int, int, int, str]] = []
    for topic, (name, channel) in enumerate(motor.channels.items()):
        rows = np.flatnonzero(~np.isnan(recording.values[name]))
        values = np.rint(as_logged(name, recording.values[name][rows], channel) * 1000.0) / 1000.0
        stamps = 1000 * (recording.time_us[rows] + recording.own_delay_us[name][rows])
        texts = pl.Series(values + 0.0).cast(pl.String).to_list()
        messages += zip(rows.tolist(), stamps.tolist(), [topic] * rows.size, texts, strict=True)
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(library="motor-leakage demo")
        schema = writer.register_schema("value", "jsonschema", SCHEMA)
        ids = [
            writer.register_channel(channel.source, "json", schema)
            for channel in motor.channels.values()
        ]
        for _, time_ns, topic, text in sorted(messages):
            payload = f'{{"value":{text:>{WIDTH}}}}'.encode()
            writer.add_message(ids[topic], time_ns + RECORDING_DELAY_NS, payload, time_ns)
        writer.finish()  # type: ignore[no-untyped-call]
