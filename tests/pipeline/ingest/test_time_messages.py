"""Messages on unreadable time stamps: the cell, and how a stamp would be written."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import pyarrow as pa
import pytest

from pipeline.config.time_formats import EPOCH_UNITS
from pipeline.errors import LogError
from pipeline.ingest import read_log
from pipeline.ingest.time_stamps import example_of, placed, written

from .sources import Source, column

# With and without a zone, so that each cell is parsed by itself.
YEAR_0 = ["0001-01-01T00:00:00+14:00", "0001-01-01T00:00:00"]
SPEED = {"speed": column("n", "rpm")}


def told(path: Path, source: Source) -> str:
    with pytest.raises(LogError) as raised:
        read_log(path, *source)
    assert raised.value.code == "log_time"
    return raised.value.message


def log(folder: Path, *stamps: str) -> Path:
    path = folder / "log.csv"
    path.write_text("time;n\n" + "".join(f"{stamp};1\n" for stamp in stamps))
    return path


@pytest.mark.parametrize(
    ("stamps", "time_format", "cell", "written"),
    [
        (["", "6 am", "7 am"], "iso8601", "6 am", "2025-03-01T06:00:00Z"),
        (["2025-03-01 06:00:00"] * 2, "%d.%m.%Y %H:%M", "2025-03-01 06:00:00", "01.03.2025 06:00"),
        (
            ["13/25/2025 06:00 PM"],
            "%m/%d/%Y %I:%M %p",
            "13/25/2025 06:00 PM",
            "03/01/2025 06:00 AM",
        ),
        (["12.5", "13.5"], "epoch_s", "12.5", "1740808800"),
        (["1740808800"], "epoch_ns", "1740808800", "1740808800000000000"),
        (["x"], "excel_days", "x", "45717.25"),
        (["1970-01-01T00:00:07Z"], "iso8601", "1970-01-01 00:00:07", "2025-03-01T06:00:00Z"),
        (YEAR_0, "iso8601", "0000-12-31 10:00:00", "2025-03-01T06:00:00Z"),
        (["9" * 400], "epoch_s", "9" * 40, "1740808800"),
    ],
)
def test_a_cell_that_is_no_time_is_shown_beside_one_that_would_be(
    tmp_path: Path, stamps: list[str], time_format: str, cell: str, written: str
) -> None:
    source = Source.of("csv", SPEED, separator=";", time_format=time_format)
    message = told(log(tmp_path, *stamps), source)
    assert f"'time' in format {time_format} (such as {written}; here is {cell!r})" in message


@pytest.mark.parametrize("cell", ["9" * 400, "1" + "0" * 305, "-1e305", "1e400", "1e-400"])
@pytest.mark.parametrize("time_format", [*EPOCH_UNITS, "excel_days"])
def test_a_number_beyond_any_time_is_counted(tmp_path: Path, time_format: str, cell: str) -> None:
    good = example_of(time_format)
    source = Source.of("csv", SPEED, separator=";", time_format=time_format)
    found = read_log(log(tmp_path, good, cell, good), *source)
    assert found.notes == ("1 row without a readable time",)
    assert found.channels["speed"].time_us.tolist() == [1740808800_000000] * 2


@pytest.mark.parametrize(
    "time_format",
    ["iso8601", *EPOCH_UNITS, "excel_days", "%d.%m.%Y %H:%M:%S,%f", "%Y-%j %H:%M %z"],
)
def test_the_example_is_read_in_its_format(time_format: str) -> None:
    cells = pa.chunked_array([[example_of(time_format)]])
    stamps = placed(written([cells], time_format), "UTC")
    assert stamps.readable.all()
    assert stamps.time_us[0] == datetime.fromisoformat("2025-03-01T06:00Z").timestamp() * 1e6
