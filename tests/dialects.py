"""Tables as loggers of many makes write them: the same content in any dialect of text.

The writers know the formats from their specifications and from the formats' own libraries, and
nothing of the readers.
"""

from __future__ import annotations

import datetime as dt
import gzip
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from itertools import cycle
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import zstandard
from numpy.typing import NDArray

from pipeline.config.channels import Channel, ChannelName
from pipeline.ingest.conformance import Cell
from pipeline.units import QUANTITIES, canonical_unit, from_canonical
from tests.pipeline.ingest.sources import Source

Times = NDArray[np.int64]
Values = NDArray[np.float64]
EPOCH = dt.datetime(1970, 1, 1, tzinfo=dt.UTC)
MICROSECOND = dt.timedelta(microseconds=1)
EXCEL_ZERO = dt.datetime(1899, 12, 30)
PACKERS: dict[str, Callable[[bytes], bytes]] = {
    "": bytes,
    ".gz": lambda data: gzip.compress(data, 1, mtime=0),
    ".zst": zstandard.ZstdCompressor(write_checksum=True).compress,
}
PER_UNIT_US = {"s": 1_000_000, "ms": 1_000, "us": 1}


@dataclass(frozen=True, slots=True)
class Recorded:
    """Readings of a motor's channels in the order in which they were logged."""

    time_us: Times  # stamp of each row, UTC, shape (n,)
    # By channel, in its canonical unit, shape (n,) each; nan where there is no reading.
    values: Mapping[str, Values]


@dataclass(frozen=True)
class Csv:
    """A way to write logs as delimited text, a cell at a time."""

    # Keys of the config's `logs` section that state it.
    logs: Mapping[str, Any] = field(default_factory=dict)
    # By quantity ("pressure"), where they are not the canonical ones.
    units: Mapping[str, str] = field(default_factory=dict)
    # By channel, what it is called in the log, where that is not its canonical name.
    names: Mapping[str, str] = field(default_factory=dict)
    # line_end, bom, quoted, packed: of the text; `packed` is the suffix of the packer.
    line_end: str = "\n"
    bom: bytes = b""
    quoted: bool = False
    packed: str = ""
    # ISO 8601: the zone whose offset each stamp carries; empty: it carries none.
    written_zone: str = ""
    tokens: tuple[str, ...] = ("",)  # what stands for no reading, in turn
    # Rows after which the header comes again, with its rows of units; 0: never.
    header_every: int = 0
    reverse: bool = False  # the columns stand the other way round
    company: bool = False  # there are columns of others, too

    def key(self, key: str, fallback: str) -> str:
        """A key of the config's `logs` section."""
        return str(self.logs.get(key, fallback))

    def unit(self, channel: str) -> str:
        """Unit that a channel is written in."""
        return self.units.get(QUANTITIES[channel], canonical_unit(channel))

    def source(self, channel: str) -> dict[str, Any]:
        """Keys of a channel's section in the config."""
        of_file = self.key("layout", "wide") == "file_per_channel"
        name = f"*+{channel}.*" if of_file else self.names.get(channel, channel)
        return {"source": name, "unit": self.unit(channel)}

    def source_of(self, channels: Iterable[ChannelName]) -> Source:
        """Arguments of a reader."""
        wanted = {name: Channel(**self.source(name)) for name in channels}
        return Source.of("csv", wanted, **self.logs)

    def write(self, folder: Path, stem: str, log: Recorded) -> list[Path]:
        """Write a log as one file or several whose names begin with `stem`; returns them."""
        layout, value = self.key("layout", "wide"), self.key("value_column", "value")
        written = {
            self.names.get(name, name): from_canonical(name, own, self.unit(name))
            if self.unit(name) != canonical_unit(name)
            else own
            for name, own in log.values.items()
        }
        if layout == "file_per_channel":
            paths = [folder / f"{stem}+{name}.csv{self.packed}" for name in log.values]
            columns = [{value: self.cells(own)} for own in written.values()]
            return [
                self.file(path, log.time_us, column)
                for path, column in zip(paths, columns, strict=True)
            ]
        path = folder / f"{stem}.csv{self.packed}"
        if layout == "wide":
            wide = {name: self.cells(own) for name, own in written.items()}
            return [self.file(path, log.time_us, wide)]
        readings = self.cells(np.column_stack(list(written.values())).ravel())
        names = list(written) * log.time_us.size
        long = {self.key("channel_column", "channel"): names, value: readings}
        return [self.file(path, np.repeat(log.time_us, len(written)), long)]

    def wall_clock(self, time_us: int) -> dt.datetime:
        """A stamp on the wall clock of the logger's zone."""
        zone = ZoneInfo(self.key("time_zone", "UTC"))
        return (EPOCH + time_us * MICROSECOND).astimezone(zone)

    def excel_days(self, time_us: int) -> float:
        """A stamp as days of a spreadsheet."""
        return (self.wall_clock(time_us).replace(tzinfo=None) - EXCEL_ZERO) / dt.timedelta(days=1)

    def table(self, path: Path, time_us: Times, columns: Mapping[str, Sequence[Cell]]) -> None:
        """Write cells as they are."""
        self.file(path, time_us, {name: self._texts(cells) for name, cells in columns.items()})

    def cells(self, values: Values) -> list[str]:
        return self._texts(None if math.isnan(value) else value for value in values.tolist())

    def _texts(self, cells: Iterable[Cell]) -> list[str]:
        tokens = cycle(self.tokens)
        return [next(tokens) if cell is None else self._text(cell) for cell in cells]

    def _text(self, value: float | str) -> str:
        if isinstance(value, str) or not math.isfinite(value):
            return str(value)
        text = f"{Decimal(repr(value)):,f}" if self.logs.get("thousands") else repr(value)
        marks = {".": self.key("decimal", "."), ",": self.key("thousands", "")}
        return text.translate(str.maketrans(marks))

    def _time_columns(self, time_us: Times) -> dict[str, list[str]]:
        stamps, time = [self._stamp(each) for each in time_us.tolist()], self.key("time", "time")
        if "date_column" not in self.logs:
            return {time: stamps}
        pairs = [stamp.split(" ", 1) for stamp in stamps]
        dates, clocks = ([pair[part] for pair in pairs] for part in (0, 1))
        return {self.logs["date_column"]: dates, time: clocks}

    def _stamp(self, time_us: int) -> str:
        form = self.key("time_format", "iso8601")
        if form == "epoch_ns":
            return str(time_us * 1000)
        if form.startswith("epoch_"):
            per_unit = PER_UNIT_US[form.removeprefix("epoch_")]
            exact = Decimal(time_us // per_unit) + Decimal(time_us % per_unit) / per_unit
            return str(exact).replace(".", self.key("decimal", "."))
        if form == "excel_days":
            return repr(self.excel_days(time_us)).replace(".", self.key("decimal", "."))
        wall = self.wall_clock(time_us)
        if form != "iso8601":
            return wall.strftime(form)
        if self.written_zone:
            return wall.astimezone(ZoneInfo(self.written_zone)).isoformat()
        return wall.replace(tzinfo=None).isoformat()

    def file(self, path: Path, time_us: Times, columns: Mapping[str, Sequence[str]]) -> Path:
        columns = {**self._time_columns(time_us), **columns}
        if self.company:
            remark = "left, then right" if self.quoted else "all well"
            serial, remarks = ["7"] * time_us.size, [remark] * time_us.size
            columns = {"serial number": serial, **columns, "remark": remarks}
        if self.reverse:
            columns = dict(reversed(columns.items()))
        rows = list(zip(*columns.values(), strict=True))
        every = self.header_every or max(len(rows), 1)
        lines = ["Logger 7: serial 12"] * int(self.logs.get("skip_rows", 0))
        mark = '"' if self.quoted else ""
        for begin in range(0, max(len(rows), 1), every):
            units = [["unit"] * len(columns)] * int(self.logs.get("unit_rows", 0))
            for row in [list(columns), *units, *rows[begin : begin + every]]:
                lines.append(self.key("separator", ",").join(f"{mark}{cell}{mark}" for cell in row))
        text = self.line_end.join([*lines, ""]).encode(self.key("encoding", "utf-8"))
        path.write_bytes(PACKERS[self.packed](self.bom + text))
        return path


def write_parquet(
    path: Path, time_us: Times, columns: Mapping[str, Sequence[Cell]], **options: Any
) -> None:
    """Write a table of numbers."""
    cells = {name: pa.array(list(own), pa.float64()) for name, own in columns.items()}
    times = pa.array(time_us, pa.timestamp("us", "UTC"))
    pq.write_table(pa.table({"time": times, **cells}), path, **options)
