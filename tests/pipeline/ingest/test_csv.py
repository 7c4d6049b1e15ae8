"""CSV logs: what is read of a text, and what is refused with which message."""

from __future__ import annotations

import gzip
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard

import pipeline.ingest.csv
from pipeline.errors import LogError
from pipeline.ingest import RawLog, read_log, time_span
from pipeline.ingest.conformance import T0_US
from pipeline.ingest.csv import read_lines

from .sources import Source, column

SOURCE = Source.of("csv", {"pressure_difference": column("dp", "bar"), "speed": column("n", "rpm")})
DAY = "2025-03-01T06:00:0"
HEAD = "time,dp,n\n"
ROWS = "".join(f"{DAY}{i}Z,{i},{10 * i}\n" for i in range(5))
TORN = "1 last row without a line end (it may be cut)"
NO_TIME = "1 row without a readable time"
RAGGED = "with too many or too few cells, the first has"
NO_HOUR = "1 row at a local time that the zone's clock change leaves out"
LONG = {"layout": "long", "channel_column": "tag", "value_column": "v"}
OF_A_CHANNEL = {
    "channels": {"pressure_difference": column("log*", "bar")},
    "layout": "file_per_channel",
}
TAGS = "\n".join(
    [
        *("time,tag,v,who", f"{DAY}0Z,dp,1,x", f"{DAY}0Z, n ,100,x", f"{DAY}1Z,dp,Bad,x"),
        *(f"{DAY}1Z,other,ERR,x", f"{DAY}2Z,n,120,x", "?,n,130,x", ""),
    ]
)
MOTORS = f"time,machine,dp,n\n{DAY}0Z,A 1,1,1\n{DAY}0Z,A 2,2,2\n{DAY}1Z, A 1 ,3,3\n{DAY}1Z,,9,9\n"
MOTOR = {"motor_rows": ("machine", "A 1")}
LATIN = "time,T (°C),n\n".encode("latin-1") + f"{DAY}0Z,50,2\n".encode()
IN_STOCKHOLM = {"time_zone": "Europe/Stockholm"}
APART = {"date_column": "date", "time_format": "%d.%m.%Y %H:%M:%S"}
POWER_CUT = "".join(f"{DAY}{i % 10}Z,{i},{i}\n" for i in range(400)).encode()


def read(folder: Path, data: bytes | str, source: Source = SOURCE, name: str = "log.csv") -> RawLog:
    """The log that a file's content is read as."""
    path = folder / name
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return read_log(path, *source)


def error(folder: Path, data: bytes | str, source: Source = SOURCE) -> LogError:
    """The error that reading ends in, which names the file."""
    with pytest.raises(LogError, match=r"log\.csv") as raised:
        read(folder, data, source)
    return raised.value


def values(log: RawLog, channel: str = "pressure_difference") -> list[float]:
    raw = log.channels[channel]
    return [float(value) for value in raw.value[~raw.missing]]


def in_pieces(patch: pytest.MonkeyPatch, size: int) -> None:
    """Have texts read in pieces of so many bytes."""

    def pieces(path: Path, encoding: str, _: int = 0) -> Any:
        return read_lines(path, encoding, size)

    patch.setattr(pipeline.ingest.csv, "read_lines", pieces)


def rows(*cells: str) -> str:
    """A row a second, from cells or from a stamp and cells."""
    return HEAD + "".join(f"{DAY}{i}Z,{cell}\n" for i, cell in enumerate(cells))


# Content, keys of the source, readings of the pressure, cells without a number, notes.
Case = tuple[bytes | str, dict[str, Any], list[float], int, tuple[str, ...]]
READ: dict[str, Case] = {
    # The row was "300.5,120": cut after "30" it would read as 30 bar and no speed.
    "a last row that is cut": (f"{rows('1,2')}{DAY}1Z,30", {}, [1], 0, (TORN,)),
    "a last row of all cells": (f"{rows('1,2')}{DAY}1Z,300.5,12", {}, [1], 0, (TORN,)),
    "rows of another width": (
        *(rows("0,0", "1,1", "2,2", "3,3,9", "4,4", "5", "6,6"), {}, [0, 1, 2, 4, 6], 0),
        (f"2 rows {RAGGED} 4 in '{DAY}3Z,3,3,9'",),
    ),
    "a header below other lines": (
        *(f"Logger 7, serial 1234\n# dp, n\n{rows('1,2')}", {"skip_rows": 2}, [1], 0, ()),
    ),
    "columns of any order": (f"x, n ,x,,dp,time\na,2,b,c,1,{DAY}0Z\n", {}, [1], 0, ()),
    "bytes that are no text": (
        rows("0,0", "\xff1,1", "2,2", "3;3", "4,4").encode("latin-1").replace(b"2Z", b"2\x93"),
        *({}, [0, 4], 1, (f"1 row {RAGGED} 2 in '{DAY}3Z,3;3'", NO_TIME)),
    ),
    "zeros that a power cut leaves": (
        HEAD.encode() + POWER_CUT + bytes(512) + POWER_CUT[:110],
        *({}, [*range(400), 1, 2, 3], 0, (TORN, NO_TIME)),
    ),
    "a decimal comma": (
        "time;dp;n\n" + "".join(f"{DAY}0Z;{c};1\n" for c in ("1,5", "1.234", "1.234,5", "7")),
        *({"separator": ";", "decimal": ","}, [1.5, 7], 2, ()),
    ),
    "chosen tokens": (
        *(rows("-9999,1", "NaN,1", "2,1"), {"missing_tokens": ("", "-9999", "NaN")}, [2], 0, ()),
    ),
    "times that are none": (
        f"{HEAD},1,1\n{DAY}0Z,2,1\nyesterday,3,1\n2025-02-30T00:00:00Z,4,1\n{ROWS}",
        *({}, [2, 0, 1, 2, 3, 4], 0, ("3 rows without a readable time",)),
    ),
    "a header again": (
        f"{HEAD}UTC,bar,rpm\n{ROWS}{HEAD}UTC,bar,rpm\n{ROWS}",
        *({"unit_rows": 1}, [0, 1, 2, 3, 4] * 2, 0, ("2 rows without a readable time",)),
    ),
    "rows of words": (
        f"{HEAD}{ROWS}Logger,off,off\nstate,dp,9\n",
        *({}, [0, 1, 2, 3, 4], 0, ("2 rows without a readable time",)),
    ),
    "an hour that never comes": (
        HEAD + "".join(f"2025-03-30 0{t},{t[-1]},1\n" for t in ("1:58", "1:59", "2:31", "3:00")),
        *(IN_STOCKHOLM, [8, 9, 0], 0, (NO_HOUR,)),
    ),
    "a date apart": (
        "date,time,dp,n\n01.03.2025,06:00:00,1,2\n01.03.2025, 06:00:01 ,3,4\n,06:00:02,5,6\n",
        *(APART, [1, 3], 0, (NO_TIME,)),
    ),
    "an ISO date apart": (
        *("date,time,dp,n\n2025-03-01,06:00:00,1,2\n", {"date_column": "date"}, [1], 0, ()),
    ),
    "a long table": (TAGS, LONG, [1], 0, (NO_TIME,)),
    "a long table without a channel": (
        *(f"time,tag,v\n{DAY}0Z,n,1\n", LONG, [], 0, ("no row of 'dp'; there are 'n'",)),
    ),
    "a long table without rows": ("time,tag,v\n", LONG, [], 0, ()),
    "a file a channel without rows": ("time,value\n", OF_A_CHANNEL, [], 0, ()),
    "rows of several motors": (MOTORS, MOTOR, [1, 3], 0, ()),
    "a long table of several motors": (
        f"time,machine,tag,v\n{DAY}0Z,A 1,dp,1\n{DAY}0Z,A 2,dp,2\n{DAY}0Z,A 1,n,2\n",
        *({**LONG, **MOTOR}, [1], 0, ()),
    ),
    "utf-16 cut within a character": (
        *(rows("1,2", "3,4").encode("utf-16")[:-7], {"encoding": "utf-16"}, [1], 0, (TORN,)),
    ),
}


@pytest.mark.parametrize("case", READ.values(), ids=READ.keys())
def test_what_is_read(tmp_path: Path, case: Case) -> None:
    data, keys, wanted, unparsed, notes = case
    log = read(tmp_path, data, SOURCE.but(**keys))
    channel = log.channels["pressure_difference"]
    assert (values(log), channel.unparsed, log.notes) == (wanted, unparsed, notes)
    if wanted and "layout" not in keys:
        assert time_span(tmp_path / "log.csv", *SOURCE.but(**keys)) == log.ends()


QUOTED = "log_damaged: a quotation mark is opened"
ANOTHER = "log_not_csv: another header"
WITH_ZONE = "%Y-%m-%dT%H:%M:%S%z"
# Content, keys of the source, code and a part of the message.
REFUSED: dict[str, tuple[bytes | str, dict[str, Any], str]] = {
    "rows of another width": (
        *(rows(*["1,2,3"] * 9), {}),
        "log_not_csv: 9 of 9 rows have not the header's 3 cells, the first has 4",
    ),
    "a mark in the middle": (f'{HEAD}{DAY}0Z,"1,2\n{ROWS}', {}, QUOTED),
    "a mark in the last cell": (f'{HEAD}{DAY}0Z,1,"2\n{ROWS}', {}, QUOTED),
    "two marks": (f'{HEAD}{DAY}0Z,1,"2\n{ROWS}{DAY}9Z,1,"2\n', {}, QUOTED),
    "no header there": (f"Logger 7\n# dp, n\n{ROWS}", {}, "log_column_missing: 'Logger 7'"),
    "too many lines passed over": (rows("1,2"), {"skip_rows": 9}, "log_empty: 9 skipped"),
    "a column twice": (f"time,dp,n,dp\n{DAY}0Z,1,2,3\n", {}, "log_column_twice: 'dp'"),
    "another separator": (f"time;dp;n\n{DAY}0Z;1;2\n", {}, "log_column_missing: 'time;dp;n'"),
    "a letter of latin-1": (LATIN, {}, "log_column_missing: not in encoding utf-8"),
    "blank lines": (b"\n\n\n", {}, "log_empty: no header"),
    "blanks": (b"   \n", {}, "log_empty: no header"),
    "a mark of the encoding alone": (b"\xef\xbb\xbf", {}, "log_empty: no header"),
    "a header that is cut": ("time,dp", {}, "log_truncated: the header has no line end"),
    "a header without end": (b"x" * (2**20 + 1), {}, "log_not_csv: line 1: the header is longer"),
    "a row without end": (
        f"{HEAD}{ROWS * 12_000}{DAY}0Z,{'1' * (5 * 2**20)},2\n{ROWS * 12_000}",
        *({}, "log_damaged: the rows are ambiguous"),
    ),
    "an SQLite database": (b"SQLite format 3\0" + bytes(100), {}, "log_not_csv: SQLite"),
    "nothing but zero bytes": (bytes(5000), {}, "log_damaged: zero bytes"),
    **{
        f"a long table, {name}": (f"time,tag,v\n{row}\n", LONG, code)
        for name, row, code in (
            ("others", f"{DAY}0Z,N,1", "log_column_missing: 'N'"),
            ("text", f"{DAY}0Z,dp,x", "log_type: log.csv, dp: "),
            ("the future", "2150-03-01T06:00:00Z,dp,1", "log_time: in the future"),
            ("a cell too few", f"{DAY}0Z,dp", f"log_not_csv: has 2 in '{DAY}0Z,dp'"),
        )
    },
    "a long table without values": (f"time,tag\n{DAY}0Z,dp\n", LONG, "log_column_missing: 'v'"),
    **{
        f"a file a channel, {name}": (f"time,{head}\n{row}\n", OF_A_CHANNEL, code)
        for name, head, row, code in (
            ("another column", "valeu", f"{DAY}0Z,1", "log_column_missing: 'value'"),
            ("text", "value", f"{DAY}0Z,x", "log_type: no number in 1 cell"),
            ("no time", "value", "now,1", "log_time: cannot be read"),
            ("a mark", "value", f'{DAY}0Z,1\nx,"1', "log_damaged: log.csv"),
        )
    },
    "a mark among others": (
        HEAD + f"{DAY}0Z,1,2\n" * 20 + f'{DAY}7Z,"1,2\n' + f"{DAY}0Z,1,2\n" * 9,
        *({}, f"log_damaged: in its row: '{DAY}7Z"),
    ),
    "no row of the motor": (
        *(MOTORS, {"motor_rows": ("machine", "A 3")}),
        "log_column_missing: no row of motor 'A 3' in column 'machine'; there are 'A 1', 'A 2'",
    ),
    **{
        f"{name} that is not named": (rows("1,2").encode(name), {}, f"log_encoding: {name[:6]}")
        for name in ("utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-32-le")
    },
    **{
        f"packed with {name}": (magic + bytes(100), {}, f"log_not_csv: packed with {name}")
        for name, magic in (
            *(("zip", b"PK\x03\x04"), ("bzip2", b"BZh9"), ("xz", b"\xfd7zXZ\x00")),
            *(("7z", b"7z\xbc\xaf"), ("rar", b"Rar!")),
        )
    },
    # Read on by position, the wanted column would hold another one's readings.
    **{
        f"{header}, {form}": (
            f"{HEAD}{ROWS}{header}\n{DAY}6Z,1,2\n",
            {"time_format": form},
            ANOTHER,
        )
        for header in (
            *("n,time,dp", "time,dp_bar,n", "time,n,dp", "n,x,time,dp", "time,dp,n,dp"),
            *('"time",dp,speed', "Time,n,dp", "Zeit,Drehzahl,Druck", "DateTime,T [°C],n"),
        )
        for form in ("iso8601", WITH_ZONE)
    },
}


@pytest.mark.parametrize(("data", "keys", "expected"), REFUSED.values(), ids=REFUSED.keys())
def test_what_is_refused(
    tmp_path: Path, data: bytes | str, keys: dict[str, Any], expected: str
) -> None:
    code, said = expected.split(": ", 1)
    wrong = error(tmp_path, data, SOURCE.but(**keys))
    assert wrong.code == code
    assert said in wrong.message


@pytest.mark.parametrize(
    ("cell", "value"),
    [
        ("1", 1.0),
        ("+1.5", 1.5),
        (" 2.5 ", 2.5),
        ("\t3", 3.0),
        ("-0", 0.0),
        (".5", 0.5),
        ("5.", 5.0),
        ("1e-3", 1e-3),
        ("1E+03", 1000.0),
        ("+.5e1", 5.0),
        ("0007", 7.0),
        ("1e999", np.inf),
        ("nan", np.nan),
        ("NaN", np.nan),
        ("-INF", -np.inf),
        ("Infinity", np.inf),
        ("+inf", np.inf),
        *((text, None) for text in ("1;5", "1.5.1", "1 5", "--1", "+-1", "1e", "e5", ".", "0x1F")),
        *((text, None) for text in ("1_000", "٣", "½", "12 bar", "#")),
    ],
)
def test_what_is_a_number(tmp_path: Path, cell: str, value: float | None) -> None:
    # Once beside a number, once beside a bad cell: both ways of reading must agree.
    for other in ("2", "?"):
        log = read(tmp_path, rows(f"{cell},1", f"{other},1", "2,1"))
        channel = log.channels["pressure_difference"]
        assert channel.missing.tolist() == [value is None, other == "?", False]
        assert channel.unparsed == (value is None) + (other == "?")
        np.testing.assert_array_equal(channel.value[:1], [np.nan if value is None else value])


def test_the_example_of_what_is_no_number_is_a_number_if_any(tmp_path: Path) -> None:
    for cells, example in ((("1.#IND,1", "1 020,1", "2,1"), "1 020"), (("off,1", "2,1"), "off")):
        channel = read(tmp_path, rows(*cells)).channels["pressure_difference"]
        assert (channel.unparsed, channel.example) == (len(cells) - 1, example)


def test_tokens_that_mean_no_sample_are_missing_and_not_unparsed(tmp_path: Path) -> None:
    tokens = ["", " ", "null", "NULL", "NA", "N/A", " NA ", "---", "Bad", "-", "n/a", "#N/A"]
    for bad in (0, 1):
        cells = [f"{DAY}0Z,{cell},1\n" for cell in [*tokens, "2", *["?"] * bad]]
        channel = read(tmp_path, HEAD + "".join(cells)).channels["pressure_difference"]
        assert channel.missing.tolist() == [True] * len(tokens) + [False] + [True] * bad
        assert channel.unparsed == bad


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


# Packed files, pieces and limits

PACKERS: dict[str, Callable[[bytes], bytes]] = {
    "gzip": lambda data: gzip.compress(data, mtime=0),
    "zstd": zstandard.ZstdCompressor(write_checksum=True).compress,
}


@pytest.mark.parametrize("packer", PACKERS)
def test_packed_files(tmp_path: Path, packer: str) -> None:
    """Whatever they are called; what is cut or damaged is told."""
    pack = PACKERS[packer]
    for name in ("log.csv", "log.csv.gz", "log"):
        log = read(tmp_path, pack((HEAD + ROWS).encode()), name=name)
        assert (values(log), log.notes) == ([0.0, 1.0, 2.0, 3.0, 4.0], ())
    # Loggers append a packed piece an hour.
    assert read(tmp_path, pack((HEAD + ROWS).encode()) + pack(ROWS.encode())).rows == 10
    assert time_span(tmp_path / "log.csv", *SOURCE) == (T0_US, T0_US + 4_000_000)
    data = pack(f"{HEAD}{ROWS * 200}".encode())
    for cut in (data[:-9], data[: len(data) // 2]):
        assert error(tmp_path, cut).code == "log_truncated"
    at = len(data) - 6 if packer == "gzip" else len(data) - 2  # in the checksum
    assert error(tmp_path, data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]).code == "log_damaged"


@pytest.mark.parametrize("piece", [64, 100, 1000])
@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
def test_pieces_and_line_ends_do_not_show(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, piece: int, line_end: str
) -> None:
    text = "Logger 7\n" + f"{HEAD}UTC,bar,rpm\n{ROWS}" * 6 + "2025-03"
    source = SOURCE.but(skip_rows=1, unit_rows=1)
    in_pieces(monkeypatch, piece)
    log = read(tmp_path, text.replace("\n", line_end), source)
    assert values(log) == [0.0, 1.0, 2.0, 3.0, 4.0] * 6
    assert log.notes == (TORN, "10 rows without a readable time")


def test_the_span_of_a_long_file_needs_its_ends_only(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    lines = [f"{1740808800 + i},{i},{i}\n" for i in range(40_000)]
    source = SOURCE.but(time_format="epoch_s")
    span = (T0_US, T0_US + 39_999_000_000)
    path.write_text(HEAD + "".join(lines))
    assert time_span(path, *source) == span
    # Damage in the middle is not seen, a torn last row is left out, as when the log is read.
    lines[20_000:20_010] = ["?\n"] * 10
    path.write_text(HEAD + "".join(lines) + "1740848801,3")
    assert time_span(path, *source) == span
    # Ends that cannot be read by themselves: the whole file decides.
    lines[-5000:] = ["?,1,1\n"] * 5000
    path.write_text(HEAD + "".join(lines))
    assert time_span(path, *source) == (T0_US, T0_US + 34_999_000_000)


def test_a_file_too_large_for_memory_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipeline.ingest.csv, "LARGEST_TEXT", 20)
    assert error(tmp_path, rows("1,2")).code == "log_too_large"


def test_a_bomb_is_stopped_long_before_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By what has been unpacked of it so far: rows that are kept until then take memory."""
    monkeypatch.setattr(pipeline.ingest.csv, "_RATIO_FROM", 2**20)
    path = tmp_path / "log.csv.gz"
    noise = random.Random(5).randbytes(300_000)  # noqa: S311
    path.write_bytes(gzip.compress(b"1,2\n" * 2**23, 9) + gzip.compress(noise))
    sizes: list[int] = []
    with pytest.raises(LogError, match="expand to more"):
        sizes.extend(len(data) for data in pipeline.ingest.csv.unpack(path, 2**18))
    assert sum(sizes) < 2**25
