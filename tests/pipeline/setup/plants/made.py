"""Plants' files, and the mapping that a person who knows the plant would make.

Written from the export formats of PI, Ignition, WinCC, Grafana, InfluxDB and Excel. In a mapping,
the unit None means that the log does not say it, and the place `ASK` that the log does not say
which column it is: there only a question is right.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path

ROWS = 24
START = datetime(2026, 1, 13, 6, 0)
ASK = None


@dataclass(frozen=True)
class Place:
    """A column, tag or field, with its unit and the column of its quality."""

    source: str
    unit: str | None
    quality: str = ""


Mapped = Mapping[str, Place | None]


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


def value(kind: str, motor: int, row: int) -> float:
    """A reading of a motor at work, in bar, °C, rpm or l/min."""
    base, step = {
        "dp": (180.0, 4.0),
        "high": (205.0, 4.0),
        "low": (18.0, 0.2),
        "charge": (20.0, 0.2),
        "case": (1.5, 0.05),
        "temp": (46.0, 0.3),
        "speed": (31.0, 0.7),
        "flow": (1.25, 0.05),
        "other": (60.0, 1.1),
        "pump": (1480.0, 1.0),
    }[kind]
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


def _pi_wide() -> Plant:
    tags = ["HYM01:PDT101.PV", "HYM01:TT102.PV", "HYM01:ST103.PV", "HYM01:FT104.PV"]
    text = table(
        ["Timestamp", *tags],
        [("dp", 1), ("temp", 1), ("speed", 1), ("flow", 1)],
        form="%d-%b-%Y %H:%M:%S",
    ).replace(f"{value('flow', 1, 5):.3f}\n", "No Data\n", 1)
    names = ("pressure_difference", "oil_temperature", "speed", "leakage_flow")
    return Plant(
        "PI, sampled, ISA tags without units",
        {"export.csv": text},
        {"HYM01": {name: Place(tag, None) for name, tag in zip(names, tags, strict=True)}},
        named="export.csv",
    )


def _pi_long() -> Plant:
    kinds = {"PDIFF": "dp", "TOIL": "temp", "NMOT": "speed", "QLEAK": "flow"}
    units = {"dp": "bar", "temp": "degC", "speed": "rpm", "flow": "l/min"}
    tags = {f"W{motor}_{tag}": (kind, motor) for motor in (1, 2) for tag, kind in kinds.items()}
    names = ("pressure_difference", "oil_temperature", "speed", "leakage_flow")
    return Plant(
        "PI, compressed, a row a sample, two motors",
        {
            "pi/archive.csv": tagged(
                ["tag", "time", "value", "units", "status"],
                tags,
                lambda tag, row, number: (
                    *(tag, stamp(row, "%Y-%m-%dT%H:%M:%SZ"), f"{number:.3f}"),
                    *(units[tags[tag][0]], "Good"),
                ),
            )
        },
        {
            f"W{motor}": {
                name: Place(f"W{motor}_{tag}", units[kind], "status")
                for name, (tag, kind) in zip(names, kinds.items(), strict=True)
            }
            for motor in (1, 2)
        },
        named="pi/archive.csv",
    )


def _ignition() -> Plant:
    header = "Mill3/Motor{n}/{t}"
    signals = {
        "HP Pressure (bar)": ("high_port_pressure", "high", "bar"),
        "LP Pressure (bar)": ("low_port_pressure", "low", "bar"),
        "Oil Temperature (°C)": ("oil_temperature", "temp", "degC"),
        "Shaft Speed (rpm)": ("speed", "speed", "rpm"),
        "Case Drain Flow (l/min)": ("leakage_flow", "flow", "l/min"),
    }
    columns = [(n, t) for n in (1, 2, 3) for t in signals]
    text = table(
        ["t_stamp", *(header.format(n=n, t=t) for n, t in columns)],
        [(signals[t][1], n) for n, t in columns],
        form="%Y-%m-%d %H:%M:%S.000",
    )
    return Plant(
        "Ignition, tag paths, three motors in a table",
        {"tags.csv": text},
        {
            f"Motor{n}": {
                name: Place(header.format(n=n, t=t), unit) for t, (name, _, unit) in signals.items()
            }
            for n in (1, 2, 3)
        },
        named="tags.csv",
    )


def _ignition_dataset() -> Plant:
    names = ["Conveyor/dP_bar", "Conveyor/OilTemp_C", "Conveyor/Speed_rpm", "Conveyor/Leak_lpm"]
    kinds = ("dp", "temp", "speed", "flow")
    rows = [
        ",".join(
            [f'"{stamp(row, "%Y-%m-%d %H:%M:%S")}"']
            + [f'"{value(kind, 1, row):.3f}"' for kind in kinds]
        )
        for row in range(ROWS)
    ]
    quoted = ",".join(f'"{name}"' for name in ("t_stamp", *names))
    text = f'"#NAMES"\n{quoted}\n"#TYPES"\n"date","F","F","F","F"\n"#ROWS","{ROWS}"\n'
    return Plant(
        "Ignition, a dataset with #NAMES and #TYPES",
        {"dataset.csv": text + "\n".join(rows) + "\n"},
        {
            "Conveyor": {
                "pressure_difference": Place(names[0], "bar"),
                "oil_temperature": Place(names[1], "degC"),
                "speed": Place(names[2], "rpm"),
                "leakage_flow": Place(names[3], "l/min"),
            }
        },
        named="dataset.csv",
    )


def _wincc_long() -> Plant:
    kinds = {"Druck_A": "high", "Druck_B": "low", "Oeltemperatur": "temp", "Drehzahl": "speed"}
    kinds |= {"Leckoelmenge": "flow"}
    tags = {f"HYD_M1_{tag}": (kind, 1) for tag, kind in kinds.items()}
    names = ("high_port_pressure", "low_port_pressure", "oil_temperature", "speed", "leakage_flow")
    return Plant(
        "WinCC, archive export, German",
        {
            "Archiv.csv": tagged(
                ['"VarName"', '"TimeString"', '"VarValue"', '"Validity"', '"Time_ms"'],
                tags,
                lambda tag, row, number: (
                    f'"{tag}"',
                    f'"{stamp(row, "%d.%m.%Y %H:%M:%S")}"',
                    f"{number:.3f}".replace(".", ","),
                    "1",
                    f"{46035250000 + row * 11.574:.4f}".replace(".", ","),
                ),
                ";",
            )
        },
        {"HYD_M1": {n: Place(t, None) for n, t in zip(names, tags, strict=True)}},
        named="Archiv.csv",
        line_end="\r\n",
    )


def _wincc_wide() -> Plant:
    signals = {
        "Druck A [bar]": ("high_port_pressure", "high", "bar"),
        "Druck B [bar]": ("low_port_pressure", "low", "bar"),
        "Lecköltemperatur [°C]": ("oil_temperature", "temp", "degC"),
        "Motordrehzahl [1/min]": ("speed", "speed", "rpm"),
        "Leckölmenge [l/min]": ("leakage_flow", "flow", "l/min"),
        "Speisedruck [bar]": ("charge_pressure", "charge", "bar"),
        "Tanktemperatur [°C]": ("", "other", ""),
    }
    return Plant(
        "WinCC, a table, German letters",
        {
            "Kurve.csv": table(
                ["Zeitpunkt", *signals],
                [(kind, 1) for _, kind, _ in signals.values()],
                form="%d.%m.%Y %H:%M:%S",
                separator=";",
                decimal=",",
            )
        },
        {"": {name: Place(t, unit) for t, (name, _, unit) in signals.items() if name}},
        encoding="cp1252",
        named="Kurve.csv",
        line_end="\r\n",
    )


def _grafana_wide() -> Plant:
    signals = {
        "Delta p {}": ("pressure_difference", "dp"),
        "Oil temp {}": ("oil_temperature", "temp"),
        "Speed {}": ("speed", "speed"),
        "Drain flow {}": ("leakage_flow", "flow"),
    }
    motors = ("Winch 1", "Winch 2")
    header = [signal.format(motor) for motor in motors for signal in signals]
    return Plant(
        "Grafana, series joined by time, the motor behind the name",
        {
            "panel-data.csv": table(
                ["Time", *header],
                [(kind, n) for n in (1, 2) for _, kind in signals.values()],
                form="%Y-%m-%d %H:%M:%S",
            )
        },
        {
            motor: {name: Place(s.format(motor), None) for s, (name, _) in signals.items()}
            for motor in motors
        },
        named="panel-data.csv",
    )


def _grafana_long() -> Plant:
    kinds = {"dp_bar": "dp", "oil_temp_c": "temp", "speed_rpm": "speed", "drain_flow_lpm": "flow"}
    tags = {f"press4.{tag}": (kind, 1) for tag, kind in kinds.items()}
    names = ("pressure_difference", "oil_temperature", "speed", "leakage_flow")
    units = ("bar", "degC", "rpm", "l/min")
    return Plant(
        "Grafana, series as rows",
        {
            "series.csv": tagged(
                ["Series", "Time", "Value"],
                tags,
                lambda tag, row, number: (
                    tag,
                    stamp(row, "%Y-%m-%dT%H:%M:%S+01:00"),
                    f"{number:.3f}",
                ),
                ";",
            )
        },
        {
            "press4": {
                name: Place(tag, unit) for name, tag, unit in zip(names, tags, units, strict=True)
            }
        },
        named="series.csv",
    )


def _influx(tag_column: bool) -> Plant:
    kinds = {"delta_p_bar": "dp", "oil_temp_degC": "temp", "speed_rpm": "speed"}
    kinds |= {"leakage_l_per_min": "flow"}
    names = ("pressure_difference", "oil_temperature", "speed", "leakage_flow")
    units = ("bar", "degC", "rpm", "l/min")
    motors = (1, 2) if tag_column else (1,)
    head = (
        "#group,false,false,false,false,true,true,true\n"
        "#datatype,string,long,dateTime:RFC3339,double,string,string,string\n"
        "#default,_result,,,,,,\n"
    )
    lines = [",result,table,_time,_value,_field,_measurement,motor"]
    lines += [
        f",,{at},{stamp(row, '%Y-%m-%dT%H:%M:%SZ')},{value(kind, n, row):.3f},{tag},oil,HM{n}"
        for n in motors
        for at, (tag, kind) in enumerate(kinds.items())
        for row in range(ROWS)
    ]
    return Plant(
        "InfluxDB, annotated CSV" + (", two motors by a tag" if tag_column else ""),
        {"query.csv": head + "\n".join(lines) + "\n"},
        {
            f"HM{n}": {
                name: Place(tag, unit) for name, tag, unit in zip(names, kinds, units, strict=True)
            }
            for n in motors
        },
        named="query.csv",
    )


def _excel_isa() -> Plant:
    signals = {
        "PT101.PV": (None, "high", "bar"),
        "TT102.PV": ("oil_temperature", "temp", "degC"),
        "ST103.PV": ("speed", "speed", "rpm"),
        "FT104.PV": ("leakage_flow", "flow", "l/min"),
    }
    mapped: dict[str, Place | None] = {
        name: Place(tag, unit) for tag, (name, _, unit) in signals.items() if name
    }
    return Plant(
        "Excel, ISA tags with a row of units, one gauge pressure",
        {
            "trend.csv": table(
                ["Date", *signals],
                [(kind, 1) for _, kind, _ in signals.values()],
                form="%d.%m.%Y %H:%M:%S",
                separator=";",
                decimal=",",
                below=";bar;°C;rpm;l/min",
            )
        },
        {"": mapped | {"pressure_difference": ASK}},
        named="trend.csv",
    )


def _language(
    name: str, signals: Mapping[str, tuple[str, str, str | None]], time: str, encoding: str
) -> Plant:
    return Plant(
        name,
        {
            "log.csv": table(
                [time, *signals],
                [(kind, 1) for _, kind, _ in signals.values()],
                form="%d/%m/%Y %H:%M:%S" if encoding == "utf-8" else "%Y-%m-%d %H:%M:%S",
                separator=";",
                decimal=",",
            )
        },
        {"": {channel: Place(t, unit) for t, (channel, _, unit) in signals.items() if channel}},
        encoding=encoding,
        named="log.csv",
    )


def _swedish() -> Plant:
    return _language(
        "Excel, Swedish",
        {
            "Tryckskillnad (bar)": ("pressure_difference", "dp", "bar"),
            "Oljetemperatur (°C)": ("oil_temperature", "temp", "degC"),
            "Varvtal (varv/min)": ("speed", "speed", "rpm"),
            "Läckflöde (l/min)": ("leakage_flow", "flow", "l/min"),
            "Hustryck (bar)": ("case_pressure", "case", "bar"),
            "Matningstryck (bar)": ("charge_pressure", "charge", "bar"),
        },
        "Tid",
        "cp1252",
    )


def _spanish() -> Plant:
    return _language(
        "Excel, Spanish",
        {
            "Presión diferencial [bar]": ("pressure_difference", "dp", "bar"),
            "Temperatura del aceite [°C]": ("oil_temperature", "temp", "degC"),
            "Velocidad del motor [rpm]": ("speed", "speed", "rpm"),
            "Caudal de fuga [l/min]": ("leakage_flow", "flow", "l/min"),
            "Presión de carga [bar]": ("charge_pressure", "charge", "bar"),
            "Temperatura ambiente [°C]": ("", "other", ""),
        },
        "Fecha y hora",
        "utf-8",
    )


def _french() -> Plant:
    return _language(
        "Excel, French",
        {
            "Pression HP (bar)": ("high_port_pressure", "high", "bar"),
            "Pression BP (bar)": ("low_port_pressure", "low", "bar"),
            "Température d'huile (°C)": ("oil_temperature", "temp", "degC"),
            "Vitesse (tr/min)": ("speed", "speed", "rpm"),
            "Débit de fuite (l/min)": ("leakage_flow", "flow", "l/min"),
            "Pression de gavage (bar)": ("charge_pressure", "charge", "bar"),
            "Pression carter (bar)": ("case_pressure", "case", "bar"),
        },
        "Horodatage",
        "utf-8",
    )


def _wide_prefix() -> Plant:
    signals = {
        "dp": ("pressure_difference", "dp", "bar"),
        "T_oil": ("oil_temperature", "temp", "°C"),
        "n": ("speed", "speed", "rpm"),
        "Q_leak": ("leakage_flow", "flow", "l/min"),
    }
    columns = [(n, t) for n in (1, 2, 3, 4) for t in signals]
    canonical = {"°C": "degC"}
    return Plant(
        "Excel, four motors by a prefix, a row of units",
        {
            "wide.csv": table(
                ["time", *(f"W{n}_{t}" for n, t in columns)],
                [(signals[t][1], n) for n, t in columns],
                below="," + ",".join(signals[t][2] for _, t in columns),
            )
        },
        {
            f"W{n}": {
                name: Place(f"W{n}_{t}", canonical.get(unit, unit))
                for t, (name, _, unit) in signals.items()
            }
            for n in (1, 2, 3, 4)
        },
        named="wide.csv",
    )


def _dotted() -> Plant:
    signals = {
        "PDT": ("pressure_difference", "dp", "bar"),
        "TT": ("oil_temperature", "temp", "degC"),
        "ST": ("speed", "speed", "rpm"),
        "FT": ("leakage_flow", "flow", "l/min"),
    }
    motors = ("Mill3.Motor1", "Mill3.Motor2", "Mill4.Motor1")
    columns = [(m, t) for m in motors for t in signals]
    return Plant(
        "OPC UA, dotted paths with ISA letters",
        {
            "opcua.csv": table(
                ["time", *(f"{m}.{t} [{signals[t][2]}]" for m, t in columns)],
                [(signals[t][1], motors.index(m)) for m, t in columns],
            )
        },
        {
            m: {name: Place(f"{m}.{t} [{unit}]", unit) for t, (name, _, unit) in signals.items()}
            for m in motors
        },
        named="opcua.csv",
    )


def _quality() -> Plant:
    signals = {
        "PressureA": ("high_port_pressure", "high"),
        "PressureB": ("low_port_pressure", "low"),
        "OilTemp": ("oil_temperature", "temp"),
        "Speed": ("speed", "speed"),
        "DrainFlow": ("leakage_flow", "flow"),
    }
    header = [column for t in signals for column in (f"Drum.{t}", f"Drum.{t}.Q")]
    return Plant(
        "OPC DA, a column of quality beside each value",
        {
            "da.csv": table(
                ["Time", *header],
                [(kind, 1) for _, kind in signals.values()],
                form="%Y-%m-%d %H:%M:%S.000",
                quality="192",
            )
        },
        {"Drum": {n: Place(f"Drum.{t}", None, f"Drum.{t}.Q") for t, (n, _) in signals.items()}},
        named="da.csv",
    )


def _folder() -> Plant:
    signals = {
        "dp [bar]": ("pressure_difference", "dp", "bar"),
        "oil temperature [°C]": ("oil_temperature", "temp", "degC"),
        "speed [rpm]": ("speed", "speed", "rpm"),
        "case drain [l/min]": ("leakage_flow", "flow", "l/min"),
    }
    kinds = [(kind, 1) for _, kind, _ in signals.values()]
    text = table(["time", *signals], kinds)
    mapped = {name: Place(t, unit) for t, (name, _, unit) in signals.items()}
    return Plant(
        "A folder a motor, a file a day",
        {
            f"logs/winch-{n}/2026-01-{day}.csv": text.replace("2026-01-13", f"2026-01-{day}")
            for n in (1, 2, 3)
            for day in (13, 14)
        },
        {f"winch-{n}": mapped for n in (1, 2, 3)},
        named="logs",
    )


def _several_files() -> Plant:
    units = {"dp": "bar", "oil_temp": "degC", "speed": "rpm", "drain_flow": "l/min"}
    kinds = {"dp": "dp", "oil_temp": "temp", "speed": "speed", "drain_flow": "flow"}
    names = {"dp": "pressure_difference", "oil_temp": "oil_temperature", "speed": "speed"}
    names |= {"drain_flow": "leakage_flow"}
    return Plant(
        "A file a channel",
        {
            f"kiln/{tag}_{day}.csv": table(["time", f"value [{units[tag]}]"], [(kind, 1)]).replace(
                "2026-01-13", day
            )
            for tag, kind in kinds.items()
            for day in ("2026-01-13", "2026-01-14")
        },
        {"kiln": {name: Place(f"{tag}_*.csv", units[tag]) for tag, name in names.items()}},
        named="kiln",
    )


def _rivals() -> Plant:
    signals = {
        "dp [bar]": ("pressure_difference", "dp", "bar"),
        "Oil temperature [°C]": ("oil_temperature", "temp", "degC"),
        "Pump speed [rpm]": ("", "pump", ""),
        "Motor speed [rpm]": ("speed", "speed", "rpm"),
        "Flow 1 [l/min]": ("", "flow", ""),
        "Flow 2 [l/min]": ("", "other", ""),
        "Winding temperature [°C]": ("", "other", ""),
    }
    mapped: dict[str, Place | None] = {
        name: Place(t, unit) for t, (name, _, unit) in signals.items() if name
    }
    return Plant(
        "Two flows of which either may be the drain's",
        {"bench.csv": table(["time", *signals], [(kind, 1) for _, kind, _ in signals.values()])},
        {"": mapped | {"leakage_flow": ASK}},
        named="bench.csv",
    )


def _american() -> Plant:
    signals = {
        "Diff Press PSIG": ("pressure_difference", "dp", "psi"),
        "Oil Temp DEGF": ("oil_temperature", "temp", "degF"),
        "Speed RPM": ("speed", "speed", "rpm"),
        "Case Drain GPM": ("leakage_flow", "flow", "us_gal/min"),
        "Ambient Temp DEGF": ("", "temp", ""),
    }
    columns = [(n, t) for n in (201, 202) for t in signals]
    return Plant(
        "A control system of the United States, two motors",
        {
            "dcs.csv": table(
                ["Date/Time", *(f"HM-{n} {t}" for n, t in columns)],
                [(signals[t][1], n - 200) for n, t in columns],
                form="%m/%d/%Y %H:%M:%S",
                convert=american,
            )
        },
        {
            f"HM-{n}": {
                name: Place(f"HM-{n} {t}", unit) for t, (name, _, unit) in signals.items() if name
            }
            for n in (201, 202)
        },
        named="dcs.csv",
    )


PLANTS: tuple[Plant, ...] = (
    _pi_wide(),
    _pi_long(),
    _ignition(),
    _ignition_dataset(),
    _wincc_long(),
    _wincc_wide(),
    _grafana_wide(),
    _grafana_long(),
    _influx(tag_column=False),
    _influx(tag_column=True),
    _excel_isa(),
    _swedish(),
    _spanish(),
    _french(),
    _wide_prefix(),
    _dotted(),
    _quality(),
    _folder(),
    _several_files(),
    _rivals(),
    _american(),
)
