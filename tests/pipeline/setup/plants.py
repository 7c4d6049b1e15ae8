"""Files of plants, and the mapping that a person who knows the plant would make.

In a mapping, the unit None means that the log does not say it.
"""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

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
Plant = tuple[str, dict[str, dict[str, Place]]]
"""Text of a log, and its motors' channels."""


def mapped(
    kinds: Mapping[str, str], place: str = "{}", units: Mapping[str, str] = UNITS, quality: str = ""
) -> dict[str, Place]:
    """Places of channels by their names in the log, of which `kinds` has the kinds of reading."""
    return {
        CHANNELS[kind]: Place(place.format(name), units.get(kind), quality.format(name))
        for name, kind in kinds.items()
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


def rows(kinds: Mapping[str, str], form: str, end: str = "") -> list[list[str]]:
    """Stamp and readings of a motor, row by row; `end` stands behind each reading."""
    return [
        [stamp(row, form), *(f"{value(kind, 1, row):.3f}{end}" for kind in kinds.values())]
        for row in range(ROWS)
    ]


def _ignition_dataset() -> Plant:
    kinds = {"dP_bar": "dp", "OilTemp_C": "temp", "Speed_rpm": "speed", "Leak_lpm": "flow"}
    header = ["t_stamp", *(f"Conveyor/{name}" for name in kinds)]
    names, *lines = [
        ",".join(f'"{cell}"' for cell in row) for row in [header, *rows(kinds, "%Y-%m-%d %H:%M:%S")]
    ]
    marks = ('"#NAMES"', names, '"#TYPES"', '"date","F","F","F","F"', f'"#ROWS","{ROWS}"')
    return "\n".join([*marks, *lines, ""]), {"Conveyor": mapped(kinds, "Conveyor/{}")}


def _wincc_archive() -> Plant:
    """Rows of two motors' tags, which do not say the units; the panel's stop ends them."""
    kinds = {"Druck_A": "high", "Druck_B": "low", "Oeltemperatur": "temp", "Drehzahl": "speed"}
    kinds |= {"Leckoelmenge": "flow"}
    form = "%d.%m.%Y %H:%M:%S"
    lines = ['"VarName";"TimeString";"VarValue";"Validity";"Time_ms"']
    lines += [
        f'"HYD_M{n}_{tag}";"{stamp(row, form)}";'
        + f"{value(kind, n, row):.3f};1;{46035250000 + row * 11.574:.4f}".replace(".", ",")
        for row in range(ROWS)
        for n in (1, 2)
        for tag, kind in kinds.items()
    ]
    lines += [f'"$RT_OFF$";"{stamp(ROWS, form)}";0;2;46035250300,0000', ""]
    motors = {f"HYD_M{n}": mapped(kinds, f"HYD_M{n}_{{}}", {}, "Validity") for n in (1, 2)}
    return "\r\n".join(lines), motors


def _quality() -> Plant:
    kinds = {"PressureA": "high", "PressureB": "low", "OilTemp": "temp", "Speed": "speed"}
    kinds |= {"DrainFlow": "flow"}
    header = ["Time", *(f"Drum.{name},Drum.{name}.Q" for name in kinds)]
    lines = map(",".join, [header, *rows(kinds, "%Y-%m-%d %H:%M:%S.000", ",192")])
    return "\n".join([*lines, ""]), {"Drum": mapped(kinds, "Drum.{}", {}, "Drum.{}.Q")}


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
    return head + "\n".join([*lines, ""]), {f"lier-{n}": mapped(kinds) for n in (1, 2)}


PLANTS = {
    "Ignition, a dataset with #NAMES and #TYPES": _ignition_dataset(),
    "WinCC, archive export, German": _wincc_archive(),
    "OPC DA, a column of quality beside each value": _quality(),
    "InfluxDB, annotated CSV with a range and two tags, Dutch": _influx_dutch(),
}


# Styles of header, of one wide table each

FILE = Path(__file__).with_name("header_styles.toml")
STYLES = tomllib.loads(FILE.read_text("utf-8"))


def columns(style: Mapping[str, Any]) -> dict[str, tuple[str, str]]:
    """Kind and unit by name of a column, those of a motor together."""
    return {
        name.replace("{}", motor): (*meant.split(" "), "")[:2]
        for motor in style.get("motors", [""])
        for name, meant in style.items()
        if name not in ("time", "motors", "units")
    }


def written(style: Mapping[str, Any], folder: Path) -> Path:
    """A log of a motor at work, with a style's header."""
    own = columns(style)
    lines = [[style["time"], *own]]
    if "units" in style:
        lines.append(["", *style["units"] * len(style.get("motors", [""]))])
    for row in range(ROWS):
        cells = [stamp(row, "%Y-%m-%dT%H:%M:%SZ")]
        for at, (kind, unit) in enumerate(own.values()):
            made = {"?": "low" if at else "high", "x": "other"}.get(kind, kind)
            number, channel = value(made, 1, row), CHANNELS.get(made, "speed")
            if unit in KNOWN_UNITS[QUANTITIES[channel]]:
                number = float(from_canonical(channel, number, unit))
            cells.append(f"{number:.3f}")
        lines.append(cells)
    path = folder / "log.csv"
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(lines)
    return path
