"""Dialects told from the first lines: what is suggested reads what was written."""

from __future__ import annotations

import gzip
import json
import tomllib
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.config.motors import Channel, Logs
from pipeline.errors import LogError
from pipeline.ingest import ChannelSource, read_log
from pipeline.ingest.suggest import suggest

from .writers import T0_US

NAMES = ["dp [kPa]", "Oil temp [°C]", "Speed (rpm)", "Drain flow [l/min]"]
START = datetime(2025, 3, 1, 6, tzinfo=UTC)
SAMPLES = [[20000.0 + i, 50.5, 12.25, 1.0625] for i in range(30)]


def lines(
    form: str = "iso8601",
    separator: str = ",",
    decimal: str = ".",
    thousands: str = "",
    time: str = "Time",
    units: bool = False,
    names: list[str] = NAMES,
) -> list[str]:
    marks = str.maketrans({".": decimal, ",": thousands})
    found = [separator.join([time, *names])]
    if units:
        found.append(separator.join(["", "kPa", "°C", "1/min", "l/min"]))
    for i, row in enumerate(SAMPLES):
        moment = START + timedelta(seconds=i)
        if form.startswith("epoch"):
            stamp = str(int(moment.timestamp()) * {"epoch_s": 1, "epoch_ms": 1000}[form])
        elif form == "excel_days":
            stamp = f"{45717.25 + i / 86400:.9f}".translate(marks)
        else:
            stamp = moment.isoformat() if form == "iso8601" else moment.strftime(form)
        cells = [(f"{x:,.4f}" if thousands else repr(x)).translate(marks) for x in row]
        found.append(separator.join([stamp, *cells]))
    return found


def parsed(text: str) -> dict[str, Any]:
    return tomllib.loads(text)


def require_it_reads(path: Path, toml: str) -> None:
    found = parsed(toml)
    for table in found["channels"].values():
        Channel.model_validate(table, strict=False)
    logs = Logs.model_validate_json(json.dumps(found["logs"]))
    channels = tuple(
        ChannelSource(name, table["source"], table["unit"])
        for name, table in found["channels"].items()
    )
    log = read_log(path, logs.source(channels))
    assert log.rows == len(SAMPLES)
    wanted = {"pressure_difference": 0.01, "oil_temperature": 1, "speed": 1, "leakage_flow": 1}
    assert set(log.channels) == set(wanted)
    for k, (name, factor) in enumerate(wanted.items()):
        np.testing.assert_allclose(log.channels[name].value, [row[k] * factor for row in SAMPLES])
        assert log.channels[name].time_us[0] == T0_US
        assert log.channels[name].unparsed == 0


@pytest.mark.parametrize(
    ("dialect", "encoding", "line_end", "preamble"),
    [
        ({}, "utf-8", "\n", 0),
        ({}, "utf-8-sig", "\r\n", 2),
        ({"separator": ";", "decimal": ","}, "utf-16", "\r\n", 1),
        ({"separator": ";", "decimal": ",", "thousands": "."}, "cp1252", "\n", 3),
        ({"separator": "\t", "form": "epoch_ms"}, "utf-16-le", "\r", 0),
        ({"separator": ";", "form": "epoch_s"}, "utf-16-be", "\n", 0),
        ({"form": "%d.%m.%Y %H:%M:%S", "time": "Zeit"}, "utf-8", "\n", 0),
        ({"form": "%m/%d/%Y %I:%M:%S %p", "time": "Timestamp"}, "utf-8", "\n", 1),
        ({"form": "excel_days", "separator": ";", "decimal": ","}, "utf-8", "\n", 0),
        ({"units": True, "names": ["dp", "T_oil", "n", "q"]}, "utf-8", "\n", 0),
        ({"separator": "|", "time": "t"}, "utf-8", "\n", 0),
    ],
    ids=str,
)
def test_what_is_suggested_reads_the_log(
    tmp_path: Path, dialect: dict[str, Any], encoding: str, line_end: str, preamble: int
) -> None:
    text = line_end.join([*["Logger 7 of the mill"] * preamble, *lines(**dialect), ""])
    for name, pack in (("log.csv", bytes), ("log.csv.gz", gzip.compress)):
        path = tmp_path / name
        path.write_bytes(pack(text.encode(encoding)))
        require_it_reads(path, suggest(path))


def test_what_cannot_be_told_is_a_question(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time,dp,who\n2025-03-01 06:00:00,1,me\n2025-03-01 06:00:01,2,me\n")
    text = suggest(path)
    assert 'unit = "?"  # the log does not say it' in text
    assert "# not found, give source and unit: oil_temperature, speed, leakage_flow" in text
    assert '# columns not used: "who"' in text
    assert 'time_zone = "UTC"  # the stamps name no zone' in text
    assert parsed(text)["channels"]["pressure_difference"]["source"] == "dp"


def test_parquet_by_its_schema(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    counts = [T0_US + i * 1_000_000 for i in range(len(SAMPLES))]
    times = pa.array(counts, pa.timestamp("us", "UTC"))
    columns = {name: [row[k] for row in SAMPLES] for k, name in enumerate(NAMES)}
    pq.write_table(pa.table({"time": times, **columns}), path)
    require_it_reads(path, suggest(path))
    fields = ["dp_kPa", "temp_degC", "n_rpm", "q_l/min"]
    arrays = [pa.array(columns[name]) for name in NAMES]
    nested = pa.StructArray.from_arrays(arrays, names=fields)
    pq.write_table(pa.table({"time": times, "drive": nested}), path)
    require_it_reads(path, suggest(path))


@pytest.mark.parametrize("data", [b"", b"no table\n", b"\0\1\2" * 100, b"PAR1" + bytes(40)])
def test_what_is_no_log(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "log"
    path.write_bytes(data)
    with pytest.raises(LogError):
        suggest(path)
    with pytest.raises(LogError):
        suggest(tmp_path / "absent")
    with pytest.raises(LogError):
        suggest(tmp_path)


def test_the_command_prints_it(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("\n".join([*lines(), ""]))
    result = CliRunner().invoke(app, ["check", "--suggest", str(path)])
    assert result.exit_code == 0
    assert result.output == suggest(path)
