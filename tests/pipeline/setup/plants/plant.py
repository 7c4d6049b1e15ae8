"""Files of a plant, and the mapping that a person who knows the plant would make.

In a mapping, the unit None means that the log does not say it, and the place `ASK` that the log
does not say which column it is: there only a question is right.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from types import MappingProxyType
from typing import Any

ROWS = 24
START = datetime(2026, 1, 13, 6, 0)
ASK = None


@dataclass(frozen=True)
class Place:
    """A column, tag or field, with its unit and the column of its quality."""

    source: str
    unit: str | None
    quality: str = ""


# By kind of reading: channel and usual unit.
CHANNELS = {
    "dp": "pressure_difference", "high": "high_port_pressure", "low": "low_port_pressure",
    "temp": "oil_temperature", "speed": "speed", "flow": "leakage_flow",
    "charge": "charge_pressure", "case": "case_pressure",
}  # fmt: skip
UNITS = dict.fromkeys(("dp", "high", "low", "charge", "case"), "bar")
UNITS |= {"temp": "degC", "speed": "rpm", "flow": "l/min"}
AMERICAN = {"dp": "psi", "temp": "degF", "speed": "rpm", "flow": "us_gal/min"}
Mapped = Mapping[str, Place | None]
Kinds = Mapping[str, str]
"""Kind of reading by name in the log."""


@dataclass(frozen=True)
class Plant:
    """A plant's files by path, and its motors' channels; `named` is the file or folder to give."""

    name: str
    files: Mapping[str, str]
    motors: Mapping[str, Mapped]
    encoding: str = "utf-8"
    named: str = ""
    line_end: str = field(default="\n", repr=False)

    def write(self, folder: Path) -> Path:
        """Write the files; the path to give to the command."""
        for name, text in self.files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(text.replace("\n", self.line_end).encode(self.encoding))
        return folder / self.named if self.named else folder


def mapped(
    kinds: Kinds, column: str = "{}", units: Mapping[str, str] = UNITS, quality: str = ""
) -> dict[str, Place | None]:
    """Places of channels whose columns are called after their names in the log."""
    return {
        CHANNELS[kind]: Place(column.format(name), units.get(kind), quality)
        for name, kind in kinds.items()
        if kind in CHANNELS
    }


def value(kind: str, motor: int, row: int) -> float:
    """A reading of a motor at work, in bar, °C, rpm or l/min."""
    base, step = {
        "dp": (180.0, 4.0), "high": (205.0, 4.0), "low": (18.0, 0.2), "charge": (20.0, 0.2),
        "case": (1.5, 0.05), "temp": (46.0, 0.3), "speed": (31.0, 0.7), "flow": (1.25, 0.05),
        "other": (60.0, 1.1), "pump": (1480.0, 1.0),
    }[kind]  # fmt: skip
    return base + step * ((row * (3 + motor)) % 7) + 0.3 * motor


def stamp(row: int, form: str) -> str:
    return (START + timedelta(seconds=row)).strftime(form)


def table(
    header: Sequence[str],
    kinds: Sequence[tuple[str, int]],
    *,
    form: str = "%Y-%m-%dT%H:%M:%SZ",
    separator: str = ",",
    decimal: str = ".",
    quality: str = "",
    convert: Callable[[str, float], float] = lambda _, number: number,
    below: str = "",
) -> str:
    """A wide table: a column of time, and a column a kind and motor, each with its quality."""
    lines = [separator.join(header), *([below] if below else [])]
    for row in range(ROWS):
        cells = [stamp(row, form)]
        for kind, motor in kinds:
            cells.append(f"{convert(kind, value(kind, motor, row)):.3f}".replace(".", decimal))
            cells += [quality] if quality else []
        lines.append(separator.join(cells))
    return "\n".join(lines) + "\n"


def one_table(
    name: str,
    file: str,
    kinds: Kinds,
    motors: Mapping[str, int] = MappingProxyType({"": 1}),
    column: str = "{signal}",
    *,
    time: str = "time",
    units: Mapping[str, str] = UNITS,
    strangers: Collection[str] = (),
    asked: str = "",
    above: str = "",
    unread: tuple[str, str] = ("", ""),
    encoding: str = "utf-8",
    line_end: str = "\n",
    **shape: Any,
) -> Plant:
    """A plant that has one wide table, the signals of one motor after those of another.

    Motors are numbered as `value` has them; `column` is how a signal of a motor is called, those of
    `strangers` are of no channel whatever their kind, `asked` is a channel of which the log does
    not say the column, `above` stands above the table, and `unread` replaces the first of a reading
    by a word.
    """
    text = table(
        [time, *(column.format(motor=motor, signal=one) for motor in motors for one in kinds)],
        [(kind, number) for number in motors.values() for kind in kinds.values()],
        **shape,
    )
    own = {one: kind for one, kind in kinds.items() if one not in strangers}
    places = {
        motor: mapped(own, column.format(motor=motor, signal="{}"), units)
        | ({asked: ASK} if asked else {})
        for motor in motors
    }
    files = {file: above + (text.replace(*unread, 1) if unread[0] else text)}
    return Plant(name, files, places, encoding, file, line_end)


def tagged(
    header: Sequence[str],
    tags: Mapping[str, tuple[str, int]],
    row_of: Callable[[str, int, float], Sequence[str]],
    separator: str = ",",
) -> str:
    """A long table: a row a sample."""
    lines = [separator.join(header)]
    for row in range(ROWS):
        for tag, (kind, motor) in tags.items():
            lines.append(separator.join(row_of(tag, row, value(kind, motor, row))))
    return "\n".join(lines) + "\n"


def american(kind: str, number: float) -> float:
    """psi, °F, rpm and US gallons a minute."""
    if kind == "temp":
        return number * 9 / 5 + 32
    return number * {"dp": 14.5038, "flow": 0.264172}.get(kind, 1.0)
