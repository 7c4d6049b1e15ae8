"""Demo fleet on disk: the shipped configs, simulated logs of six motors, and the truth.

Logs are CSV, Parquet or MCAP, in the dialect that the motor's config states.
"""

from __future__ import annotations

import datetime as dt
import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import joblib
import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
from mcap.writer import CompressionType, Writer

from pipeline.config import Channel, MotorFile, load_fleet
from pipeline.demo import shipped_configs
from pipeline.demo.fleet import (
    DEMO_FLEET,
    DemoNight,
    FloatArray,
    Plan,
    Recording,
    record_night,
    truth_document,
)
from pipeline.errors import UsageError
from pipeline.units import from_canonical

# Says that a folder is ours to clear.
MARKER: Final = ".motor-leakage-demo"
STAMP_FORMAT: Final = "%Y-%m-%dT%H:%M:%S%.3fZ"
RECORDING_DELAY_NS: Final = 1_500_000  # from a message's publication to its record
SCHEMA: Final = b'{"type":"object","properties":{"value":{"type":"number"}},"required":["value"]}'
WIDTH: Final = 10  # of a value with three decimals


def write_demo(
    folder: Path,
    *,
    nights: int = 75,
    minutes: float = 90,
    rate_hz: float = 5.0,
    seed: int = 1,
    workers: int = 2,
    first_night: dt.date = dt.date(2026, 1, 2),
    motors: Sequence[str] = (),
) -> None:
    """Write the logs of the fleet ``configs/fleet.toml`` of a folder to ``demo/`` beside it.

    ``demo/`` must be absent, empty, or an earlier demo, whose logs are replaced; `motors` are those
    that get logs, all if empty. The same seed makes the same files, whatever the number of workers.

    Raises UsageError (``demo_configs``, ``demo_folder``) if the folder cannot be written or is not
    ours; ConfigError if the fleet's config has faults.
    """
    plan = Plan(nights, float(minutes), float(rate_hz), seed, first_night)
    demo = folder / "demo"
    try:
        _require_ours(demo)
        if not (folder / "configs").exists():
            _copy_configs(folder / "configs")
        fleet = load_fleet(folder / "configs" / "fleet.toml")
        nights_to_make = [
            DemoNight(motor, fleet.motor(motor.motor_id), plan, number)
            for motor in DEMO_FLEET
            for number in range(1, plan.nights + 1)
        ]
        _clear(demo)
        joblib.Parallel(workers)(
            joblib.delayed(_write_night)(demo / "logs", night)
            for night in nights_to_make
            if not motors or night.demo.motor_id in motors
        )
        document = truth_document(plan, nights_to_make)
        (demo / "truth.json").write_text(json.dumps(document, indent=1) + "\n", "utf-8")
    except OSError as error:
        raise UsageError(
            "demo_folder",
            f"{error.filename or folder} cannot be written: {error.strerror}; name another folder,"
            " or repeat when that is solved",
        ) from error


def _require_ours(demo: Path) -> None:
    """Refuse a folder that may hold something of somebody's."""
    is_there = demo.exists() or demo.is_symlink()
    is_free = not is_there or (demo.is_dir() and not any(demo.iterdir()))
    if not is_free and not (demo / MARKER).is_file():
        message = f"{demo} is neither empty nor a demo; move it away, or name another folder"
        raise UsageError("demo_folder", message)


def _clear(demo: Path) -> None:
    """Make the demo's folder ready: an earlier demo's logs go."""
    demo.mkdir(parents=True, exist_ok=True)
    # First: a demo that was interrupted can be made again.
    words = "`motor-leakage demo` made this folder and may replace its logs\n"
    (demo / MARKER).write_text(words, "utf-8")
    (demo / "truth.json").unlink(missing_ok=True)
    for motor in DEMO_FLEET:
        shutil.rmtree(demo / "logs" / motor.motor_id, ignore_errors=True)
        (demo / "logs" / motor.motor_id).mkdir(parents=True)


def _copy_configs(configs: Path) -> None:
    """Copy the shipped configs, whole or not at all."""
    partial = configs.with_name(".configs.partial")
    shutil.rmtree(partial, ignore_errors=True)
    shutil.copytree(shipped_configs(), partial)
    partial.rename(configs)


def _write_night(logs: Path, night: DemoNight) -> None:
    motor = night.spec.file
    name = f"{motor.motor_id}_{night.label}.{motor.logs.format}"
    write_log(logs / motor.motor_id / name, record_night(night), motor)


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
        if channel.constant is None
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
    """Write messages of the same length, in the order in which they were recorded."""
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
