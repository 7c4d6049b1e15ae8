"""Text logs in any dialect, for tests of suggestions.

The forms are written out here from their definitions and know nothing of the readers.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

# Units per bar, per l/min and so on, from their definitions (SI; NIST SP 811, appendix B).
PER_CANONICAL = {
    "bar": 1.0, "kPa": 100.0, "MPa": 0.1, "mbar": 1000.0,
    "psi": 1e5 / (4.4482216152605 / 0.0254**2), "rpm": 1.0, "1/s": 1 / 60,
    "l/min": 1.0, "m3/h": 0.06, "ml/min": 1000.0, "us_gal/min": 1 / 3.785411784,
}  # fmt: skip
EXCEL_ZERO = datetime(1899, 12, 30, tzinfo=UTC)
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

Samples = Mapping[str, Sequence[float | None]]
"""Values by channel, in the units of the tables; None: no value."""


@dataclass(frozen=True)
class Label:
    """Name of a channel in a log, its unit, and the spelling of the unit there."""

    name: str
    unit: str
    spelled: str


@dataclass(frozen=True)
class TextLog:
    """Form of a text log."""

    labels: Mapping[str, Label]
    layout: str = "wide"
    separator: str = ","
    decimal: str = "."
    thousands: str = ""
    encoding: str = "utf-8"
    line_end: str = "\n"
    preamble: Sequence[str] = ()
    # A form of `datetime.strftime`, or "epoch_s" and the like, "epoch_s.f" with a fraction, or
    # "excel_days".
    time: str = "%Y-%m-%dT%H:%M:%S"
    # Form of the time of day, where it has a column of its own; `time` is then the date's.
    clock: str = ""
    time_name: str = "time"
    clock_name: str = "Uhrzeit"
    # Place of the units: "name" ("p [bar]"), "word" ("p_bar"), "row" (a line below the header) or
    # "nowhere".
    units: str = "name"
    # Order of the columns, time included; "extra" is one that is no channel.
    columns: Sequence[str] = ()
    missing: str = ""
    quoted: bool = False
    digits: int = 4
    names: Mapping[str, str] = field(default_factory=dict)

    def label(self, channel: str) -> str:
        """Name of a channel's column, or of the channel in the rows."""
        one = self.labels[channel]
        in_name = {"name": f"{one.name} [{one.spelled}]", "word": f"{one.name}_{one.spelled}"}
        return in_name.get(self.units, one.name)

    def number(self, channel: str, value: float | None) -> str:
        """A value of a channel as it is written."""
        if value is None:
            return self.missing
        marks = str.maketrans({".": self.decimal, ",": self.thousands})
        written = in_unit(value, self.labels[channel].unit)
        grouped = "," if self.thousands else ""
        return f"{written:{grouped}.{self.digits}f}".translate(marks)

    def stamps(self, moment: datetime) -> list[str]:
        if self.clock:
            return [moment.strftime(self.time), moment.strftime(self.clock)]
        since = moment - EPOCH
        if self.time == "excel_days":
            days = (moment - EXCEL_ZERO) / timedelta(days=1)
            return [f"{days:.9f}".replace(".", self.decimal)]
        if self.time == "epoch_s.f":
            return [f"{since.total_seconds():.3f}".replace(".", self.decimal)]
        if self.time.startswith("epoch"):
            per = {"s": 1_000_000, "ms": 1_000, "us": 1}.get(self.time.removeprefix("epoch_"))
            us = since // timedelta(microseconds=1)
            return [str(us // per if per else us * 1000)]
        text = moment.strftime(self.time)
        # strftime knows no milliseconds: "%f" behind a mark is cut to three digits.
        if "%f" in self.time and text[-6:].isdigit():
            return [text[:-3]]
        return [text]

    def times(self) -> list[str]:
        return [self.time_name, self.clock_name] if self.clock else [self.time_name]

    def table(self, rows: Sequence[Sequence[str]], units: Sequence[str]) -> bytes:
        """Header, units and rows as the file has them."""
        buffer = io.StringIO(newline="")
        quoting = csv.QUOTE_ALL if self.quoted else csv.QUOTE_MINIMAL
        writer = csv.writer(
            buffer, delimiter=self.separator, lineterminator=self.line_end, quoting=quoting
        )
        writer.writerow(rows[0])
        if self.units == "row":
            writer.writerow(units)
        writer.writerows(rows[1:])
        head = "".join(line + self.line_end for line in self.preamble)
        return (head + buffer.getvalue()).encode(self.encoding)


def in_unit(value: float, unit: str) -> float:
    """A value of the tables in a unit of a log."""
    if unit == "degF":
        return value * 9 / 5 + 32
    return value + 273.15 if unit == "K" else value * PER_CANONICAL.get(unit, 1.0)


def wide(dialect: TextLog, times: Sequence[datetime], samples: Samples) -> bytes:
    """A column a channel, and one that is none."""
    order = dialect.columns or ("time", *samples)
    head: list[str] = []
    units: list[str] = []
    for name in order:
        head += dialect.times() if name == "time" else [_name(dialect, name)]
        spelled = dialect.labels[name].spelled if name in dialect.labels else ""
        units += [""] * len(dialect.times()) if name == "time" else [spelled]
    rows = [head]
    for i, moment in enumerate(times):
        cells: list[str] = []
        for name in order:
            if name == "time":
                cells += dialect.stamps(moment)
            else:
                known = name in samples
                cells.append(dialect.number(name, samples[name][i]) if known else f"shift {i % 3}")
        rows.append(cells)
    return dialect.table(rows, units)


def _name(dialect: TextLog, column: str) -> str:
    return dialect.label(column) if column in dialect.labels else "operator"


def long(dialect: TextLog, times: Sequence[datetime], samples: Samples, *, grouped: bool) -> bytes:
    """A row a sample; `grouped`: all of a channel before the next."""
    rows = [
        [*dialect.stamps(moment), dialect.label(name), dialect.number(name, samples[name][i])]
        for name in samples
        for i, moment in enumerate(times)
    ]
    if not grouped:
        rows = [rows[k * len(times) + i] for i in range(len(times)) for k in range(len(samples))]
    names = dialect.names
    head = [*dialect.times(), names.get("channel", "channel"), names.get("value", "value")]
    return dialect.table([head, *rows], [""] * len(head))


def of_one_channel(
    dialect: TextLog, times: Sequence[datetime], samples: Samples, channel: str
) -> bytes:
    rows = [
        [*dialect.stamps(moment), dialect.number(channel, value)]
        for moment, value in zip(times, samples[channel], strict=True)
    ]
    head = [*dialect.times(), dialect.names.get("value", "value")]
    units = [*[""] * len(dialect.times()), dialect.labels[channel].spelled]
    return dialect.table([head, *rows], units)
