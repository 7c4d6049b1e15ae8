"""Random dialects, and random logs that they can hold, for property tests."""

from __future__ import annotations

import codecs
import string
from collections.abc import Mapping
from typing import Any

import numpy as np
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType

from pipeline.config.logs import THOUSANDS
from pipeline.units import CHANNELS
from tests.dialects.columns import Parquet, counts, decimals, plain, singles
from tests.dialects.csv_text import PACKERS, Csv
from tests.dialects.dialect import Dialect
from tests.dialects.messages import Mcap
from tests.dialects.recorded import Recorded, Times
from tests.pipeline.ingest.writers import ENCODINGS

WINTER_US = 1_740_808_800_000_000
"""2025-03-01T06:00:00 UTC; no zone changes its clocks in the days that follow."""
LONGEST_US = 6 * 86_400_000_000
ZONES = ("UTC", "Europe/Stockholm", "America/St_Johns", "Asia/Kathmandu", "Etc/GMT-1")
STRPTIME = {
    "%d.%m.%Y %H:%M:%S": 1_000_000,
    "%m/%d/%y %I:%M:%S %p": 1_000_000,
    "%Y%m%dT%H%M%S%z": 1_000_000,
    "%d %b %Y %H:%M:%S,%f": 1,
    "%Y-%j %H:%M:%S.%f": 1,
    "%Y-%m-%d %H:%M": 60_000_000,
}
"""Formats, and the step of the stamps that they can write."""
EPOCHS = ("epoch_s", "epoch_ms", "epoch_us", "epoch_ns")
NAMES = st.text(string.ascii_letters + "äß °[]/()", min_size=1, max_size=12).map(
    lambda text: f"x{text}x"
)


def _steps(time_format: str) -> int:
    return 1000 if time_format == "excel_days" else STRPTIME.get(time_format, 1)


@st.composite
def _names(draw: st.DrawFn, count: int, names: st.SearchStrategy[str] = NAMES) -> list[str]:
    return draw(st.lists(names, min_size=count, max_size=count, unique=True))


@st.composite
def csv_dialects(draw: st.DrawFn) -> Dialect:
    """Any combination of what a CSV may be."""
    decimal = draw(st.sampled_from([".", ","]))
    separator = draw(st.sampled_from([c for c in ",;\t|" if c != decimal]))
    taken = (decimal, separator)
    time_format = draw(st.sampled_from(["iso8601", "excel_days", *EPOCHS, *STRPTIME]))
    *channels, time, date, name, value = draw(_names(len(CHANNELS) + 4))
    encoding = draw(
        st.sampled_from(["utf-8", "utf-8-sig", "latin-1", "cp1252", "utf-16", "utf-16-be"])
    )
    logs: dict[str, Any] = {
        "time": time,
        "time_format": time_format,
        "time_zone": draw(st.sampled_from(ZONES)),
        "layout": draw(st.sampled_from(["wide", "long", "file_per_channel"])),
        "channel_column": name,
        "value_column": value,
        "separator": separator,
        "decimal": decimal,
        "encoding": encoding,
        "skip_rows": draw(st.integers(0, 3)),
        "unit_rows": draw(st.integers(0, 2)),
    }
    # Marks that every encoding can write.
    marks = [m for m in THOUSANDS if m not in taken and m.isascii()]
    logs["thousands"] = draw(st.sampled_from(["", *marks]))
    if " " in time_format and draw(st.booleans()):
        logs["date_column"] = date
    quoted = draw(st.booleans()) or "," in time_format
    header_every = draw(st.sampled_from([0, 0, 1, 3]))
    return Csv(
        "random",
        logs,
        names=dict(zip(CHANNELS, channels, strict=True)),
        step_us=_steps(time_format),
        line_end=draw(st.sampled_from(["\n", "\r\n", "\r"])),
        bom=draw(st.sampled_from([b"", codecs.BOM_UTF8])) if encoding == "utf-8" else b"",
        quoted=quoted,
        packed=draw(st.sampled_from(list(PACKERS))),
        written_zone=draw(st.sampled_from(["", *ZONES])),
        tokens=draw(st.sampled_from([("",), ("---", "Bad", "NA"), ("", "null")])),
        header_every=header_every,
        reverse=draw(st.booleans()),
        company=draw(st.booleans()),
    )


@st.composite
def parquet_dialects(draw: st.DrawFn) -> Dialect:
    """Any combination of types and layouts of Parquet."""
    *channels, time, name, value = draw(_names(len(CHANNELS) + 3))
    layout = draw(st.sampled_from(["wide", "wide", "long", "file_per_channel"]))
    time_format = draw(st.sampled_from([None, "excel_days", *EPOCHS]))
    unit = draw(st.sampled_from(["s", "ms", "us", "ns"]))
    stamped = {"s": 1_000_000, "ms": 1000, "us": 1, "ns": 1}[unit]
    zone = draw(st.sampled_from([None, *ZONES]))
    scale = draw(st.sampled_from([1.0, 0.5, 2.0**-20]))
    numbers = draw(st.sampled_from([plain, singles, decimals(6), counts(scale)]))
    counted = numbers not in (plain, singles)
    logs = {
        "time": time,
        "time_zone": draw(st.sampled_from(ZONES)),
        "layout": layout,
        "channel_column": name,
        "value_column": value,
    } | ({} if time_format is None else {"time_format": time_format})
    within = draw(_names(draw(st.integers(0, 2)))) if layout == "wide" else []
    row_groups = draw(st.sampled_from([1, 5, 100]))
    return Parquet(
        "random",
        logs,
        names=dict(zip(CHANNELS, channels, strict=True)),
        step_us=stamped if time_format is None else _steps(time_format),
        numbers=numbers,
        scale=scale if counted and numbers.__qualname__.startswith("counts") else 1.0,
        finite=counted,
        time_unit=unit,
        zone=zone,
        within=tuple(within),
        dictionary=draw(st.booleans()),
        options={
            "row_group_size": row_groups,
            "compression": draw(st.sampled_from(["none", "snappy", "gzip", "zstd", "lz4"])),
            "use_dictionary": draw(st.booleans()),
            "data_page_version": draw(st.sampled_from(["1.0", "2.0"])),
            "write_statistics": draw(st.booleans()),
            "write_page_checksum": draw(st.booleans()),
        },
    )


@st.composite
def mcap_dialects(draw: st.DrawFn) -> Dialect:
    """Any combination of encodings and containers of MCAP."""
    options: Mapping[str, Any] = {
        "compression": draw(st.sampled_from(list(CompressionType))),
        "use_chunking": draw(st.booleans()),
        "chunk_size": draw(st.sampled_from([100, 1000, 100_000])),
        "index_types": draw(st.sampled_from([IndexType.ALL, IndexType.NONE, IndexType.CHUNK])),
        "use_statistics": draw(st.booleans()),
        "repeat_channels": draw(st.booleans()),
        "enable_crcs": draw(st.booleans()),
    }
    return Mcap(
        "random",
        {"time": draw(st.sampled_from(["log_time", "publish_time"]))},
        encoding=draw(st.sampled_from(list(ENCODINGS))),
        options=options,
    )


def logs(dialect: Dialect) -> st.SearchStrategy[Recorded]:
    """Logs that a dialect can hold: a few samples of some channels."""
    return _logs(dialect).filter(dialect.holds)


@st.composite
def _logs(draw: st.DrawFn, dialect: Dialect) -> Recorded:
    names = draw(st.lists(st.sampled_from(CHANNELS), min_size=1, max_size=4, unique=True))
    count = draw(st.integers(1, 12))
    infinite = not getattr(dialect, "finite", False)
    readings = st.floats(allow_nan=False, allow_infinity=infinite, width=32)
    if getattr(dialect, "finite", False):
        # What decimals of six places and whole numbers of the steps above hold to the last digit.
        readings = st.integers(-(2**20), 2**20).map(float)
    cells = readings | st.just(np.nan)
    if getattr(dialect, "encoding", "json") != "json":
        cells = readings
    values = {
        name: np.array(draw(st.lists(cells, min_size=count, max_size=count))) for name in names
    }
    own: dict[str, Times] = {}
    if draw(st.booleans()):
        own = {name: draw(_times(count, dialect.step_us)) for name in names}
        for value in values.values():
            value[:1] = np.where(np.isnan(value[:1]), 0.0, value[:1])
    return Recorded(draw(_times(count, dialect.step_us)), values, own)


@st.composite
def _times(draw: st.DrawFn, count: int, step_us: int) -> Times:
    """In the order of a log, which here and there goes back."""
    steps = st.integers(0, LONGEST_US // step_us)
    return WINTER_US + step_us * np.array(draw(st.lists(steps, min_size=count, max_size=count)))
