"""Six plants that were written and measured before the recogniser was changed for them.

Their first score stands in `docs/own_fleet.md` beside the last one.
"""

from __future__ import annotations

from tests.pipeline.setup.plants.control_systems import wincc_archive
from tests.pipeline.setup.plants.plant import (
    PORTS,
    ROWS,
    Place,
    Plant,
    Signals,
    mapped,
    one_table,
    stamp,
    table,
    value,
)


def _pi_af() -> Plant:
    """PI DataLink, sampled: attributes of two elements of the asset framework by their paths."""
    signals: Signals = {
        "Differential Pressure": ("pressure_difference", "dp", None),
        "Oil Temperature": ("oil_temperature", "temp", None),
        "Shaft Speed": ("speed", "speed", None),
        "Case Drain Flow": ("leakage_flow", "flow", None),
        "Winding Temperature": ("", "other", None),
    }
    return one_table(
        "PI DataLink, attributes of elements, digital states among the numbers",
        "datalink.csv",
        signals,
        {"Drive A": 0, "Drive B": 1},
        r"\\AF01\Works\Mill 2\{motor}|{signal}",
        time="Time",
        form="%d-%b-%y %H:%M:%S",
        unread=(f"{value('flow', 0, 7):.3f}", "I/O Timeout"),
    )


def _ignition_italian() -> Plant:
    """Ignition: paths below a tag provider, in Italian."""
    signals: Signals = {
        "Pressione_Mandata": ("high_port_pressure", "high", None),
        "Pressione_Ritorno": ("low_port_pressure", "low", None),
        "Temperatura_Olio": ("oil_temperature", "temp", None),
        "Giri_Motore": ("speed", "speed", None),
        "Portata_Drenaggio": ("leakage_flow", "flow", None),
        "Corrente_Pompa": ("", "pump", None),
    }
    return one_table(
        "Ignition, a tag provider, Italian",
        "storico.csv",
        signals,
        {"Motore1": 1, "Motore2": 2},
        "[default]Frantoio/{motor}/{signal}",
        time="t_stamp",
        form="%Y-%m-%d %H:%M:%S",
    )


def _wincc_polish() -> Plant:
    """WinCC Comfort: the archive ends with the panel's own tag for its stop."""
    kinds = {"Cisnienie_A": "high", "Cisnienie_B": "low", "Temperatura_oleju": "temp"}
    kinds |= {"Obroty": "speed", "Przeciek": "flow"}
    tags = {f"Kruszarka_{tag}": (kind, 1) for tag, kind in kinds.items()}
    text = wincc_archive(tags)
    end = f'"$RT_OFF$";"{stamp(ROWS, "%d.%m.%Y %H:%M:%S")}";0;2;46035250300,0000\n'
    return Plant(
        "WinCC Comfort, the mark of a stop at the end, Polish",
        {"Archiwum0.csv": text + end},
        {"Kruszarka": {name: Place(tag, None) for name, tag in zip(PORTS, tags, strict=True)}},
        named="Archiwum0.csv",
        line_end="\r\n",
    )


def _grafana_prometheus() -> Plant:
    """Grafana with Prometheus, series joined by time: a column's name is the series' labels."""
    metrics = {
        "hydraulic_pressure_difference_bar": "dp",
        "hydraulic_oil_temperature_celsius": "temp",
        "hydraulic_shaft_speed_rpm": "speed",
        "hydraulic_case_drain_flow_lpm": "flow",
    }
    plain = '{{__name__="{}", instance="edge-4:9100", motor="{}"}}'
    columns = [(metric, n) for metric in metrics for n in (1, 2)]
    header = [plain.format(metric, f"W0{n}") for metric, n in columns]
    text = table(
        ['"Time"', *('"' + name.replace('"', '""') + '"' for name in header)],
        [(metrics[metric], n) for metric, n in columns],
        form="%Y-%m-%d %H:%M:%S",
    )
    return Plant(
        "Grafana with Prometheus, labels in the names of columns",
        {"joined.csv": text},
        {f"W0{n}": mapped(plain.format(metric, f"W0{n}") for metric in metrics) for n in (1, 2)},
        named="joined.csv",
    )


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


def _excel_portuguese() -> Plant:
    """Excel: date and time in columns of their own, a title above, in Portuguese."""
    signals = {
        "Pressão diferencial (bar)": ("pressure_difference", "dp", "bar"),
        "Temperatura do óleo (°C)": ("oil_temperature", "temp", "degC"),
        "Rotação (rpm)": ("speed", "speed", "rpm"),
        "Vazão de dreno (L/min)": ("leakage_flow", "flow", "l/min"),
        "Pressão da carcaça (bar)": ("case_pressure", "case", "bar"),
        "Nível do tanque (%)": ("", "other", ""),
    }
    return one_table(
        "Excel, a title, date and time apart, Portuguese",
        "registo.csv",
        signals,
        time="Data;Hora",
        above="Registo do guincho 2\n\n",
        form="%d/%m/%Y;%H:%M:%S",
        separator=";",
        decimal=",",
        encoding="cp1252",
        line_end="\r\n",
    )


UNSEEN: tuple[Plant, ...] = (
    _pi_af(),
    _ignition_italian(),
    _wincc_polish(),
    _grafana_prometheus(),
    _influx_dutch(),
    _excel_portuguese(),
)
