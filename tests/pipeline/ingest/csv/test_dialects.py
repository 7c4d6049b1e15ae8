"""Dialects of loggers: packed files, headers that come again, layouts, marks, spreadsheets."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import zstandard

from pipeline.ingest import RawLog, time_span
from pipeline.ingest.conformance import T0_US
from tests.pipeline.ingest.csv_files import DAY, SOURCE, error, in_pieces, read

ROWS = "".join(f"{DAY}{i}Z,{i},{10 * i}\n" for i in range(5))


def values(log: RawLog, channel: str = "pressure_difference") -> list[float]:
    raw = log.channels[channel]
    return [float(value) for value in raw.value[~raw.missing]]


PACKERS: dict[str, Callable[[bytes], bytes]] = {
    "gzip": lambda data: gzip.compress(data, mtime=0),
    "zstd": zstandard.ZstdCompressor(write_checksum=True).compress,
}
each_packer = pytest.mark.parametrize("packer", PACKERS)


@each_packer
def test_packed_files_are_read_whatever_they_are_called(tmp_path: Path, packer: str) -> None:
    data = f"time,dp,n\n{ROWS}".encode()
    for name in ("log.csv", "log.csv.gz", "log"):
        log = read(tmp_path, PACKERS[packer](data), name=name)
        assert values(log) == [0.0, 1.0, 2.0, 3.0, 4.0]
        assert log.notes == ()
    # Loggers append a packed piece an hour.
    pieces = PACKERS[packer](data) + PACKERS[packer](ROWS.encode())
    assert read(tmp_path, pieces).rows == 10
    assert time_span(tmp_path / "log.csv", *SOURCE) == (T0_US, T0_US + 4_000_000)


@each_packer
def test_a_packed_file_that_is_cut_or_damaged_is_told(tmp_path: Path, packer: str) -> None:
    data = PACKERS[packer](f"time,dp,n\n{ROWS * 200}".encode())
    assert error(tmp_path, data[:-9]).code == "log_truncated"
    assert error(tmp_path, data[: len(data) // 2]).code == "log_truncated"
    at = len(data) - 6 if packer == "gzip" else len(data) - 2  # in the checksum
    damaged = data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]
    assert error(tmp_path, damaged).code == "log_damaged"


@pytest.mark.parametrize("magic", [b"PK\x03\x04", b"BZh9", b"\xfd7zXZ\x00", b"7z\xbc\xaf", b"Rar!"])
def test_other_packers_are_named(tmp_path: Path, magic: bytes) -> None:
    wrong = error(tmp_path, magic + bytes(100))
    assert wrong.code == "log_not_csv"
    assert "packed with" in wrong.message


@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
def test_a_header_that_comes_again_is_no_sample(tmp_path: Path, line_end: str) -> None:
    text = f"time,dp,n\nUTC,bar,rpm\n{ROWS}time,dp,n\nUTC,bar,rpm\n{ROWS}"
    log = read(tmp_path, text.replace("\n", line_end), SOURCE.but(unit_rows=1))
    assert values(log) == [0.0, 1.0, 2.0, 3.0, 4.0] * 2
    assert log.channels["pressure_difference"].unparsed == 0
    assert log.notes == ("1 line equal to the header",)


@pytest.mark.parametrize(
    "header",
    ["n,time,dp", "time,dp_bar,n", "time,n,dp", "n,x,time,dp", "time,dp,n,dp", '"time",dp,speed'],
)
@pytest.mark.parametrize("time_format", ["iso8601", "%Y-%m-%dT%H:%M:%S%z"])
def test_another_header_within_a_file_is_refused_with_its_line(
    tmp_path: Path, header: str, time_format: str
) -> None:
    """Read on by position, the wanted column would hold another one's readings."""
    text = f"time,dp,n\n{ROWS}{header}\n{DAY}6Z,1,2\n"
    wrong = error(tmp_path, text, SOURCE.but(time_format=time_format))
    assert (wrong.code, wrong.place) == ("log_not_csv", "line 7")
    assert "another header" in wrong.message


@pytest.mark.parametrize("piece", [64, 100, 1000])
def test_pieces_do_not_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, piece: int) -> None:
    text = "Logger 7\n" + f"time,dp,n\nUTC,bar,rpm\n{ROWS}" * 6 + "2025-03"
    source = SOURCE.but(skip_rows=1, unit_rows=1)
    whole = read(tmp_path, text, source)
    in_pieces(monkeypatch, piece)
    for line_end in ("\n", "\r\n"):
        log = read(tmp_path, text.replace("\n", line_end), source)
        assert values(log) == values(whole)
        assert log.notes == whole.notes


@pytest.mark.parametrize(
    ("thousands", "decimal", "cell", "value"),
    [
        (",", ".", "1,234.5", 1234.5),
        (",", ".", "-12,345,678", -12345678.0),
        (",", ".", "1234.5", 1234.5),
        (".", ",", "1.234,5", 1234.5),
        (".", ",", "+1.234", 1234.0),
        ("'", ".", "1'234.25", 1234.25),
        (" ", ",", "1 234,5", 1234.5),
        ("\u202f", ",", "1\u202f234,5", 1234.5),
        (",", ".", "1,23", None),
        (",", ".", "12,3456", None),
        (".", ",", "1.5", None),
        (",", ".", "1234,567", None),
        (",", ".", "1,234,56", None),
        (" ", ".", "1,234", None),
    ],
)
def test_marks_between_thousands(
    tmp_path: Path, thousands: str, decimal: str, cell: str, value: float | None
) -> None:
    source = SOURCE.but(separator=";", thousands=thousands, decimal=decimal)
    log = read(tmp_path, f"time;dp;n\n{DAY}0Z;{cell};1\n{DAY}1Z;7;1\n", source)
    assert values(log) == ([7.0] if value is None else [value, 7.0])
    assert log.channels["pressure_difference"].unparsed == (value is None)


def test_a_date_in_a_column_of_its_own(tmp_path: Path) -> None:
    source = SOURCE.but(date_column="date", time_format="%d.%m.%Y %H:%M:%S")
    text = "date,time,dp,n\n01.03.2025,06:00:00,1,2\n01.03.2025, 06:00:01 ,3,4\n,06:00:02,5,6\n"
    log = read(tmp_path, text, source)
    assert log.channels["speed"].time_us.tolist() == [T0_US, T0_US + 1_000_000]
    assert log.notes == ("1 row without a readable time",)
    assert time_span(tmp_path / "log.csv", *source) == (T0_US, T0_US + 1_000_000)
    iso = source.but(time_format="iso8601")
    apart = read(tmp_path, "date,time,dp,n\n2025-03-01,06:00:00,1,2\n", iso)
    assert apart.ends() == (T0_US, T0_US)


LONG = SOURCE.but(layout="long", channel_column="tag", value_column="v")


def test_long_tables(tmp_path: Path) -> None:
    rows = [
        f"{DAY}0Z,dp,1,x",
        f"{DAY}0Z, n ,100,x",
        f"{DAY}1Z,dp,Bad,x",
        f"{DAY}1Z,other,ERR,x",
        f"{DAY}2Z,n,120,x",
        "?,n,130,x",
    ]
    log = read(tmp_path, "time,tag,v,who\n" + "\n".join(rows) + "\n", LONG)
    assert values(log) == [1.0]
    assert log.channels["pressure_difference"].missing.tolist() == [False, True]
    assert values(log, "speed") == [100.0, 120.0]
    assert log.channels["speed"].time_us.tolist() == [T0_US, T0_US + 2_000_000]
    assert (log.rows, log.notes) == (4, ("1 row without a readable time",))
    assert log.channels["pressure_difference"].unparsed == 0


def test_rows_of_several_motors(tmp_path: Path) -> None:
    text = (
        f"time,machine,dp,n\n{DAY}0Z,A 1,1,10\n{DAY}0Z,A 2,2,20\n{DAY}1Z, A 1 ,3,30\n{DAY}1Z,,9,9\n"
    )
    source = SOURCE.but(motor_column="machine", motor_name="A 1")
    log = read(tmp_path, text, source)
    assert (values(log), values(log, "speed")) == ([1.0, 3.0], [10.0, 30.0])
    wrong = error(tmp_path, text, source.but(motor_name="A 3"))
    assert wrong.code == "log_column_missing"
    assert wrong.message.endswith(
        "no row of motor 'A 3' in column 'machine'; there are 'A 1', 'A 2'"
    )
    tags = f"time,machine,tag,v\n{DAY}0Z,A 1,dp,1\n{DAY}0Z,A 2,dp,2\n"
    assert values(read(tmp_path, tags, LONG.but(motor_column="machine", motor_name="A 2"))) == [2.0]


def test_a_long_table_without_a_channel_says_so(tmp_path: Path) -> None:
    log = read(tmp_path, f"time,tag,v\n{DAY}0Z,n,1\n", LONG)
    assert values(log) == []
    assert log.notes == ("no row of 'dp'; there are 'n'",)
    wrong = error(tmp_path, f"time,tag,v\n{DAY}0Z,N,1\n", LONG)
    assert wrong.code == "log_column_missing"
    assert "'N'" in wrong.message
    assert read(tmp_path, "time,tag,v\n", LONG).rows == 0


def test_the_hour_that_comes_twice_is_told_apart_across_pieces(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = datetime(2025, 10, 25, 22, 30, tzinfo=UTC)
    moments = [start + timedelta(minutes=i) for i in range(300)]
    offsets = [2 if moment < datetime(2025, 10, 26, 1, tzinfo=UTC) else 1 for moment in moments]
    rows = [
        f"{(moment + timedelta(hours=offset)).strftime('%d.%m.%Y %H:%M')},{i},1\n"
        for i, (moment, offset) in enumerate(zip(moments, offsets, strict=True))
    ]
    source = SOURCE.but(time_format="%d.%m.%Y %H:%M", time_zone="Europe/Stockholm")
    in_pieces(monkeypatch, 500)
    log = read(tmp_path, "time,dp,n\n" + "".join(rows), source)
    wanted = [int(moment.timestamp()) * 1_000_000 for moment in moments]
    assert log.channels["speed"].time_us.tolist() == wanted


def test_the_hour_that_never_comes_costs_its_rows(tmp_path: Path) -> None:
    source = SOURCE.but(time_zone="Europe/Stockholm")
    times = ["01:58:00", "01:59:00", "02:30:00", "03:00:00"]
    rows = "".join(f"2025-03-30 {clock},{i},1\n" for i, clock in enumerate(times))
    log = read(tmp_path, f"time,dp,n\n{rows}", source)
    assert values(log) == [0.0, 1.0, 3.0]
    assert log.notes == ("1 row at a local time that the zone's clock change leaves out",)
