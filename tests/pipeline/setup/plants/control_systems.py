"""Plants with PI, Ignition, WinCC, OPC or a control system of the United States."""

from __future__ import annotations

from collections.abc import Mapping

from tests.pipeline.setup.plants.plant import (
    ROWS,
    Place,
    Plant,
    american,
    stamp,
    table,
    tagged,
    value,
)


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


def wincc_archive(tags: Mapping[str, tuple[str, int]]) -> str:
    """Rows of tags as WinCC exports an archive."""
    return tagged(
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


def _wincc_long() -> Plant:
    kinds = {"Druck_A": "high", "Druck_B": "low", "Oeltemperatur": "temp", "Drehzahl": "speed"}
    kinds |= {"Leckoelmenge": "flow"}
    tags = {f"HYD_M1_{tag}": (kind, 1) for tag, kind in kinds.items()}
    names = ("high_port_pressure", "low_port_pressure", "oil_temperature", "speed", "leakage_flow")
    return Plant(
        "WinCC, archive export, German",
        {"Archiv.csv": wincc_archive(tags)},
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


CONTROL_SYSTEMS: tuple[Plant, ...] = (
    _pi_wide(),
    _pi_long(),
    _ignition(),
    _ignition_dataset(),
    _wincc_long(),
    _wincc_wide(),
    _dotted(),
    _quality(),
    _american(),
)
