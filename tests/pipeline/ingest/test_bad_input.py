"""Every kind of bad input, in every format: a code, the file's name and the place, and no other
exception. What only one format can do to a log stands beside it, in the tests of its reader."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from pipeline.config import load_fleet
from pipeline.config.channels import Channels
from pipeline.config.logs import Logs
from pipeline.errors import LogError
from pipeline.ingest import read_log, time_span
from pipeline.ingest.conformance import CHANNELS, T0_US, Format, Row
from pipeline.logs.files import covered
from pipeline.logs.processed import FileRecord
from tests.pipeline.simulated import motor_toml, write_configs

from .sources import Source, column
from .writers import FORMATS

NAMES = ("dp", "T", "q")
GOOD = {"dp": 200.0, "T": 50.0, "q": 1.0}
LONG = Source.of("csv", CHANNELS, layout="long")
OF_A_CHANNEL = LONG.but({"pressure_difference": column("log*", "bar")}, layout="file_per_channel")


def rows_of(count: int, **cells: Any) -> list[Row]:
    return [Row(T0_US + i * 100_000, GOOD | cells) for i in range(count)]


def check(
    path: Path,
    source: Source,
    code: str,
    says: str,
    read: Callable[[Path, Logs, Channels], object] = read_log,
) -> None:
    if not code:
        read(path, *source)
        return
    with pytest.raises(LogError, match=path.name) as raised:
        read(path, *source)
    assert raised.value.code == code
    assert says in raised.value.message


@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_all_null_is_read_as_what_it_is_and_told_by_the_file_s_record(
    form: Format, tmp_path: Path
) -> None:
    """A reader judges nothing but the file itself; the record of the file has the code."""
    (spec,) = load_fleet(write_configs(tmp_path, {"M1": motor_toml("M1")})).motors
    path = tmp_path / f"CB560-01.{form.log_format}"
    record = FileRecord(path.name, 1, 1, "x")
    form.write(path, rows_of(5, dp=None, T=None, q=None), NAMES)
    log = read_log(path, form.logs, CHANNELS)
    assert all(channel.missing.all() for channel in log.channels.values())
    with pytest.raises(LogError, match=path.name) as raised:
        covered(record, log, spec)
    assert (raised.value.code, raised.value.place) == ("log_empty", "pressure_difference")
    assert "all 5 cells of leakage_flow are blank" in raised.value.message
    form.write(path, rows_of(5, T=None), NAMES)
    found = covered(record, read_log(path, form.logs, CHANNELS), spec)
    assert (found.status, found.message) == ("ok", "all 5 cells of oil_temperature are blank")


@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_what_may_not_be_opened(
    form: Format, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / f"CB560-01.{form.log_format}"
    form.write(path, rows_of(5), NAMES)
    if os.geteuid():
        path.chmod(0)
    else:  # for whom nothing is forbidden

        def refuse(*_: object, **__: object) -> None:
            raise PermissionError(13, "Permission denied", str(path))

        monkeypatch.setattr(Path, "open", refuse)
        monkeypatch.setattr(pq, "ParquetFile", refuse)
    for read in (read_log, time_span):
        check(path, Source(form.logs, CHANNELS), "log_not_readable", "Permission denied", read)


def csv_of(folder: Path, data: bytes | str) -> Path:
    path = folder / "log.csv"
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return path


@pytest.mark.parametrize(
    ("source", "data", "code", "says"),
    [
        (LONG, "time,channel,value\n", "", ""),
        (LONG, "time,channel\n2025-03-01,dp\n", "log_column_missing", "'value'"),
        (LONG, "time,channel,value\n2025-03-01T06:00:00Z,other,1\n", "log_column_missing", "'dp'"),
        (LONG, "time,channel,value\n2025-03-01T06:00:00Z,dp,x\n", "log_type", "log.csv, dp: "),
        (LONG, "time,channel,value\n2150-03-01T06:00:00Z,dp,1\n", "log_time", "in the future"),
        (LONG, "time,channel,value\n2025-03-01T06:00:00Z,dp\n", "log_not_csv", "log.csv, line 2"),
        (OF_A_CHANNEL, "time,value\n", "", ""),
        (OF_A_CHANNEL, "time,valeu\n2025-03-01,1\n", "log_column_missing", "'value'"),
        (OF_A_CHANNEL, "time,value\n2025-03-01T06:00:00Z,x\n", "log_type", "no number in 1 cell"),
        (OF_A_CHANNEL, "time,value\nnow,1\n", "log_time", "cannot be read"),
        (OF_A_CHANNEL, 'time,value\n2025-03-01T06:00:00Z,1\nx,"1\n', "log_damaged", "log.csv"),
    ],
)
def test_other_layouts(tmp_path: Path, source: Source, data: str, code: str, says: str) -> None:
    check(csv_of(tmp_path, data), source, code, says)


def test_a_quotation_mark_that_is_not_closed_is_named_by_its_line(tmp_path: Path) -> None:
    stamp = "2025-03-01T06:00:0"
    rows = [f"{stamp}{i % 10}Z,1,2,3" for i in range(40)]
    rows[20] = f'{stamp}0Z,1,"2,3'
    path = csv_of(tmp_path, "\n".join(["time,dp,T,q", *rows, ""]))
    with pytest.raises(LogError, match="quotation mark") as raised:
        read_log(path, *Source.of("csv", CHANNELS))
    assert (raised.value.code, raised.value.place) == ("log_damaged", "line 22")
