"""Quality of samples as a log states it, the same in every format and layout."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import pipeline.ingest.mcap.log
from pipeline.config.channels import Channels
from pipeline.errors import LogError
from pipeline.ingest import RawChannel, read_log
from pipeline.ingest.cells import quality_states
from pipeline.ingest.conformance import T0_US
from tests.dialects import Csv

from .mcap.protobuf_files import class_of, made_of, protobuf, set_of
from .mcap_files import TOPIC, mcap_of
from .sources import Source, changed, column
from .test_csv import in_pieces

SPEED = column("n", "rpm", quality_source="quality")
PRESSURE = column("dp", "bar", quality_source="quality")
# A cell, its quality, and whether the sample is bad. OPC DA 3.00, 6.8: 192 good, 216 forced by
# hand, 64 uncertain, 24 no connection, 0 bad.
CASES: tuple[tuple[float | None, str | int | None, bool], ...] = (
    (1.0, "Good", False),
    (2.0, " GOOD", False),
    (3.0, 192, False),
    (4.0, "Bad", True),
    (5.0, "Uncertain", True),
    (6.0, 216, True),
    (7.0, 0, True),
    (8.0, None, True),  # a value of which nobody says that it is good
    (None, 24, True),  # no value, and the log says why
    (None, "Bad", True),
    (None, "Good", False),
    (None, None, False),  # no sample at all
    (9.0, "good", False),
)
VALUES = [value for value, _, _ in CASES]
MIXED = [quality for _, quality, _ in CASES]
TEXTS = [None if one is None else str(one) for one in MIXED]
WORDS = {"Good": 192, " GOOD": 192, "good": 192, "Bad": 8, "Uncertain": 64}
CODES = [WORDS.get(one, 0) if isinstance(one, str) else one for one in MIXED]
EXPECTED = [is_bad for _, _, is_bad in CASES]

Columns = Mapping[str, Any]
Way = Callable[[Path], Source]
"""Writes a log of the cases to a path."""


def long(quality: Sequence[Any]) -> Columns:
    """With rows of another channel, in each of which the quality is bad."""
    count = len(CASES)
    return {
        "channel": ["n"] * count + ["dp"] * count,
        "value": [*VALUES, *[1.0] * count],
        "quality": [*quality, *["Bad"] * count],
    }


def table(kind: str, columns: Columns, layout: str = "wide") -> Way:
    def write(path: Path) -> Source:
        time_us = T0_US + np.arange(len(columns["quality"])) % len(CASES)
        if kind == "csv":
            Csv(written_zone="UTC").table(path, time_us, columns)
        else:
            stamps = pa.array(time_us, pa.timestamp("us", "UTC"))
            pq.write_table(pa.table({"time": stamps, **columns}), path, row_group_size=4)
        others: Channels = {"pressure_difference": column("dp", "bar")} if layout == "long" else {}
        return Source.of(kind, {"speed": SPEED, **others}, layout=layout)

    return write


def json_mcap(qualities: Sequence[Any]) -> Way:
    def write(path: Path) -> Source:
        cells = zip(VALUES, qualities, strict=True)
        payloads = [json.dumps({"value": one, "q": {"code": told}}).encode() for one, told in cells]
        path.write_bytes(mcap_of(payloads))
        speed = changed(SPEED, source=TOPIC, quality_source=f"{TOPIC}.q.code")
        return Source.of("mcap", {"speed": speed})

    return write


def protobuf_mcap(path: Path) -> Source:
    """Fields that say whether they are set."""
    descriptors = set_of("proto2", Hydraulics="double value; uint32 quality")
    made, cells = class_of(descriptors), zip(VALUES, CODES, strict=True)
    given = [{"value": one, "quality": told} for one, told in cells]
    path.write_bytes(protobuf([made_of(made, one) for one in given], descriptors, chunk_size=200))
    return Source.of("mcap", {"speed": changed(SPEED, source=TOPIC)})


EVERY_WAY = {
    "csv": table("csv", {"n": VALUES, "quality": TEXTS}),
    "csv-long": table("csv", long(TEXTS), "long"),
    "parquet-text": table("parquet", {"n": VALUES, "quality": TEXTS}),
    "parquet-dictionary": table(
        "parquet", {"n": VALUES, "quality": pa.array(TEXTS).dictionary_encode()}
    ),
    "parquet-float32": table("parquet", {"n": VALUES, "quality": pa.array(CODES, pa.float32())}),
    "parquet-long": table("parquet", long(TEXTS), "long"),
    "mcap-json-text": json_mcap(TEXTS),
    "mcap-json-mixed": json_mcap(MIXED),
    "mcap-protobuf": protobuf_mcap,
}
every_way = pytest.mark.parametrize("write", EVERY_WAY.values(), ids=EVERY_WAY.keys())


def bad_of(write: Way, path: Path) -> list[bool]:
    bad = read_log(path, *write(path)).channels["speed"].bad_quality
    assert bad is not None
    return list(bad.tolist())


@every_way
def test_what_the_log_does_not_call_good_is_bad(write: Way, tmp_path: Path) -> None:
    source = write(tmp_path / "log")
    log = read_log(tmp_path / "log", *source)
    others = dict(log.channels)
    speed = others.pop("speed")
    assert speed.bad_quality is not None
    assert speed.bad_quality.tolist() == EXPECTED
    assert speed.missing.tolist() == [value is None for value in VALUES]
    assert speed.value[~speed.missing].tolist() == [float(i) for i in range(1, 10)]
    assert not speed.bad_quality.flags.writeable
    assert all(other.bad_quality is None for other in others.values())
    kwality = changed(source.channels["speed"], quality_source="kwality")
    with pytest.raises(LogError, match="'kwality'"):
        read_log(tmp_path / "log", *source.but({**source.channels, "speed": kwality}))


@pytest.mark.parametrize("piece", [120, 200, 2**24])
def test_pieces_of_a_file_change_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, piece: int
) -> None:
    in_pieces(monkeypatch, piece)
    monkeypatch.setattr(pipeline.ingest.mcap.log, "_PIECE", piece)
    for write in (EVERY_WAY["csv"], json_mcap(MIXED), protobuf_mcap):
        assert bad_of(write, tmp_path / "log") == EXPECTED


def test_a_night_of_texts_that_are_all_called_bad_is_no_wrong_column(tmp_path: Path) -> None:
    """Texts as a historian writes them while its source is down; an error without a quality."""
    path = tmp_path / "log.csv"
    source = table("csv", {"n": ["I/O Timeout"] * len(CASES), "quality": ["Bad"] * len(CASES)})(
        path
    )
    speed = read_log(path, *source).channels["speed"]
    assert speed.unparsed == len(CASES)
    assert speed.bad_quality is not None
    assert speed.bad_quality.all()
    with pytest.raises(LogError) as raised:
        read_log(path, *source.but({"speed": column("n", "rpm")}))
    assert raised.value.code == "log_type"


@pytest.mark.parametrize(
    ("cells", "good", "bad"),
    [
        (pa.array([True, False, None]), (True,), [False, True, True]),
        (pa.array([1, 0, None]), (True,), [False, True, True]),
        (pa.array([True, False]), (1,), [False, True]),
        (pa.array(["true", "no"]), (True,), [False, True]),
        (pa.array([0, 192], pa.uint8()), (0,), [False, True]),
        (pa.array([0.0, -0.0, np.nan]), (0,), [False, False, True]),
        (pa.array([Decimal("192.00"), Decimal("19.2")]), (192,), [False, True]),
        (pa.array(["192.0", "+192", "1.92e2", "0xC0"]), (192,), [False] * 3 + [True]),
        (pa.array(["1_92", "١٩٢", "192_", "192"]), (192,), [True] * 3 + [False]),
        (pa.array(["0xc0", "C0"]), ("0xC0",), [False, True]),
        (pa.array(["", " ", None, "Good"]), ("",), [False, False, False, True]),
        (pa.array([100, 0]), (100.0,), [False, True]),
        (pa.array([2**63 - 1]), (192,), [True]),
        (pa.nulls(2), (192,), [True, True]),
        (pa.array(["a", "b"]).cast(pa.large_string()), ("A",), [False, True]),
    ],
    ids=lambda value: str(getattr(value, "type", value)),
)
def test_qualities_of_every_type(cells: pa.Array, good: Any, bad: list[bool]) -> None:
    """Beside a value: a blank is then bad, too, unless it stands for good."""
    states = quality_states(Path("log"), "quality", cells, good)
    assert (states != 0).tolist() == bad


@pytest.mark.parametrize(
    "cells",
    [
        pa.array([[1]]),
        pa.array([T0_US], pa.timestamp("us")),
        pa.array([b"Good"]),
        pa.array(np.arange(5000.0)),
    ],
    ids=lambda cells: str(cells.type),
)
def test_what_is_no_quality(tmp_path: Path, cells: pa.Array) -> None:
    path = tmp_path / "log.parquet"
    times = pa.array([T0_US + i for i in range(len(cells))], pa.timestamp("us", "UTC"))
    pq.write_table(pa.table({"time": times, "n": [1.0] * len(cells), "quality": cells}), path)
    with pytest.raises(LogError, match=r"log\.parquet, quality: ") as raised:
        read_log(path, *Source.of("parquet", {"speed": SPEED}))
    assert raised.value.code == "log_type"


def test_parts_of_a_channel_are_joined_with_their_quality() -> None:
    some = RawChannel(np.arange(2), np.ones(2), np.zeros(2, np.bool_), 1)
    judged = replace(some, bad_quality=np.array([True, False]))
    both = RawChannel.join([judged, some])
    assert both.bad_quality is not None
    assert both.bad_quality.tolist() == [True, False, False, False]
    assert both.unparsed == 2
    assert RawChannel.join([some, some]).bad_quality is None
