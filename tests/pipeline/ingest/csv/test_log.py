"""Log features and faults specific to text."""

from __future__ import annotations

import gzip
import random
from pathlib import Path

import numpy as np
import pytest

import pipeline.ingest.csv_text
from pipeline.errors import LogError
from pipeline.ingest import RawChannel, RawLog, time_span
from pipeline.ingest.conformance import T0_US
from tests.pipeline.ingest.csv_files import DAY, SOURCE, error, read
from tests.pipeline.ingest.sources import column


def pressure(log: RawLog) -> RawChannel:
    return log.channels["pressure_difference"]


def test_a_last_row_without_line_end_is_left_out_and_noted(tmp_path: Path) -> None:
    # The second row was "300.5,120": cut after "30" it would read as 30 bar and no speed.
    log = read(tmp_path, f"time,dp,n\n{DAY}0Z,1,2\n{DAY}1Z,30")
    assert pressure(log).value.tolist() == [1.0]
    assert log.notes == ("1 last row without a line end (it may be cut)",)
    whole_width = read(tmp_path, f"time,dp,n\n{DAY}0Z,1,2\n{DAY}1Z,300.5,12")
    assert whole_width.rows == 1
    assert whole_width.notes == log.notes


@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
def test_every_line_end_and_blank_lines(tmp_path: Path, line_end: str) -> None:
    lines = ["", "time,dp,n", f"{DAY}0Z,1,2", "", f"{DAY}1Z,3,4", "", ""]
    log = read(tmp_path, line_end.join(lines))
    assert pressure(log).value.tolist() == [1.0, 3.0]
    assert log.notes == ()


def test_rows_of_another_width_are_left_out_and_counted(tmp_path: Path) -> None:
    rows = [f"{DAY}{i}Z,{i},{i}" for i in range(8)]
    rows[3] += ",9"
    rows[5] = rows[5].rsplit(",", 1)[0]
    log = read(tmp_path, "time,dp,n\n" + "\n".join(rows) + "\n")
    assert pressure(log).value.tolist() == [0.0, 1.0, 2.0, 4.0, 6.0, 7.0]
    assert log.notes == ("2 rows with too many or too few cells, the first in line 5 with 4",)


def test_rows_of_another_width_throughout_are_another_format(tmp_path: Path) -> None:
    wrong = error(tmp_path, "time,dp,n\n" + f"{DAY}0Z,1,2,3\n" * 9)
    assert (wrong.code, wrong.place) == ("log_not_csv", "line 2")
    assert "3 cells" in wrong.message
    assert "has 4" in wrong.message


@pytest.mark.parametrize(
    "row", [f'{DAY}0Z,"1,2', f'{DAY}0Z,1,"2'], ids=["in the middle", "in the last cell"]
)
def test_a_quotation_mark_that_swallows_rows_is_damage(tmp_path: Path, row: str) -> None:
    after = "".join(f"{DAY}{i}Z,{i},{i}\n" for i in range(1, 5))
    assert error(tmp_path, f"time,dp,n\n{row}\n{after}").code == "log_damaged"
    assert error(tmp_path, f'time,dp,n\n{row}\n{after}{DAY}9Z,1,"2\n').code == "log_damaged"


def test_a_header_may_follow_other_lines(tmp_path: Path) -> None:
    data = f"Logger 7, serial 1234\n# dp, n\ntime,dp,n\n{DAY}0Z,1,2\n"
    assert pressure(read(tmp_path, data, SOURCE.but(skip_rows=2))).value.tolist() == [1.0]
    assert error(tmp_path, data).code == "log_column_missing"
    assert error(tmp_path, data, SOURCE.but(skip_rows=9)).code == "log_empty"


def test_columns_go_by_name_whatever_their_order_and_company(tmp_path: Path) -> None:
    log = read(tmp_path, f"x, n ,x,,dp,time\na,2,b,c,1,{DAY}0Z\n")
    assert pressure(log).value.tolist() == [1.0]
    assert log.channels["speed"].value.tolist() == [2.0]


def test_a_wanted_column_that_is_there_twice_is_an_error(tmp_path: Path) -> None:
    wrong = error(tmp_path, f"time,dp,n,dp\n{DAY}0Z,1,2,3\n")
    assert wrong.code == "log_column_twice"
    assert "'dp'" in wrong.message


def test_the_wrong_separator_shows_the_columns_it_makes(tmp_path: Path) -> None:
    wrong = error(tmp_path, f"time;dp;n\n{DAY}0Z;1;2\n")
    assert wrong.code == "log_column_missing"
    assert "'time;dp;n'" in wrong.message


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_utf_16_without_its_encoding_is_told(tmp_path: Path, encoding: str) -> None:
    data = f"time,dp,n\n{DAY}0Z,1,2\n".encode(encoding)
    wrong = error(tmp_path, data)
    assert wrong.code == "log_encoding"
    assert "utf-16" in wrong.message
    assert pressure(read(tmp_path, data, SOURCE.but(encoding=encoding))).value.tolist() == [1]


def test_utf_16_cut_within_a_character_loses_the_last_row_only(tmp_path: Path) -> None:
    data = f"time,dp,n\n{DAY}0Z,1,2\n{DAY}1Z,3,4\n".encode("utf-16")[:-7]
    log = read(tmp_path, data, SOURCE.but(encoding="utf-16"))
    assert log.rows == 1
    assert log.notes == ("1 last row without a line end (it may be cut)",)


def test_latin_1_is_read_where_named_and_told_where_not(tmp_path: Path) -> None:
    channels = {"oil_temperature": column("T (°C)", "degC")}
    source = SOURCE.but(channels=channels, encoding="latin-1")
    data = f"time,T (°C),n\n{DAY}0Z,50,2\n".encode("latin-1")
    assert read(tmp_path, data, source).channels["oil_temperature"].value.tolist() == [50.0]
    wrong = error(tmp_path, data, source.but(encoding="utf-8"))
    assert wrong.code == "log_column_missing"
    assert "encoding" in wrong.message
    # Where the name of no wanted column has such a letter, nothing is lost.
    only_speed = SOURCE.but({"speed": SOURCE.channels["speed"]})
    assert read(tmp_path, data, only_speed).rows == 1


def test_bytes_that_are_no_text_cost_their_cell_or_row(tmp_path: Path) -> None:
    rows = [f"{DAY}{i}Z,{i},{i}\n".encode() for i in range(6)]
    rows[1] = rows[1].replace(b",1,", b",\xff1,")
    rows[2] = rows[2].replace(b"2Z", b"2\x93")
    rows[3] = rows[3].replace(b",3,", b"\xac3,")
    log = read(tmp_path, b"time,dp,n\n" + b"".join(rows))
    assert pressure(log).value[~pressure(log).missing].tolist() == [0.0, 4.0, 5.0]
    assert pressure(log).unparsed == 1
    assert [note[:6] for note in log.notes] == ["1 row ", "1 row "]


def test_zeros_that_a_power_cut_leaves_cost_their_row(tmp_path: Path) -> None:
    rows = "".join(f"{DAY}{i % 10}Z,{i},{i}\n" for i in range(400)).encode()
    log = read(tmp_path, b"time,dp,n\n" + rows + bytes(512) + rows[: 4 * 25 + 10])
    assert log.rows == 400 + 3
    assert len(log.notes) == 2  # The row behind the zeros, and the last one, cut.


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
    ],
)
def test_what_is_a_number(tmp_path: Path, cell: str, value: float) -> None:
    # Once in a clean column, once beside a bad cell: both ways of reading must agree.
    clean = pressure(read(tmp_path, f"time,dp,n\n{DAY}0Z,{cell},1\n"))
    beside = pressure(read(tmp_path, f"time,dp,n\n{DAY}0Z,{cell},1\n{DAY}1Z,?,1\n"))
    np.testing.assert_array_equal(clean.value, [value])
    np.testing.assert_array_equal(beside.value, [value, np.nan])
    assert clean.missing.tolist() == [False]
    assert (beside.missing.tolist(), beside.unparsed) == ([False, True], 1)


@pytest.mark.parametrize(
    "cell",
    [
        "1,5",
        "1.5.1",
        "1 5",
        "--1",
        "+-1",
        "1e",
        "e5",
        ".",
        "0x1F",
        "1_000",
        "٣",
        "½",
        "12 bar",
        "#",
    ],
)
def test_what_is_no_number(tmp_path: Path, cell: str) -> None:
    source = SOURCE.but(separator=";")
    log = read(tmp_path, f"time;dp;n\n{DAY}0Z;{cell};1\n{DAY}1Z;2;1\n", source)
    assert pressure(log).missing.tolist() == [True, False]
    assert pressure(log).unparsed == 1


def test_with_a_decimal_comma_a_dot_is_no_decimal_sign(tmp_path: Path) -> None:
    source = SOURCE.but(separator=";", decimal=",")
    rows = "".join(f"{DAY}{i}Z;{c};1\n" for i, c in enumerate(["1,5", "1.234", "1.234,5", "7"]))
    log = read(tmp_path, f"time;dp;n\n{rows}", source)
    assert pressure(log).value[~pressure(log).missing].tolist() == [1.5, 7.0]
    assert pressure(log).unparsed == 2


@pytest.mark.parametrize(
    "token", ["", " ", "null", "NULL", "NA", "N/A", " NA ", "---", "Bad", "-", "n/a", "#N/A"]
)
def test_tokens_that_mean_no_sample_are_missing_and_not_unparsed(
    tmp_path: Path, token: str
) -> None:
    for bad_cells in (0, 1):
        bad = f"{DAY}2Z,?,1\n" * bad_cells
        log = read(tmp_path, f"time,dp,n\n{DAY}0Z,{token},1\n{DAY}1Z,2,1\n{bad}")
        assert pressure(log).missing.tolist() == [True, False] + [True] * bad_cells
        assert pressure(log).unparsed == bad_cells


def test_the_tokens_can_be_chosen(tmp_path: Path) -> None:
    data = f"time,dp,n\n{DAY}0Z,-9999,1\n{DAY}1Z,NaN,1\n{DAY}2Z,2,1\n"
    log = read(tmp_path, data, SOURCE.but(missing_tokens=("", "-9999", "NaN")))
    assert pressure(log).missing.tolist() == [True, True, False]
    assert pressure(log).unparsed == 0


def test_a_blank_or_bad_time_costs_its_row(tmp_path: Path) -> None:
    times = [f"{DAY}0Z", "", f"{DAY}2Z", "yesterday", f"{DAY}4Z", "2025-02-30T00:00:00Z"]
    rows = "".join(f"{time},{i},{i}\n" for i, time in enumerate(times))
    log = read(tmp_path, f"time,dp,n\n{rows}{DAY}6Z,6,6\n")
    assert pressure(log).value.tolist() == [0.0, 2.0, 4.0, 6.0]
    assert log.notes == ("3 rows without a readable time",)


@pytest.mark.parametrize("data", [b"\n\n\n", b"   \n", b"\xef\xbb\xbf"])
def test_a_file_without_a_header_is_empty(tmp_path: Path, data: bytes) -> None:
    assert error(tmp_path, data).code in {"log_empty", "log_column_missing"}


def test_a_header_that_is_cut_is_told(tmp_path: Path) -> None:
    assert error(tmp_path, "time,dp").code == "log_truncated"
    assert error(tmp_path, b"x" * (2**20 + 1)).code == "log_not_csv"


def test_a_row_longer_than_can_be_told_apart_is_damage(tmp_path: Path) -> None:
    filler = f"{DAY}0Z,1,2\n" * 60_000
    data = f"time,dp,n\n{filler}{DAY}0Z,{'1' * (5 * 2**20)},2\n{filler}"
    assert error(tmp_path, data).code == "log_damaged"


def test_a_file_too_large_for_memory_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipeline.ingest.csv_text, "LARGEST_TEXT", 20)
    assert error(tmp_path, f"time,dp,n\n{DAY}0Z,1,2\n").code == "log_too_large"


def test_the_span_of_a_long_file_needs_its_ends_only(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = [f"{1740808800 + i},{i},{i}\n" for i in range(40_000)]
    source = SOURCE.but(time_format="epoch_s")
    span = (T0_US, T0_US + 39_999_000_000)
    path.write_text("time,dp,n\n" + "".join(rows))
    assert time_span(path, *source) == span
    # Damage in the middle is not seen, a torn last row is left out, as when the log is read.
    rows[20_000:20_010] = ["?\n"] * 10
    path.write_text("time,dp,n\n" + "".join(rows) + "1740848801,3")
    assert time_span(path, *source) == span
    # Ends that cannot be read by themselves: the whole file decides.
    rows[-5000:] = ["?,1,1\n"] * 5000
    path.write_text("time,dp,n\n" + "".join(rows))
    assert time_span(path, *source) == (T0_US, T0_US + 34_999_000_000)


@pytest.mark.parametrize(
    ("data", "code", "said"),
    [
        (b"SQLite format 3\0" + bytes(100), "log_not_csv", "SQLite"),
        (bytes(5000), "log_damaged", "zero bytes"),
        ("time,dp,n\n".encode("utf-32"), "log_encoding", "utf-32"),
        ("time,dp,n\n".encode("utf-32-le"), "log_encoding", "utf-32"),
        ("time,dp,n\n".encode("utf-16-be"), "log_encoding", "utf-16"),
    ],
)
def test_what_is_no_text_is_called_what_it_is(
    tmp_path: Path, data: bytes, code: str, said: str
) -> None:
    wrong = error(tmp_path, data)
    assert wrong.code == code
    assert said in wrong.message


def test_a_bomb_is_stopped_long_before_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By what has been unpacked of it so far: rows that are kept until then take memory."""
    monkeypatch.setattr(pipeline.ingest.csv_text, "_RATIO_FROM", 2**20)
    path = tmp_path / "log.csv.gz"
    noise = random.Random(5).randbytes(300_000)  # noqa: S311
    path.write_bytes(gzip.compress(b"1,2\n" * 2**23, 9) + gzip.compress(noise))
    sizes: list[int] = []
    with pytest.raises(LogError, match="expand to more"):
        sizes.extend(len(data) for data in pipeline.ingest.csv_text.unpacked(path, 2**18))
    assert sum(sizes) < 2**25
