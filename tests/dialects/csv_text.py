"""CSV in the dialects of many makes, a cell at a time."""

from __future__ import annotations

import gzip
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import cycle
from pathlib import Path
from typing import ClassVar
from zoneinfo import ZoneInfo

import zstandard

from pipeline.ingest.conformance import Cell
from tests.dialects.dialect import EPOCH, MICROSECOND, Table
from tests.dialects.recorded import Times, Values

PACKERS: dict[str, Callable[[bytes], bytes]] = {
    "": bytes,
    ".gz": lambda data: gzip.compress(data, 1, mtime=0),
    ".zst": zstandard.ZstdCompressor(write_checksum=True).compress,
}
MICROSECONDS = {"epoch_s": 1_000_000, "epoch_ms": 1_000, "epoch_us": 1}
Row = Sequence[str]


@dataclass(frozen=True)
class Csv(Table):
    """Delimited text."""

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

    format: ClassVar[str] = "csv"

    @property
    def suffix(self) -> str:
        return f".csv{self.packed}"

    def table(self, path: Path, time_us: Times, columns: Mapping[str, Sequence[Cell]]) -> None:
        self.file(path, time_us, {name: self._texts(cells) for name, cells in columns.items()})

    def cells(self, values: Values) -> list[str]:
        return self._texts(None if math.isnan(value) else value for value in values.tolist())

    def _texts(self, cells: Iterable[Cell]) -> list[str]:
        tokens = cycle(self.tokens)
        return [next(tokens) if cell is None else self._text(cell) for cell in cells]

    def _text(self, value: float | str) -> str:
        if isinstance(value, str) or not math.isfinite(value):
            return str(value)
        text = repr(value)
        if self.logs.get("thousands"):
            text = f"{Decimal(text):,f}"
        marks = {".": self.key("decimal", "."), ",": self.key("thousands", "")}
        return text.translate(str.maketrans(marks))

    def _time_columns(self, time_us: Times) -> dict[str, list[str]]:
        stamps = [self._stamp(time) for time in time_us.tolist()]
        if "date_column" not in self.logs:
            return {self.key("time", "time"): stamps}
        pairs = [stamp.split(" ", 1) for stamp in stamps]
        return {
            self.logs["date_column"]: [date for date, _ in pairs],
            self.key("time", "time"): [clock for _, clock in pairs],
        }

    def _stamp(self, time_us: int) -> str:
        form = self.key("time_format", "iso8601")
        if form == "epoch_ns":
            return str(time_us * 1000)
        if form in MICROSECONDS:
            whole, rest = divmod(time_us, MICROSECONDS[form])
            exact = Decimal(whole) + Decimal(rest) / MICROSECONDS[form]
            return str(exact).replace(".", self.key("decimal", "."))
        if form == "excel_days":
            return repr(self.excel_days(time_us)).replace(".", self.key("decimal", "."))
        if form != "iso8601":
            return self.wall_clock(time_us).strftime(form)
        if self.written_zone:
            zone = ZoneInfo(self.written_zone)
            return (EPOCH + time_us * MICROSECOND).astimezone(zone).isoformat()
        return self.wall_clock(time_us).replace(tzinfo=None).isoformat()

    def file(self, path: Path, time_us: Times, columns: Mapping[str, Sequence[str]]) -> Path:
        columns = {**self._time_columns(time_us), **columns}
        if self.company:
            remark = "left, then right" if self.quoted else "all well"
            others = ("serial number", ["7"] * time_us.size), ("remark", [remark] * time_us.size)
            columns = dict([others[0], *columns.items(), others[1]])
        head = list(columns)
        rows: list[Row] = list(zip(*columns.values(), strict=True))
        order = list(range(len(head)))
        if self.reverse:
            order.reverse()
        every = self.header_every or max(len(rows), 1)
        lines = ["Logger 7: serial 12"] * int(self.logs.get("skip_rows", 0))
        for begin in range(0, max(len(rows), 1), every):
            units = [["unit"] * len(head)] * int(self.logs.get("unit_rows", 0))
            lines += [
                self._line(row, order) for row in [head, *units, *rows[begin : begin + every]]
            ]
        text = self.line_end.join([*lines, ""]).encode(self.key("encoding", "utf-8"))
        path.write_bytes(PACKERS[self.packed](self.bom + text))
        return path

    def _line(self, row: Row, order: list[int]) -> str:
        mark = '"' if self.quoted else ""
        cells = [f"{mark}{row[place]}{mark}" for place in order]
        return self.key("separator", ",").join(cells)
