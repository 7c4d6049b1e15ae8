"""The dialects in which every log has to come to the same fits."""

from __future__ import annotations

from tests.dialects.columns import Parquet, counts, decimals, singles
from tests.dialects.csv_text import Csv
from tests.dialects.dialect import SINGLE, Dialect
from tests.dialects.messages import Json, Mcap, Protobuf, Ros2

SEMICOLON = {"separator": ";", "decimal": ","}
GERMAN = {
    "pressure_difference": "Druckdifferenz Δp",
    "high_port_pressure": "Druck Hochdruckseite",
    "low_port_pressure": "Druck Niederdruckseite",
    "oil_temperature": "Öltemperatur °C",
    "speed": "Drehzahl (1/min)",
    "leakage_flow": "Leckölstrom",
}
SPREADSHEET = {"time_format": "excel_days", "time_zone": "Europe/Oslo"}
AMERICAN_TIMES = {"time_format": "%m/%d/%Y %I:%M:%S.%f %p", "time_zone": "America/Chicago"}
AMERICAN_UNITS = {"pressure": "psi", "temperature": "degF", "flow": "us_gal/min"}
APART = {"date_column": "Datum", "time": "Zeit", "time_format": "%d.%m.%Y %H:%M:%S,%f"}
APART |= {"time_zone": "Europe/Berlin"}
LONG_LOCAL = {"layout": "long", "channel_column": "tag", "time_zone": "Australia/Lord_Howe"}
LONG_LOCAL |= {"time_format": "%Y-%m-%d %H:%M:%S.%f"}
TEXT: tuple[Dialect, ...] = (
    Csv("semicolon, decimal comma, kPa", SEMICOLON, {"pressure": "kPa"}, reverse=True),
    Csv("K, preamble, row of units", {"skip_rows": 3, "unit_rows": 1}, {"temperature": "K"}),
    Csv("columns of others, header again", header_every=700, company=True),
    Csv("UTF-16", {"encoding": "utf-16"} | SEMICOLON, names=GERMAN),
    Csv("gzip, epoch in ms", {"time_format": "epoch_ms"}, packed=".gz"),
    Csv("spreadsheet", SEMICOLON | SPREADSHEET, step_us=1000, line_end="\r\n"),
    Csv("American: psi, °F, gallons", AMERICAN_TIMES, AMERICAN_UNITS, quoted=True),
    Csv("date and time apart", SEMICOLON | APART),
    Csv("long, local time", LONG_LOCAL, names=GERMAN),
    Csv("a file a channel, mbar", {"layout": "file_per_channel"}, {"pressure": "mbar"}),
)
COLUMNS: tuple[Dialect, ...] = (
    Parquet("wide, ns, other zone", time_unit="ns", zone="America/St_Johns"),
    Parquet(
        "wide, local time, small row groups",
        {"time_zone": "Europe/Berlin"},
        {"pressure": "psi", "flow": "m3/s"},
        zone=None,
        options={"row_group_size": 999, "compression": "snappy", "data_page_version": "2.0"},
    ),
    Parquet(
        "long, dictionary, epoch in µs",
        {"layout": "long", "time_format": "epoch_us"},
        dictionary=True,
        options={"row_group_size": 5000, "compression": "zstd"},
    ),
    Parquet("decimals", numbers=decimals(15), finite=True),
    Parquet("whole numbers with a scale", numbers=counts(1e-12), scale=1e-12, finite=True),
    Parquet("nested float32", numbers=singles, precision=SINGLE, within=("winch",)),
)
MESSAGES: tuple[Dialect, ...] = (
    Mcap(
        "JSON together, not chunked, kPa, deg/s",
        units={"pressure": "kPa", "speed": "deg/s"},
        encoding=Json(together=True),
        stamped="message",
        options={"use_chunking": False},
    ),
    Mcap("Protobuf, stamp within", encoding=Protobuf(), stamped="message"),
    Mcap("ROS 2, stamp within, psi", units={"pressure": "psi"}, encoding=Ros2(), stamped="message"),
    Mcap("ROS 2 float32", precision=SINGLE, encoding=Ros2(single=True)),
)
DIALECTS: tuple[Dialect, ...] = (*TEXT, *COLUMNS, *MESSAGES)
OVER_A_CLOCK_CHANGE: tuple[Dialect, ...] = tuple(
    dialect for dialect in DIALECTS if str(dialect.logs.get("time_zone", "")).startswith("Europe/")
)
"""In the local time of zones whose clocks go back on the last Sunday of October."""
