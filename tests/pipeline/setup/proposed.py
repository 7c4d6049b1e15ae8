"""Logs that `init` is asked about, read with what it proposes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from pipeline.config import Channel
from pipeline.config.logs import Logs
from pipeline.ingest import RawLog, read_log
from pipeline.setup.names import meaning_of
from pipeline.setup.propose import Proposal, ProposedMotor, propose
from pipeline.units import canonical_unit
from tests.pipeline.setup.text_logs import EPOCH, Label, Samples, TextLog, in_unit

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


def proposed(source: Path, units: Mapping[str, str] | None = None, form: str = "") -> Proposal:
    """A proposal, with the answers of a person who knows the units and the form of the time."""
    answers: dict[str, str] = {}
    for _ in range(4):
        found = propose(source, answers)
        for one in found.questions:
            if one.key.startswith("unit of"):
                channel = one.text.split("unit of ")[1].split(" (")[0].replace(" ", "_")
                answers[one.key] = (units or {}).get(channel, canonical_unit(channel))
            elif one.key.startswith("time_format"):
                answers[one.key] = form or one.choices[0]
            elif "pressure" in one.key:
                high = [n for n in one.choices if meaning_of(n).channel == "high_port_pressure"]
                answers[one.key] = (*high, *one.choices)[0]
            else:
                answers[one.key] = "UTC" if one.key == "time_zone" else one.choices[0]
    assert not found.questions, found.questions
    return found


def read_as_proposed(motor: ProposedMotor, root: Path) -> list[RawLog]:
    """The logs of a motor, found and read with what is proposed."""
    logs = Logs.model_validate({**motor.logs, "files": tuple(motor.logs["files"])}, strict=False)
    channels: Any = {
        name: Channel.model_validate(one.keys()) for name, one in motor.channels.items()
    }
    found = sorted({path for pattern in logs.files for path in root.glob(pattern)})
    assert set(motor.files) <= set(found), "the patterns do not find the logs"
    return [read_log(path, logs, channels) for path in found]


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


def require_it_reads(
    source: Path, times: Any, samples: Samples, form: str = "", units: Any = None, **options: Any
) -> ProposedMotor:
    """The one motor that is proposed, of which every sample is read back."""
    found = proposed(source, units, form)
    (motor,) = found.motors
    require_same(read_as_proposed(motor, found.log_root), times, samples, **options)
    return motor


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
