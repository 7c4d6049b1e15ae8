"""Plants with Grafana, InfluxDB, Excel, or a folder of logs."""

from __future__ import annotations

from tests.pipeline.setup.plants.plant import (
    ROWS,
    UNITS,
    Plant,
    mapped,
    one_table,
    stamp,
    table,
    tagged,
    value,
)


def _grafana_long() -> Plant:
    kinds = {"dp_bar": "dp", "oil_temp_c": "temp", "speed_rpm": "speed", "drain_flow_lpm": "flow"}
    text = tagged(
        ["Series", "Time", "Value"],
        {f"press4.{tag}": (kind, 1) for tag, kind in kinds.items()},
        lambda tag, row, number: (tag, stamp(row, "%Y-%m-%dT%H:%M:%S+01:00"), f"{number:.3f}"),
        ";",
    )
    places = {"press4": mapped(kinds, "press4.{}")}
    return Plant("Grafana, series as rows", {"series.csv": text}, places, named="series.csv")


def _influx(tag_column: bool) -> Plant:
    kinds = {"delta_p_bar": "dp", "oil_temp_degC": "temp", "speed_rpm": "speed"}
    kinds |= {"leakage_l_per_min": "flow"}
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
        {f"HM{n}": mapped(kinds) for n in motors},
        named="query.csv",
    )


def _folder() -> Plant:
    kinds = {"dp [bar]": "dp", "oil temperature [°C]": "temp", "speed [rpm]": "speed"}
    kinds |= {"case drain [l/min]": "flow"}
    text = table(["time", *kinds], [(kind, 1) for kind in kinds.values()])
    return Plant(
        "A folder a motor, a file a day",
        {
            f"logs/winch-{n}/2026-01-{day}.csv": text.replace("2026-01-13", f"2026-01-{day}")
            for n in (1, 2, 3)
            for day in (13, 14)
        },
        {f"winch-{n}": mapped(kinds) for n in (1, 2, 3)},
        named="logs",
    )


def _several_files() -> Plant:
    kinds = {"dp": "dp", "oil_temp": "temp", "speed": "speed", "drain_flow": "flow"}
    files = {
        f"kiln/{tag}_{day}.csv": table(["time", f"value [{UNITS[kind]}]"], [(kind, 1)]).replace(
            "2026-01-13", day
        )
        for tag, kind in kinds.items()
        for day in ("2026-01-13", "2026-01-14")
    }
    return Plant("A file a channel", files, {"kiln": mapped(kinds, "{}_*.csv")}, named="kiln")


EXCEL = {"separator": ";", "decimal": ","}
TABLES: tuple[Plant, ...] = (
    one_table(
        "Grafana, series joined by time, the motor behind the name", "panel-data.csv",
        {"Delta p": "dp", "Oil temp": "temp", "Speed": "speed", "Drain flow": "flow"},
        {"Winch 1": 1, "Winch 2": 2}, "{signal} {motor}", units={},
        time="Time", form="%Y-%m-%d %H:%M:%S",
    ),
    _grafana_long(),
    _influx(tag_column=False),
    _influx(tag_column=True),
    one_table(
        "Excel, ISA tags with a row of units, one gauge pressure", "trend.csv",
        {"PT101.PV": "high", "TT102.PV": "temp", "ST103.PV": "speed", "FT104.PV": "flow"},
        strangers=("PT101.PV",), asked="pressure_difference",
        time="Date", form="%d.%m.%Y %H:%M:%S", below=";bar;°C;rpm;l/min", **EXCEL,
    ),
    one_table(
        "Excel, Swedish", "log.csv",
        {
            "Tryckskillnad (bar)": "dp", "Oljetemperatur (°C)": "temp",
            "Varvtal (varv/min)": "speed", "Läckflöde (l/min)": "flow",
            "Hustryck (bar)": "case", "Matningstryck (bar)": "charge",
        },
        time="Tid", form="%Y-%m-%d %H:%M:%S", encoding="cp1252", **EXCEL,
    ),
    one_table(
        "Excel, Spanish", "log.csv",
        {
            "Presión diferencial [bar]": "dp", "Temperatura del aceite [°C]": "temp",
            "Velocidad del motor [rpm]": "speed", "Caudal de fuga [l/min]": "flow",
            "Presión de carga [bar]": "charge", "Temperatura ambiente [°C]": "other",
        },
        time="Fecha y hora", form="%d/%m/%Y %H:%M:%S", **EXCEL,
    ),
    one_table(
        "Excel, French", "log.csv",
        {
            "Pression HP (bar)": "high", "Pression BP (bar)": "low",
            "Température d'huile (°C)": "temp", "Vitesse (tr/min)": "speed",
            "Débit de fuite (l/min)": "flow", "Pression de gavage (bar)": "charge",
            "Pression carter (bar)": "case",
        },
        time="Horodatage", form="%d/%m/%Y %H:%M:%S", **EXCEL,
    ),
    one_table(
        "Excel, four motors by a prefix, a row of units", "wide.csv",
        {"dp": "dp", "T_oil": "temp", "n": "speed", "Q_leak": "flow"},
        {f"W{n}": n for n in (1, 2, 3, 4)}, "{motor}_{signal}", below=4 * ",bar,°C,rpm,l/min",
    ),
    _folder(),
    _several_files(),
    one_table(
        "Two flows of which either may be the drain's", "bench.csv",
        {
            "dp [bar]": "dp", "Oil temperature [°C]": "temp", "Pump speed [rpm]": "pump",
            "Motor speed [rpm]": "speed", "Flow 1 [l/min]": "flow", "Flow 2 [l/min]": "other",
            "Winding temperature [°C]": "other",
        },
        strangers=("Flow 1 [l/min]",), asked="leakage_flow",
    ),
)  # fmt: skip
