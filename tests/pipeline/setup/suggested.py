"""Logs that `check --suggest` is asked about, read with what it says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from pipeline.ingest import RawLog, read_log
from pipeline.setup.suggest import suggest
from tests.pipeline.setup.text_logs import EPOCH, Label, Samples, TextLog, in_unit
from tests.pipeline.simulated import load_motor

HEAD = 'motor_id = "M1"\nmotor_type = "CB560"\noil = "vg68"\n'
LABELS = {
    "pressure_difference": Label("dp", "kPa", "kPa"),
    "oil_temperature": Label("Oil temp", "degC", "°C"),
    "speed": Label("Speed", "rpm", "1/min"),
    "leakage_flow": Label("Drain flow", "l/min", "l/min"),
}
PLAIN = TextLog(LABELS)
START = datetime(2025, 3, 13, 6, tzinfo=UTC)


def times_of(count: int = 30, start: datetime = START, step_s: float = 1.0) -> list[datetime]:
    return [start + timedelta(seconds=i * step_s) for i in range(count)]


def samples_of(count: int = 30) -> dict[str, list[float | None]]:
    return {
        "pressure_difference": [200.5 + 0.25 * i for i in range(count)],
        "oil_temperature": [50.5 + 0.125 * (i % 5) for i in range(count)],
        "speed": [12.25 + 0.5 * (i % 7) for i in range(count)],
        "leakage_flow": [1.0625 + 0.0625 * (i % 3) for i in range(count)],
    }


def read_as_suggested(folder: Path, path: Path, toml: str) -> dict[str, RawLog]:
    """Logs by file, read with a motor's file that is the suggestion and the motor's name."""
    spec = load_motor(folder, HEAD + toml)
    found = {
        file.name: file
        for pattern in spec.file.logs.files
        for file in path.parent.parent.glob(pattern)
    }
    assert path.name in found, "the pattern of the files does not find the log"
    logs, channels = spec.file.logs, spec.file.channels
    return {name: read_log(file, logs, channels) for name, file in found.items()}


def require_same(
    logs: Sequence[RawLog], times: Sequence[datetime], samples: Samples, tolerance: float = 1e-9
) -> None:
    """All of the samples are there, at their times, in the units of the tables."""
    expected_us = np.array([(one - EPOCH) // timedelta(microseconds=1) for one in times])
    for channel, values in samples.items():
        (raw,) = [log.channels[channel] for log in logs if log.channels[channel].time_us.size]
        np.testing.assert_array_equal(raw.time_us, expected_us)
        assert raw.unparsed == 0
        wanted = np.array([np.nan if value is None else value for value in values])
        np.testing.assert_array_equal(raw.missing, np.isnan(wanted))
        np.testing.assert_allclose(raw.value, wanted, rtol=0, atol=tolerance)


def log_in(folder: Path, data: bytes, name: str = "log.csv") -> Path:
    path = folder / "logs" / "M1" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


def require_it_reads(folder: Path, path: Path, times: Any, samples: Any, **options: Any) -> str:
    toml = suggest(path)
    require_same(list(read_as_suggested(folder, path, toml).values()), times, samples, **options)
    return toml


DAY_OR_MONTH = r'day or month first\? The log begins on (.*) so, on (.*) with "(.*)"'


def columns_of(samples: Samples, dialect: TextLog = PLAIN) -> dict[str, pa.Array]:
    columns = {}
    for channel, label in dialect.labels.items():
        cells = [None if x is None else in_unit(x, label.unit) for x in samples[channel]]
        columns[dialect.label(channel)] = pa.array(cells, pa.float64())
    return columns


def us_of(times: Sequence[datetime]) -> list[int]:
    return [(one - EPOCH) // timedelta(microseconds=1) for one in times]


PARQUET_TIMES: Mapping[str, Any] = {
    "typed": lambda us: {"when": pa.array(us, pa.timestamp("us", "UTC"))},
    "naive": lambda us: {"when": pa.array([1000 * t for t in us], pa.timestamp("ns"))},
    "epoch_ms": lambda us: {"t": pa.array([t // 1000 for t in us])},
    "epoch_s": lambda us: {"time": pa.array([t / 1e6 for t in us])},
    "days": lambda us: {"Zeit": pa.array([25569 + t / 86_400e6 for t in us])},
    "text": lambda us: {
        "time": pa.array([f"{EPOCH + timedelta(microseconds=t):%d.%m.%Y %H:%M:%S}" for t in us])
    },
    "date and time": lambda us: {
        "Date": pa.array([f"{EPOCH + timedelta(microseconds=t):%d/%m/%Y}" for t in us]),
        "Time": pa.array([f"{EPOCH + timedelta(microseconds=t):%H:%M:%S}" for t in us]),
    },
}
