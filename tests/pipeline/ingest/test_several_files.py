"""One motor's channels in several files, some of them columns of one file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import polars as pl
import pytest

from pipeline.config.channels import Channels
from pipeline.ingest import read_log
from tests.pipeline.ingest.sources import column, logs_of

TIMES = ["2026-01-13T06:00:00Z", "2026-01-13T06:00:01Z"]
CHANNELS: Channels = {
    "pressure_difference": column("hydraulics_*", "bar", value_column="dp"),
    "oil_temperature": column("hydraulics_*", "degC", value_column="T"),
    "speed": column("drive_*", "rpm", value_column="n"),
    "leakage_flow": column("drain_*", "l/min"),
}


def write_csv(path: Path, table: pl.DataFrame) -> None:
    table.write_csv(path)


def write_parquet(path: Path, table: pl.DataFrame) -> None:
    table.write_parquet(path)


@pytest.mark.parametrize(
    ("log_format", "write"),
    [("csv", write_csv), ("parquet", write_parquet)],
    ids=["csv", "parquet"],
)
def test_each_file_gives_its_channels(
    tmp_path: Path, log_format: str, write: Callable[[Path, pl.DataFrame], None]
) -> None:
    logs = logs_of(log_format, layout="file_per_channel")
    for name, columns, expected in (
        (
            "hydraulics_1",
            {"dp": [200.0, 201.0], "T": [50.0, 50.5]},
            {"pressure_difference": [200.0, 201.0], "oil_temperature": [50.0, 50.5]},
        ),
        ("drive_1", {"n": [30.0, 31.0], "torque": [1.0, 2.0]}, {"speed": [30.0, 31.0]}),
        ("drain_1", {"value": [1.1, 1.2]}, {"leakage_flow": [1.1, 1.2]}),
    ):
        write(tmp_path / name, pl.DataFrame({"time": TIMES, **columns}))
        log = read_log(tmp_path / name, logs, CHANNELS)
        found = {key: one.value.tolist() for key, one in log.channels.items() if len(one.value)}
        assert found == expected
