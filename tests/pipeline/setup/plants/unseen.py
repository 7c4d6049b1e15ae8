"""Six plants that were written and measured before the recogniser was changed for them.

Their first score stands in `docs/own_fleet.md` beside the last one.
"""

from __future__ import annotations

from tests.pipeline.setup.plants.control_systems import wincc_archive
from tests.pipeline.setup.plants.plant import ROWS, Plant, mapped, one_table, stamp, table, value


def _grafana_prometheus() -> Plant:
    """Grafana with Prometheus, series joined by time: a column's name is the series' labels."""
    kinds = {
        "hydraulic_pressure_difference_bar": "dp",
        "hydraulic_oil_temperature_celsius": "temp",
        "hydraulic_shaft_speed_rpm": "speed",
        "hydraulic_case_drain_flow_lpm": "flow",
    }
    plain = '{{{{__name__="{{}}", instance="edge-4:9100", motor="W0{}"}}}}'
    columns = [(metric, n) for metric in kinds for n in (1, 2)]
    header = [plain.format(n).format(metric).replace('"', '""') for metric, n in columns]
    text = table(
        ['"Time"', *(f'"{name}"' for name in header)],
        [(kinds[metric], n) for metric, n in columns],
        form="%Y-%m-%d %H:%M:%S",
    )
    return Plant(
        "Grafana with Prometheus, labels in the names of columns",
        {"joined.csv": text},
        {f"W0{n}": mapped(kinds, plain.format(n)) for n in (1, 2)},
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


UNSEEN: tuple[Plant, ...] = (
    # PI DataLink, sampled: attributes of two elements of the asset framework by their paths.
    one_table(
        "PI DataLink, attributes of elements, digital states among the numbers", "datalink.csv",
        {
            "Differential Pressure": "dp", "Oil Temperature": "temp", "Shaft Speed": "speed",
            "Case Drain Flow": "flow", "Winding Temperature": "other",
        },
        {"Drive A": 0, "Drive B": 1}, r"\\AF01\Works\Mill 2\{motor}|{signal}", units={},
        time="Time", form="%d-%b-%y %H:%M:%S",
        unread=(f"{value('flow', 0, 7):.3f}", "I/O Timeout"),
    ),
    one_table(
        "Ignition, a tag provider, Italian", "storico.csv",
        {
            "Pressione_Mandata": "high", "Pressione_Ritorno": "low", "Temperatura_Olio": "temp",
            "Giri_Motore": "speed", "Portata_Drenaggio": "flow", "Corrente_Pompa": "pump",
        },
        {"Motore1": 1, "Motore2": 2}, "[default]Frantoio/{motor}/{signal}", units={},
        time="t_stamp", form="%Y-%m-%d %H:%M:%S",
    ),
    # The archive ends with the panel's own tag for its stop.
    wincc_archive(
        "WinCC Comfort, the mark of a stop at the end, Polish", "Archiwum0.csv", "Kruszarka",
        {
            "Cisnienie_A": "high", "Cisnienie_B": "low", "Temperatura_oleju": "temp",
            "Obroty": "speed", "Przeciek": "flow",
        },
        f'"$RT_OFF$";"{stamp(ROWS, "%d.%m.%Y %H:%M:%S")}";0;2;46035250300,0000\n',
    ),
    _grafana_prometheus(),
    _influx_dutch(),
    one_table(
        "Excel, a title, date and time apart, Portuguese", "registo.csv",
        {
            "Pressão diferencial (bar)": "dp", "Temperatura do óleo (°C)": "temp",
            "Rotação (rpm)": "speed", "Vazão de dreno (L/min)": "flow",
            "Pressão da carcaça (bar)": "case", "Nível do tanque (%)": "other",
        },
        above="Registo do guincho 2\n\n", time="Data;Hora", form="%d/%m/%Y;%H:%M:%S",
        separator=";", decimal=",", encoding="cp1252", line_end="\r\n",
    ),
)  # fmt: skip
