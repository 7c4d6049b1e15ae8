"""Files of plants, and the mapping that a person who knows the plant would make.

In a mapping, the unit None means that the log does not say it.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from pathlib import Path

from pipeline.units import QUANTITIES, from_canonical
from pipeline.units import UNITS as KNOWN_UNITS

ROWS = 24
START = datetime(2026, 1, 13, 6, 0)


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
Mapped = Mapping[str, Place]
Kinds = Mapping[str, str]
"""Kind of reading by name in the log."""


@dataclass(frozen=True)
class Plant:
    """A plant's files by path, and its motors' channels; `named` is the file or folder to give."""

    name: str
    files: Mapping[str, str]
    motors: Mapping[str, Mapped]
    named: str = ""
    line_end: str = field(default="\n", repr=False)

    def write(self, folder: Path) -> Path:
        """Write the files; the path to give to the command."""
        for name, text in self.files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(text.replace("\n", self.line_end).encode())
        return folder / self.named if self.named else folder


def mapped(
    kinds: Kinds, column: str = "{}", units: Mapping[str, str] = UNITS, quality: str = ""
) -> dict[str, Place]:
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
    quality: str = "",
) -> str:
    """A wide table: a column of time, and a column a kind and motor, each with its quality."""
    lines = [",".join(header)]
    for row in range(ROWS):
        cells = [stamp(row, form)]
        for kind, motor in kinds:
            cells += [f"{value(kind, motor, row):.3f}", *([quality] if quality else [])]
        lines.append(",".join(cells))
    return "\n".join(lines) + "\n"


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


# Control systems


def _pi_long() -> Plant:
    kinds = {"PDIFF": "dp", "TOIL": "temp", "NMOT": "speed", "QLEAK": "flow"}
    tags = {f"W{motor}_{tag}": (kind, motor) for motor in (1, 2) for tag, kind in kinds.items()}
    text = tagged(
        ["tag", "time", "value", "units", "status"],
        tags,
        lambda tag, row, number: (
            *(tag, stamp(row, "%Y-%m-%dT%H:%M:%SZ"), f"{number:.3f}", UNITS[tags[tag][0]], "Good"),
        ),
    )
    return Plant(
        "PI, compressed, a row a sample, two motors",
        {"pi/archive.csv": text},
        {f"W{n}": mapped(kinds, f"W{n}_{{}}", quality="status") for n in (1, 2)},
        named="pi/archive.csv",
    )


def _ignition_dataset() -> Plant:
    kinds = {"dP_bar": "dp", "OilTemp_C": "temp", "Speed_rpm": "speed", "Leak_lpm": "flow"}
    rows = [
        [stamp(row, "%Y-%m-%d %H:%M:%S"), *(f"{value(one, 1, row):.3f}" for one in kinds.values())]
        for row in range(ROWS)
    ]
    rows = [["t_stamp", *(f"Conveyor/{name}" for name in kinds)], *rows]
    names, *lines = [",".join(f'"{cell}"' for cell in row) for row in rows]
    text = f'"#NAMES"\n{names}\n"#TYPES"\n"date","F","F","F","F"\n"#ROWS","{ROWS}"\n'
    return Plant(
        "Ignition, a dataset with #NAMES and #TYPES",
        {"dataset.csv": text + "\n".join(lines) + "\n"},
        {"Conveyor": mapped(kinds, "Conveyor/{}")},
        named="dataset.csv",
    )


def _wincc_archive() -> Plant:
    """Rows of tags, which do not say the units; the panel's own tag for its stop ends them."""
    kinds = {"Druck_A": "high", "Druck_B": "low", "Oeltemperatur": "temp", "Drehzahl": "speed"}
    kinds |= {"Leckoelmenge": "flow"}
    motor, file = "HYD_M1", "Archiv.csv"
    end = f'"$RT_OFF$";"{stamp(ROWS, "%d.%m.%Y %H:%M:%S")}";0;2;46035250300,0000\n'
    text = tagged(
        ['"VarName"', '"TimeString"', '"VarValue"', '"Validity"', '"Time_ms"'],
        {f"{motor}_{tag}": (kind, 1) for tag, kind in kinds.items()},
        lambda tag, row, number: (
            f'"{tag}"',
            f'"{stamp(row, "%d.%m.%Y %H:%M:%S")}"',
            f"{number:.3f}".replace(".", ","),
            "1",
            f"{46035250000 + row * 11.574:.4f}".replace(".", ","),
        ),
        ";",
    )
    places = {motor: mapped(kinds, f"{motor}_{{}}", {})}
    name = "WinCC, archive export, German"
    return Plant(name, {file: text + end}, places, named=file, line_end="\r\n")


def _quality() -> Plant:
    kinds = {"PressureA": "high", "PressureB": "low", "OilTemp": "temp", "Speed": "speed"}
    kinds |= {"DrainFlow": "flow"}
    text = table(
        ["Time", *(column for name in kinds for column in (f"Drum.{name}", f"Drum.{name}.Q"))],
        [(kind, 1) for kind in kinds.values()],
        form="%Y-%m-%d %H:%M:%S.000",
        quality="192",
    )
    places = {
        channel: replace(place, quality=f"{place.source}.Q")
        for channel, place in mapped(kinds, "Drum.{}", {}).items()
    }
    name = "OPC DA, a column of quality beside each value"
    return Plant(name, {"da.csv": text}, {"Drum": places}, named="da.csv")


# InfluxDB


def _influx_dutch() -> Plant:
    """InfluxDB, annotated, with the query's range, two tags, and fields in Dutch."""
    kinds = {"drukverschil_bar": "dp", "olietemperatuur_C": "temp", "toerental_rpm": "speed"}
    kinds |= {"lekdebiet_lpm": "flow"}
    head = (
        "#group,false,false,true,true,false,false,true,true,true,true\n"
        "#datatype,string,long,dateTime:RFC3339,dateTime:RFC3339,dateTime:RFC3339,double,"
        "string,string,string,string\n"
        "#default,_result,,,,,,,,,\n"
        ",result,table,_start,_stop,_time,_value,_field,_measurement,asset,site\n"
    )
    span = "2026-01-12T23:00:00Z,2026-01-13T23:00:00Z"
    lines = [
        f",,{number},{span},{stamp(row, '%Y-%m-%dT%H:%M:%SZ')},{value(kind, n, row):.3f},"
        f"{name},hydrauliek,lier-{n},zuid"
        for n in (1, 2)
        for number, (name, kind) in enumerate(kinds.items())
        for row in range(ROWS)
    ]
    return Plant(
        "InfluxDB, annotated CSV with a range and two tags, Dutch",
        {"export.csv": head + "\n".join(lines) + "\n"},
        {f"lier-{n}": mapped(kinds) for n in (1, 2)},
        named="export.csv",
    )


PLANTS = (
    _pi_long(),
    _ignition_dataset(),
    _wincc_archive(),
    _quality(),
    _influx_dutch(),
)


# Styles of header, of one wide table each

FILE = Path(__file__).with_name("header_styles.toml")
STYLES = tomllib.loads(FILE.read_text("utf-8"))["style"]


def columns(style: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Kind and unit by name of a column, of lines such as ``Drehzahl [1/min] = speed rpm``."""
    pairs = (line.rsplit(" = ", 1) for line in style["columns"].splitlines())
    return {name: (*meant.split(" "), "")[:2] for name, meant in pairs}


def written(style: Mapping[str, str], folder: Path) -> Path:
    """A log of a motor at work, with a style's header."""
    separator, own = style.get("separator", ","), columns(style)
    lines = [separator.join([style["time"], *own]), *filter(None, [style.get("units")])]
    for row in range(ROWS):
        cells = [stamp(row, style["form"])]
        for at, (kind, unit) in enumerate(own.values()):
            made = {"?": "low" if at else "high", "x": "other"}.get(kind, kind)
            number, channel = value(made, 1, row), CHANNELS.get(made, "speed")
            if unit in KNOWN_UNITS[QUANTITIES[channel]]:
                number = float(from_canonical(channel, number, unit))
            cells.append(f"{number:.3f}".replace(".", style.get("decimal", ".")))
        lines.append(separator.join(cells))
    path = folder / "log.csv"
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return path
