"""Plants with PI, Ignition, WinCC, OPC or a control system of the United States."""

from __future__ import annotations

from collections.abc import Mapping

from tests.pipeline.setup.plants.plant import (
    PORTS,
    ROWS,
    Place,
    Plant,
    Signals,
    american,
    mapped,
    one_table,
    stamp,
    table,
    tagged,
    value,
)


def _pi_wide() -> Plant:
    signals: Signals = {
        "PDT101": ("pressure_difference", "dp", None),
        "TT102": ("oil_temperature", "temp", None),
        "ST103": ("speed", "speed", None),
        "FT104": ("leakage_flow", "flow", None),
    }
    return one_table(
        "PI, sampled, ISA tags without units",
        "export.csv",
        signals,
        {"HYM01": 1},
        "{motor}:{signal}.PV",
        time="Timestamp",
        form="%d-%b-%Y %H:%M:%S",
        unread=(f"{value('flow', 1, 5):.3f}\n", "No Data\n"),
    )


def _pi_long() -> Plant:
    kinds = {"PDIFF": "dp", "TOIL": "temp", "NMOT": "speed", "QLEAK": "flow"}
    units = {"dp": "bar", "temp": "degC", "speed": "rpm", "flow": "l/min"}
    tags = {f"W{motor}_{tag}": (kind, motor) for motor in (1, 2) for tag, kind in kinds.items()}
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
        {f"W{n}": mapped((f"W{n}_{tag}" for tag in kinds), "status") for n in (1, 2)},
        named="pi/archive.csv",
    )


def _ignition() -> Plant:
    signals = {
        "HP Pressure (bar)": ("high_port_pressure", "high", "bar"),
        "LP Pressure (bar)": ("low_port_pressure", "low", "bar"),
        "Oil Temperature (°C)": ("oil_temperature", "temp", "degC"),
        "Shaft Speed (rpm)": ("speed", "speed", "rpm"),
        "Case Drain Flow (l/min)": ("leakage_flow", "flow", "l/min"),
    }
    return one_table(
        "Ignition, tag paths, three motors in a table",
        "tags.csv",
        signals,
        {f"Motor{n}": n for n in (1, 2, 3)},
        "Mill3/{motor}/{signal}",
        time="t_stamp",
        form="%Y-%m-%d %H:%M:%S.000",
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
        {"Conveyor": mapped(names)},
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
    return Plant(
        "WinCC, archive export, German",
        {"Archiv.csv": wincc_archive(tags)},
        {"HYD_M1": {n: Place(t, None) for n, t in zip(PORTS, tags, strict=True)}},
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
    return one_table(
        "WinCC, a table, German letters",
        "Kurve.csv",
        signals,
        time="Zeitpunkt",
        form="%d.%m.%Y %H:%M:%S",
        separator=";",
        decimal=",",
        encoding="cp1252",
        line_end="\r\n",
    )


def _dotted() -> Plant:
    signals = {
        "PDT [bar]": ("pressure_difference", "dp", "bar"),
        "TT [degC]": ("oil_temperature", "temp", "degC"),
        "ST [rpm]": ("speed", "speed", "rpm"),
        "FT [l/min]": ("leakage_flow", "flow", "l/min"),
    }
    motors = {"Mill3.Motor1": 0, "Mill3.Motor2": 1, "Mill4.Motor1": 2}
    name = "OPC UA, dotted paths with ISA letters"
    return one_table(name, "opcua.csv", signals, motors, "{motor}.{signal}")


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
    return one_table(
        "A control system of the United States, two motors",
        "dcs.csv",
        signals,
        {"HM-201": 1, "HM-202": 2},
        "{motor} {signal}",
        time="Date/Time",
        form="%m/%d/%Y %H:%M:%S",
        convert=american,
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
