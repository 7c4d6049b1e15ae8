"""Log files of a motor, and what is found in them."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from pathlib import Path

from pipeline.config import Channel, MotorSpec
from pipeline.config.logs import Logs
from pipeline.logs.locations import FolderLogs
from pipeline.logs.processed import FileRecord

UNITS = {
    "pressure_difference": "bar",
    "oil_temperature": "degC",
    "speed": "rpm",
    "leakage_flow": "l/min",
}
EVENING = dt.datetime(2026, 1, 1, 22, tzinfo=dt.UTC)


def with_files(spec: MotorSpec, *files: str) -> MotorSpec:
    channels = {name: Channel(source=name, unit=unit) for name, unit in UNITS.items()}
    update = {"logs": Logs(format="csv", files=files), "channels": channels}
    return replace(spec, file=spec.file.model_copy(update=update))


def looked_at(path: Path, spec: MotorSpec, before: FileRecord | None = None) -> FileRecord:
    name = path.relative_to(spec.log_root).as_posix()
    logs = spec.file.logs.model_copy(update={"files": (name,)})
    here = replace(spec, file=spec.file.model_copy(update={"logs": logs}))
    return FolderLogs(here).stat_log(name, before)


def us(time: dt.datetime) -> int:
    return int(time.timestamp()) * 1_000_000
