"""Plants with Grafana, InfluxDB, Excel, or a folder of logs."""

from __future__ import annotations

from tests.pipeline.setup.plants.plant import (
    ROWS,
    Place,
    Plant,
    Signals,
    mapped,
    one_table,
    stamp,
    table,
    tagged,
    value,
)


def _grafana_wide() -> Plant:
    signals: Signals = {
        "Delta p": ("pressure_difference", "dp", None),
        "Oil temp": ("oil_temperature", "temp", None),
        "Speed": ("speed", "speed", None),
        "Drain flow": ("leakage_flow", "flow", None),
    }
    return one_table(
        "Grafana, series joined by time, the motor behind the name",
        "panel-data.csv",
        signals,
        {"Winch 1": 1, "Winch 2": 2},
        "{signal} {motor}",
        time="Time",
        form="%Y-%m-%d %H:%M:%S",
    )


def _grafana_long() -> Plant:
    kinds = {"dp_bar": "dp", "oil_temp_c": "temp", "speed_rpm": "speed", "drain_flow_lpm": "flow"}
    tags = {f"press4.{tag}": (kind, 1) for tag, kind in kinds.items()}
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
        {"press4": mapped(tags)},
        named="series.csv",
    )


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


def _excel_isa() -> Plant:
    signals = {
        "PT101.PV": ("", "high", "bar"),
        "TT102.PV": ("oil_temperature", "temp", "degC"),
        "ST103.PV": ("speed", "speed", "rpm"),
        "FT104.PV": ("leakage_flow", "flow", "l/min"),
    }
    return one_table(
        "Excel, ISA tags with a row of units, one gauge pressure",
        "trend.csv",
        signals,
        time="Date",
        asked="pressure_difference",
        form="%d.%m.%Y %H:%M:%S",
        separator=";",
        decimal=",",
        below=";bar;°C;rpm;l/min",
    )


def _language(name: str, signals: Signals, time: str, encoding: str) -> Plant:
    return one_table(
        name,
        "log.csv",
        signals,
        time=time,
        form="%d/%m/%Y %H:%M:%S" if encoding == "utf-8" else "%Y-%m-%d %H:%M:%S",
        separator=";",
        decimal=",",
        encoding=encoding,
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
        "T_oil": ("oil_temperature", "temp", "degC"),
        "n": ("speed", "speed", "rpm"),
        "Q_leak": ("leakage_flow", "flow", "l/min"),
    }
    return one_table(
        "Excel, four motors by a prefix, a row of units",
        "wide.csv",
        signals,
        {f"W{n}": n for n in (1, 2, 3, 4)},
        "{motor}_{signal}",
        below=4 * ",bar,°C,rpm,l/min",
    )


def _folder() -> Plant:
    signals = {"dp [bar]": "dp", "oil temperature [°C]": "temp", "speed [rpm]": "speed"}
    signals |= {"case drain [l/min]": "flow"}
    text = table(["time", *signals], [(kind, 1) for kind in signals.values()])
    return Plant(
        "A folder a motor, a file a day",
        {
            f"logs/winch-{n}/2026-01-{day}.csv": text.replace("2026-01-13", f"2026-01-{day}")
            for n in (1, 2, 3)
            for day in (13, 14)
        },
        {f"winch-{n}": mapped(signals) for n in (1, 2, 3)},
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
    name = "Two flows of which either may be the drain's"
    return one_table(name, "bench.csv", signals, asked="leakage_flow")


TABLES: tuple[Plant, ...] = (
    _grafana_wide(),
    _grafana_long(),
    _influx(tag_column=False),
    _influx(tag_column=True),
    _excel_isa(),
    _swedish(),
    _spanish(),
    _french(),
    _wide_prefix(),
    _folder(),
    _several_files(),
    _rivals(),
)
