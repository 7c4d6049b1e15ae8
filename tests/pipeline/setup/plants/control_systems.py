"""Plants with PI, Ignition, WinCC, OPC or a control system of the United States."""

from __future__ import annotations

from dataclasses import replace

from tests.pipeline.setup.plants.plant import (
    AMERICAN,
    ROWS,
    UNITS,
    Kinds,
    Plant,
    american,
    mapped,
    one_table,
    stamp,
    table,
    tagged,
    value,
)


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


def wincc_archive(name: str, file: str, motor: str, kinds: Kinds, end: str = "") -> Plant:
    """Rows of tags as WinCC exports an archive, which does not say the units."""
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


CONTROL_SYSTEMS: tuple[Plant, ...] = (
    one_table(
        "PI, sampled, ISA tags without units", "export.csv",
        {"PDT101": "dp", "TT102": "temp", "ST103": "speed", "FT104": "flow"},
        {"HYM01": 1}, "{motor}:{signal}.PV", units={},
        time="Timestamp", form="%d-%b-%Y %H:%M:%S",
        unread=(f"{value('flow', 1, 5):.3f}\n", "No Data\n"),
    ),
    _pi_long(),
    one_table(
        "Ignition, tag paths, three motors in a table", "tags.csv",
        {
            "HP Pressure (bar)": "high", "LP Pressure (bar)": "low", "Oil Temperature (°C)": "temp",
            "Shaft Speed (rpm)": "speed", "Case Drain Flow (l/min)": "flow",
        },
        {f"Motor{n}": n for n in (1, 2, 3)}, "Mill3/{motor}/{signal}",
        time="t_stamp", form="%Y-%m-%d %H:%M:%S.000",
    ),
    _ignition_dataset(),
    wincc_archive(
        "WinCC, archive export, German", "Archiv.csv", "HYD_M1",
        {
            "Druck_A": "high", "Druck_B": "low", "Oeltemperatur": "temp", "Drehzahl": "speed",
            "Leckoelmenge": "flow",
        },
    ),
    one_table(
        "WinCC, a table, German letters", "Kurve.csv",
        {
            "Druck A [bar]": "high", "Druck B [bar]": "low", "Lecköltemperatur [°C]": "temp",
            "Motordrehzahl [1/min]": "speed", "Leckölmenge [l/min]": "flow",
            "Speisedruck [bar]": "charge", "Tanktemperatur [°C]": "other",
        },
        time="Zeitpunkt", form="%d.%m.%Y %H:%M:%S",
        separator=";", decimal=",", encoding="cp1252", line_end="\r\n",
    ),
    one_table(
        "OPC UA, dotted paths with ISA letters", "opcua.csv",
        {"PDT [bar]": "dp", "TT [degC]": "temp", "ST [rpm]": "speed", "FT [l/min]": "flow"},
        {"Mill3.Motor1": 0, "Mill3.Motor2": 1, "Mill4.Motor1": 2}, "{motor}.{signal}",
    ),
    _quality(),
    one_table(
        "A control system of the United States, two motors", "dcs.csv",
        {
            "Diff Press PSIG": "dp", "Oil Temp DEGF": "temp", "Speed RPM": "speed",
            "Case Drain GPM": "flow", "Ambient Temp DEGF": "temp",
        },
        {"HM-201": 1, "HM-202": 2}, "{motor} {signal}",
        units=AMERICAN, strangers=("Ambient Temp DEGF",),
        time="Date/Time", form="%m/%d/%Y %H:%M:%S", convert=american,
    ),
)  # fmt: skip
