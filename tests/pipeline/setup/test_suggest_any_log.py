"""`check --suggest` of any dialect, Parquet file, and bytes."""

from __future__ import annotations

import contextlib
import re
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import LogError
from pipeline.setup.suggest import suggest
from tests.pipeline.setup.suggested import (
    DAY_OR_MONTH,
    PARQUET_TIMES,
    columns_of,
    log_in,
    read_as_suggested,
    require_same,
    times_of,
    us_of,
)
from tests.pipeline.setup.text_logs import Label, TextLog, in_unit, long, of_one_channel, wide

NAMES = {
    "pressure_difference": ("dp", "Delta P", "Druck", "PressureDiff", "tryck"),
    "high_port_pressure": ("p_high", "P_A", "HighPortPressure", "Hochdruck"),
    "low_port_pressure": ("p_low", "P_B", "LowPortPressure", "Niederdruck"),
    "oil_temperature": ("T_oil", "Oil temp", "Öltemperatur", "OilTemp", "temp"),
    "speed": ("n", "Drehzahl", "MotorSpeed", "varvtal", "speed"),
    "leakage_flow": ("q", "Lecköl", "DrainFlow", "case drain", "flow"),
}
SPELLED = {
    "pressure": (("bar", "bar"), ("kPa", "kPa"), ("MPa", "MPa"), ("psi", "PSI")),
    "temperature": (("degC", "°C"), ("degF", "°F"), ("K", "K")),
    "speed": (("rpm", "rpm"), ("rpm", "1/min"), ("1/s", "1/s")),
    "flow": (("l/min", "l/min"), ("l/min", "L/min"), ("m3/h", "m³/h"), ("us_gal/min", "gpm")),
}
QUANTITY = {
    **dict.fromkeys(("pressure_difference", "high_port_pressure", "low_port_pressure"), "pressure"),
    "oil_temperature": "temperature",
    "speed": "speed",
    "leakage_flow": "flow",
}
TIMES = (
    *("%Y-%m-%dT%H:%M:%S", "%Y-%m-%d %H:%M:%S.%f", "%Y-%m-%dT%H:%M:%SZ", "%Y-%m-%d %H:%M"),
    *("%d.%m.%Y %H:%M:%S", "%d.%m.%Y %H:%M:%S,%f", "%d/%m/%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S"),
    *("%m/%d/%Y %I:%M:%S %p", "%d-%m-%Y %H:%M:%S", "%Y/%m/%d %H:%M:%S.%f", "%d-%b-%Y %H:%M:%S"),
    *("%d.%m.%y %H:%M", "%Y%m%d %H%M%S", "%Y-%m-%d %H:%M:%S UTC", "%Y-%m-%d %H:%M:%S%z"),
    *("epoch_s", "epoch_s.f", "epoch_ms", "epoch_us", "epoch_ns", "excel_days"),
)
NAMED = (("Tag", "Value"), ("Kanal", "Wert"))
SPLIT = (("%d.%m.%Y", "%H:%M:%S"), ("%d/%m/%Y", "%H:%M:%S.%f"), ("%Y-%m-%d", "%H:%M"))


@st.composite
def labels(draw: st.DrawFn) -> dict[str, Label]:
    channels = ["oil_temperature", "speed", "leakage_flow"]
    ports = draw(st.booleans())
    channels += ["high_port_pressure", "low_port_pressure"] if ports else ["pressure_difference"]
    found = {}
    for channel in channels:
        unit, spelled = draw(st.sampled_from(SPELLED[QUANTITY[channel]]))
        found[channel] = Label(draw(st.sampled_from(NAMES[channel])), unit, spelled)
    return found


@st.composite
def dialects(draw: st.DrawFn) -> TextLog:
    separator = draw(st.sampled_from(",;\t|"))
    decimal = draw(st.sampled_from("." if separator == "," else ".,"))
    marks = {".", ",", "'", " ", "\u00a0"} - {separator, decimal}
    encoding = draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "cp1252"]))
    clock = ""
    form = draw(st.sampled_from(TIMES))
    if draw(st.integers(0, 3)) == 0:
        form, clock = draw(st.sampled_from(SPLIT))
    found = draw(labels())
    lines = ["Logger 7 of the mill", "Nr.: 4711", "", f"Anlage{separator}Presse 3", "Öl VG 68"]
    return TextLog(
        labels=found,
        layout=draw(st.sampled_from(["wide", "wide", "long", "file_per_channel"])),
        separator=separator,
        decimal=decimal,
        thousands=draw(st.sampled_from(["", *sorted(marks)])),
        encoding=encoding,
        line_end=draw(st.sampled_from(["\n", "\r\n", "\r"])),
        preamble=draw(st.lists(st.sampled_from(lines), max_size=3)),
        time=form,
        clock=clock,
        time_name=draw(st.sampled_from(["time", "Timestamp", "Zeit", "Datum", "Date"])),
        clock_name=draw(st.sampled_from(["Uhrzeit", "clock", "time of day"])),
        units=draw(st.sampled_from(["name", "word", "row", "nowhere"])),
        columns=draw(st.permutations(["time", "extra", *found])),
        missing=draw(st.sampled_from(["", "---", "Bad", "ERR"])),
        quoted=draw(st.booleans()),
        digits=draw(st.integers(4, 6)),
        names=dict(zip(("channel", "value"), draw(st.sampled_from(NAMED)), strict=True)),
    )


MEANS = {"pressure": 200.0, "temperature": 50.0, "speed": 30.0, "flow": 2.0}


@st.composite
def recordings(draw: st.DrawFn, dialect: TextLog) -> tuple[list[datetime], dict[str, list[Any]]]:
    count = draw(st.integers(12, 30))
    day = draw(st.dates(datetime(2002, 1, 1).date(), datetime(2026, 6, 1).date()))
    start = datetime(day.year, day.month, day.day, draw(st.integers(0, 23)), tzinfo=UTC)
    fraction = "%f" in dialect.time + dialect.clock or dialect.time in ("epoch_s.f", "epoch_ms")
    times = times_of(count, start, 0.2 if fraction else 60.0)
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    samples: dict[str, list[Any]] = {}
    for channel in dialect.labels:
        mean = MEANS[QUANTITY[channel]] * (0.1 if channel == "low_port_pressure" else 1.0)
        samples[channel] = (mean * rng.uniform(0.8, 1.2, count)).tolist()
        if dialect.layout == "wide":
            samples[channel][int(rng.integers(1, count))] = None
    return times, samples


def written(folder: Path, dialect: TextLog, times: Any, samples: Any) -> list[Path]:
    if dialect.layout == "file_per_channel":
        return [
            log_in(
                folder,
                of_one_channel(dialect, times, samples, channel),
                f"{dialect.labels[channel].name} {times[0]:%Y%m%d}.csv",
            )
            for channel in dialect.labels
        ]
    make = wide if dialect.layout == "wide" else lambda *one: long(*one, grouped=True)
    return [log_in(folder, make(dialect, times, samples))]


def told(toml: str, form: str, unit_by_channel: Mapping[str, str]) -> str:
    """The suggestion with what it asks answered, where the answer is among those it shows."""
    found = re.search(DAY_OR_MONTH, toml)
    if found is not None:
        first = tomllib.loads(toml)["logs"]["time_format"]
        assert form in (first, *re.findall(r'with "([^"]*)"', toml))
        toml = toml.replace(f'"{first}"', f'"{form}"', 1)
    for channel, unit in unit_by_channel.items():
        asked = rf'(\[channels\.{channel}\]\nsource = .*\n)unit = "[^"]*"(?=  # the log does not)'
        toml = re.sub(asked, rf'\1unit = "{unit}"', toml)
    return toml


@settings(max_examples=60)
@given(st.data())
def test_any_dialect_reads_back_what_was_written(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    dialect = data.draw(dialects())
    times, samples = data.draw(recordings(dialect))
    if dialect.layout == "file_per_channel" and dialect.units != "row":
        # Neither the name of the file nor that of the column says the unit.
        dialect = replace(dialect, units="row")
    if dialect.layout == "long" and dialect.units == "row":
        dialect = replace(dialect, units="name")
    folder = tmp_path_factory.mktemp("any")
    path, *_ = written(folder, dialect, times, samples)
    form = f"{dialect.time} {dialect.clock}".strip()
    units = {channel: label.unit for channel, label in dialect.labels.items()}
    toml = told(suggest(path), form, units)
    logs = list(read_as_suggested(folder, path, toml).values())
    factors = [in_unit(1.0, one.unit) - in_unit(0.0, one.unit) for one in dialect.labels.values()]
    require_same(logs, times, samples, tolerance=10.0**-dialect.digits / min(factors))


@settings(max_examples=20)
@given(st.data())
def test_any_parquet_reads_back_what_was_written(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """Wide, nested or a row a sample; figures of any type; units in names or in the metadata."""
    draw = data.draw
    layout = draw(st.sampled_from(["wide", "nested", "long"]))
    dialect = TextLog(draw(labels()), layout, units=draw(st.sampled_from(["name", "word"])))
    times, samples = draw(recordings(dialect))
    number = draw(st.sampled_from([pa.float64(), pa.float32(), pa.decimal128(18, 6)]))
    columns = columns_of(samples, dialect)
    columns = {name: one.cast(number, safe=False) for name, one in columns.items()}
    stamps = PARQUET_TIMES[draw(st.sampled_from(["typed", "naive", "epoch_ms", "epoch_s", "text"]))]
    us = us_of(times)
    if layout == "long":
        names = [name for name in columns for _ in times]
        values = pa.concat_arrays(columns.values())
        table = stamps(us * len(columns)) | {"tag": pa.array(names), "value": values}
    elif layout == "nested":
        inner = pa.StructArray.from_arrays(list(columns.values()), names=list(columns))
        table = stamps(us) | {"drive": inner, "note": pa.array(["x"] * len(us))}
    else:
        table = columns | stamps(us) | {"shift": pa.array(range(len(us)))}
    path = log_in(tmp_path_factory.mktemp("any"), b"", "log.parquet")
    pq.write_table(pa.table(table), path, row_group_size=draw(st.integers(5, 1000)))
    units = {channel: label.unit for channel, label in dialect.labels.items()}
    toml = told(suggest(path), "", units)
    logs = list(read_as_suggested(path.parents[2], path, toml).values())
    require_same(logs, times, samples, tolerance=2e-4)


MAGIC = [b"", b"PAR1", b"\x89MCAP0\r\n", b"\xff\xfe", b"time;dp\n2025-03-01 06:00:00;1\n"]


@settings(max_examples=60)
@given(st.sampled_from(MAGIC), st.binary(max_size=400))
def test_any_bytes_are_refused_in_words_or_give_toml(
    tmp_path_factory: pytest.TempPathFactory, magic: bytes, data: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "bytes"
    path.write_bytes(magic + data + magic[:4] * (magic == b"PAR1"))
    with contextlib.suppress(LogError):
        tomllib.loads(suggest(path))
