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
from pipeline.demo.noise import FloatArray
from pipeline.demo.recording import Recording
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
    """Values as the log holds them: the inverse of what the reader does."""
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
    places, stamps, texts, topics = [], [], [], []
    for topic, (name, channel) in enumerate(motor.channels.items()):
        rows = np.flatnonzero(~np.isnan(recording.values[name]))
        values = as_logged(name, recording.values[name][rows], channel)
        places.append(rows)
        stamps.append(recording.time_us[rows] + recording.own_delay_us[name][rows])
        texts += pl.Series(np.rint(values * 1000.0) / 1000.0 + 0.0).cast(pl.String).to_list()
        topics += [topic] * rows.size
    stamp = np.concatenate(stamps)
    order = np.lexsort((stamp, np.concatenate(places))).tolist()
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(library="motor-leakage demo")
        schema = writer.register_schema("value", "jsonschema", SCHEMA)
        ids = [
            writer.register_channel(channel.source, "json", schema)
            for channel in motor.channels.values()
        ]
        sequence = dict.fromkeys(ids, 0)
        published = (1000 * stamp).tolist()
        for place in order:
            number = ids[topics[place]]
            payload = f'{{"value":{texts[place]:>{WIDTH}}}}'.encode()
            time_ns = published[place]
            writer.add_message(
                number, time_ns + RECORDING_DELAY_NS, payload, time_ns, sequence[number]
            )
            sequence[number] += 1
        writer.finish()  # type: ignore[no-untyped-call]
