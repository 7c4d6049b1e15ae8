"""The dialects in which every log has to come to the same fits."""

from __future__ import annotations

import codecs

from mcap.writer import CompressionType, IndexType

from tests.dialects.columns import Parquet, counts, decimals, singles
from tests.dialects.csv_text import Csv
from tests.dialects.dialect import SINGLE, Dialect
from tests.dialects.messages import Json, Mcap, Protobuf, Ros2

SEMICOLON, TAB = {"separator": ";", "decimal": ","}, {"separator": "\t", "decimal": ","}
DOTS = {"thousands": "."}
GERMAN = {
    "pressure_difference": "Druckdifferenz Δp",
    "high_port_pressure": "Druck Hochdruckseite",
    "low_port_pressure": "Druck Niederdruckseite",
    "oil_temperature": "Öltemperatur °C",
    "speed": "Drehzahl (1/min)",
    "leakage_flow": "Leckölstrom",
}
LATIN = {**GERMAN, "pressure_difference": "Druckdifferenz"}
SPREADSHEET = {"time_format": "excel_days", "time_zone": "Europe/Oslo"}
AMERICAN_TIMES = {"time_format": "%m/%d/%Y %I:%M:%S.%f %p", "time_zone": "America/Chicago"}
AMERICAN_UNITS = {"pressure": "psi", "temperature": "degF", "flow": "us_gal/min"}
APART = {"date_column": "Datum", "time": "Zeit", "time_format": "%d.%m.%Y %H:%M:%S,%f"}
APART |= {"time_zone": "Europe/Berlin"}
LONG_LOCAL = {"layout": "long", "channel_column": "tag", "time_zone": "Australia/Lord_Howe"}
LONG_LOCAL |= {"time_format": "%Y-%m-%d %H:%M:%S.%f"}
TEXT: tuple[Dialect, ...] = (
    Csv("ISO 8601 with an offset", written_zone="Asia/Kolkata"),
    Csv("semicolon, decimal comma, kPa", SEMICOLON, {"pressure": "kPa"}, reverse=True),
    Csv("thousands with dots, Pa, l/h", SEMICOLON | DOTS, {"pressure": "Pa", "flow": "l/h"}),
    Csv("thousands with blanks, ml/min", TAB | {"thousands": " "}, {"flow": "ml/min"}),
    Csv("tab, psi, CRLF", {"separator": "\t"}, {"pressure": "psi"}, line_end="\r\n"),
    Csv("pipe, °F, CR", {"separator": "|"}, {"temperature": "degF"}, line_end="\r"),
    Csv("K, preamble, row of units", {"skip_rows": 3, "unit_rows": 1}, {"temperature": "K"}),
    Csv("header again, m³/h", {"unit_rows": 1}, {"flow": "m3/h"}, header_every=1000),
    Csv("columns of others, header again", header_every=700, company=True),
    Csv("UTF-8 with its mark, umlauts", names=GERMAN, bom=codecs.BOM_UTF8),
    Csv("UTF-16", {"encoding": "utf-16"} | SEMICOLON, names=GERMAN),
    Csv("UTF-16 without its mark", {"encoding": "utf-16-be"}, names=GERMAN, line_end="\r\n"),
    Csv("Latin-1, rad/s", {"encoding": "latin-1"}, {"speed": "rad/s"}, names=LATIN),
    Csv("quoted, MPa", units={"pressure": "MPa"}, quoted=True, company=True),
    Csv("words for no reading", tokens=("---", "Bad", "N/A", "", "null")),
    Csv("gzip, epoch in ms", {"time_format": "epoch_ms"}, packed=".gz"),
    Csv("zstd, epoch in ns", {"time_format": "epoch_ns"}, packed=".zst"),
    Csv("epoch in µs, 1/s", {"time_format": "epoch_us"}, {"speed": "1/s"}),
    Csv("epoch in s with fractions, l/s", {"time_format": "epoch_s"}, {"flow": "l/s"}),
    Csv("spreadsheet", SEMICOLON | SPREADSHEET, step_us=1000, line_end="\r\n"),
    Csv("American: psi, °F, gallons", AMERICAN_TIMES, AMERICAN_UNITS, quoted=True),
    Csv("date and time apart", SEMICOLON | APART),
    Csv("long, local time", LONG_LOCAL, names=GERMAN),
    Csv("long, gzip, words", {"layout": "long"}, tokens=("Bad", "---"), packed=".gz"),
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
        "nested, epoch in ms",
        {"time_format": "epoch_ms", "time": "t"},
        within=("hydraulics", "drive"),
        options={"compression": "gzip"},
    ),
    Parquet(
        "long, dictionary, epoch in µs",
        {"layout": "long", "time_format": "epoch_us"},
        dictionary=True,
        options={"row_group_size": 5000, "compression": "zstd"},
    ),
    Parquet(
        "a file a channel, K, m³/h",
        {"layout": "file_per_channel", "value_column": "reading"},
        {"temperature": "K", "flow": "m3/h"},
        options={"use_dictionary": False, "compression": "none"},
    ),
    Parquet("decimals", numbers=decimals(15), finite=True),
    Parquet("whole numbers with a scale", numbers=counts(1e-12), scale=1e-12, finite=True),
    Parquet("nested float32", numbers=singles, precision=SINGLE, within=("winch",)),
    Parquet(
        "spreadsheet days, kPa, °F",
        {"time_format": "excel_days", "time_zone": "Asia/Tokyo"},
        {"pressure": "kPa", "temperature": "degF"},
        step_us=1000,
    ),
)
MESSAGES: tuple[Dialect, ...] = (
    Mcap(
        "JSON, lz4, publish time",
        stamped="publish_time",
        options={"compression": CompressionType.LZ4},
    ),
    Mcap(
        "JSON together, not chunked, kPa, deg/s",
        units={"pressure": "kPa", "speed": "deg/s"},
        encoding=Json(together=True),
        stamped="message",
        options={"use_chunking": False},
    ),
    Mcap("Protobuf, stamp within", encoding=Protobuf(), stamped="message"),
    Mcap(
        "Protobuf together, no index, gallons, °F",
        units={"flow": "imperial_gal/min", "temperature": "degF"},
        encoding=Protobuf(together=True),
        options={"index_types": IndexType.NONE, "use_statistics": False, "enable_crcs": False},
    ),
    Mcap(
        "Protobuf float32",
        precision=SINGLE,
        encoding=Protobuf(single=True),
        options={"compression": CompressionType.NONE},
    ),
    Mcap("ROS 2, stamp within, psi", units={"pressure": "psi"}, encoding=Ros2(), stamped="message"),
    Mcap("ROS 2, K", units={"temperature": "K"}, encoding=Ros2(), options={"enable_crcs": False}),
    Mcap("ROS 2 float32", precision=SINGLE, encoding=Ros2(single=True)),
)
DIALECTS: tuple[Dialect, ...] = (*TEXT, *COLUMNS, *MESSAGES)
OVER_A_CLOCK_CHANGE: tuple[Dialect, ...] = tuple(
    dialect for dialect in DIALECTS if str(dialect.logs.get("time_zone", "")).startswith("Europe/")
)
"""In the local time of zones whose clocks go back on the last Sunday of October."""
