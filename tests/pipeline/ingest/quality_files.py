"""The same samples, with their quality, in every format and layout."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.ingest import RawLog, read_log
from pipeline.ingest.conformance import T0_US

from .mcap.protobuf_files import (
    Field,
    class_of,
    declared,
    field_of,
    made_of,
    protobuf,
    set_of,
)
from .mcap_files import TOPIC, mcap_bytes
from .sources import Source, changed, column
from .writers import iso

SPEED = column("n", "rpm", quality_source="quality")
PRESSURE = column("dp", "bar", quality_source="quality")


@dataclass(frozen=True)
class Case:
    """A cell, its quality, and whether the sample is bad; by the words of the config."""

    value: float | None
    quality: str | float | None
    is_bad: bool


# OPC DA 3.00, 6.8: 192 good, 216 forced by hand, 64 uncertain, 24 no connection, 0 bad.
CASES = (
    Case(1.0, "Good", False),
    Case(2.0, " GOOD", False),
    Case(3.0, 192, False),
    Case(4.0, "Bad", True),
    Case(5.0, "Uncertain", True),
    Case(6.0, 216, True),
    Case(7.0, 0, True),
    Case(8.0, None, True),  # a value of which nobody says that it is good
    Case(None, 24, True),  # no value, and the log says why
    Case(None, "Bad", True),
    Case(None, "Good", False),
    Case(None, None, False),  # no sample at all
    Case(9.0, "good", False),
)
NUMBERS = tuple(
    replace(case, quality={"Good": 192, " GOOD": 192, "good": 192, "Bad": 8}.get(case.quality, 64))
    if isinstance(case.quality, str)
    else case
    for case in CASES
)
EXPECTED = [case.is_bad for case in CASES]


def read(written: tuple[Path, Source]) -> RawLog:
    path, source = written
    return read_log(path, *source)


def stamps() -> pa.Array:
    return pa.array([T0_US + i for i in range(len(CASES))], pa.timestamp("us", "UTC"))


def text(cell: object) -> str:
    return "" if cell is None else str(cell)


def csv_lines(head: str, row: Callable[[Case], str]) -> str:
    rows = [f"{iso(T0_US + i)}Z,{row(case)}" for i, case in enumerate(CASES)]
    return "\n".join([f"time,{head}", *rows, ""])


def wide_csv(folder: Path) -> tuple[Path, Source]:
    path = folder / "log.csv"
    path.write_text(csv_lines("n,quality,x", lambda c: f"{text(c.value)},{text(c.quality)},1"))
    return path, Source.of("csv", {"speed": SPEED})


def long_csv(folder: Path) -> tuple[Path, Source]:
    path = folder / "log.csv"
    lines = csv_lines("channel,value,quality", lambda c: f"n,{text(c.value)},{text(c.quality)}")
    others = [f"{iso(T0_US + i)}Z,dp,{i},Bad\n" for i in range(5)]
    path.write_text(lines + "".join(others))
    other = column("dp", "bar")
    channels = {"speed": SPEED, "pressure_difference": other}
    return path, Source.of("csv", channels, layout="long")


def table(cases: tuple[Case, ...], kind: pa.DataType) -> pa.Table:
    as_text = pa.types.is_string(kind)
    cells = [c.quality if c.quality is None or not as_text else str(c.quality) for c in cases]
    return pa.table(
        {
            "time": stamps(),
            "n": pa.array([c.value for c in cases], pa.float64()),
            "quality": pa.array(cells, kind),
        }
    )


def wide_parquet(
    cases: tuple[Case, ...], kind: pa.DataType, *, encoded: bool = False
) -> Callable[[Path], tuple[Path, Source]]:
    def write(folder: Path) -> tuple[Path, Source]:
        path = folder / "log.parquet"
        content = table(cases, kind)
        if encoded:
            content = content.set_column(2, "quality", content["quality"].dictionary_encode())
        pq.write_table(content, path, row_group_size=4)
        return path, Source.of("parquet", {"speed": SPEED})

    return write


def long_parquet(folder: Path) -> tuple[Path, Source]:
    flat = table(CASES, pa.string())
    n = len(CASES)
    rows = pa.table(
        {
            "time": pa.concat_arrays([stamps(), stamps()]),
            "channel": ["n"] * n + ["dp"] * n,
            "value": pa.concat_arrays([flat["n"].combine_chunks(), pa.array([1.0] * n)]),
            "quality": pa.concat_arrays([flat["quality"].combine_chunks(), pa.nulls(n, "string")]),
        }
    )
    path = folder / "log.parquet"
    pq.write_table(rows, path, row_group_size=5)
    other = column("dp", "bar")
    channels = {"speed": SPEED, "pressure_difference": other}
    return path, Source.of("parquet", channels, layout="long")


def json_mcap(cases: tuple[Case, ...]) -> Callable[[Path], tuple[Path, Source]]:
    def write(folder: Path) -> tuple[Path, Source]:
        messages = [
            ("/n", (T0_US + i) * 1000, json.dumps({"value": c.value, "q": {"code": c.quality}}))
            for i, c in enumerate(cases)
        ]
        path = folder / "log.mcap"
        path.write_bytes(mcap_bytes([(topic, at, data.encode()) for topic, at, data in messages]))
        speed = changed(SPEED, source="/n", quality_source="/n.q.code")
        return path, Source.of("mcap", {"speed": speed})

    return write


def protobuf_mcap(folder: Path) -> tuple[Path, Source]:
    """Fields that say whether they are set."""
    fields = [field_of("value", Field.TYPE_DOUBLE), field_of("quality", Field.TYPE_UINT32)]
    descriptors = set_of("proto2", declared("Hydraulics", fields, "proto2"))
    made, payloads = class_of(descriptors), []
    for case in NUMBERS:
        given = {"value": case.value, "quality": case.quality}
        payloads.append(made_of(made, {k: one for k, one in given.items() if one is not None}))
    path = folder / "log.mcap"
    path.write_bytes(protobuf(payloads, descriptors, chunk_size=200))
    return path, Source.of("mcap", {"speed": changed(SPEED, source=TOPIC)})


EVERY_WAY = {
    "csv": wide_csv,
    "csv-long": long_csv,
    "parquet-text": wide_parquet(CASES, pa.string()),
    "parquet-dictionary": wide_parquet(CASES, pa.string(), encoded=True),
    "parquet-float32": wide_parquet(NUMBERS, pa.float32()),
    "parquet-long": long_parquet,
    "mcap-json-mixed": json_mcap(CASES),
    "mcap-protobuf": protobuf_mcap,
}
every_way = pytest.mark.parametrize("write", EVERY_WAY.values(), ids=EVERY_WAY.keys())
