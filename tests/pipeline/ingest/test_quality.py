"""Quality of samples as a log states it, the same in every format and layout."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import pipeline.ingest.mcap.log
from pipeline.errors import LogError
from pipeline.ingest import RawChannel, read_log
from pipeline.ingest.conformance import T0_US
from pipeline.ingest.quality import quality_states
from tests.pipeline.ingest.csv_files import in_pieces
from tests.pipeline.ingest.quality_files import (
    CASES,
    EXPECTED,
    PRESSURE,
    SPEED,
    csv_lines,
    every_way,
    json_mcap,
    protobuf_mcap,
    read,
    text,
    wide_csv,
)

from .sources import Source, changed, column


@every_way
def test_what_the_log_does_not_call_good_is_bad(
    write: Callable[[Path], tuple[Path, Source]], tmp_path: Path
) -> None:
    log = read(write(tmp_path))
    speed = log.channels["speed"]
    assert speed.bad_quality is not None
    assert speed.bad_quality.tolist() == EXPECTED
    assert speed.missing.tolist() == [case.value is None for case in CASES]
    assert speed.value[~speed.missing].tolist() == [float(i) for i in range(1, 10)]
    assert not speed.bad_quality.flags.writeable
    others = [one for name, one in log.channels.items() if name != "speed"]
    assert [one.bad_quality for one in others] == [None] * len(others)


@every_way
def test_a_quality_that_is_not_there_is_named(
    write: Callable[[Path], tuple[Path, Source]], tmp_path: Path
) -> None:
    path, source = write(tmp_path)
    speed = changed(source.channels["speed"], quality_source="kwality")
    with pytest.raises(LogError, match="'kwality'") as raised:
        read_log(path, *source.but({**source.channels, "speed": speed}))
    assert raised.value.code == "log_column_missing"


@pytest.mark.parametrize("piece", [120, 200, 2**24])
def test_pieces_of_a_file_change_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, piece: int
) -> None:
    path, source = wide_csv(tmp_path)
    in_pieces(monkeypatch, piece)
    bad = read_log(path, *source).channels["speed"].bad_quality
    assert bad is not None
    assert bad.tolist() == EXPECTED
    monkeypatch.setattr(pipeline.ingest.mcap.log, "_PIECE", piece)
    for write in (json_mcap(CASES), protobuf_mcap):
        bad = read(write(tmp_path)).channels["speed"].bad_quality
        assert bad is not None
        assert bad.tolist() == EXPECTED


def test_channels_may_share_a_column_and_differ_in_what_is_good(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(csv_lines("n,dp,quality", lambda c: f"1,1,{text(c.quality)}"))
    forced = changed(PRESSURE, quality_good=(192, 216, 0))
    source = Source.of("csv", {"speed": SPEED, "pressure_difference": forced})
    channels = read_log(path, *source).channels
    strict, loose = channels["speed"].bad_quality, channels["pressure_difference"].bad_quality
    assert strict is not None
    assert loose is not None
    answers = [text(case.quality).strip().casefold() for case in CASES]
    assert strict.tolist() == [answer not in ("good", "192") for answer in answers]
    assert loose.tolist() == [answer not in ("192", "216", "0") for answer in answers]


def test_a_night_of_texts_that_are_all_called_bad_is_no_wrong_column(tmp_path: Path) -> None:
    """Texts as a historian writes them while its source is down; an error without a quality."""
    path = tmp_path / "log.csv"
    path.write_text(csv_lines("n,quality", lambda _: "I/O Timeout,Bad"))
    source = Source.of("csv", {"speed": SPEED})
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


@pytest.mark.parametrize("word", ["1_92", "١٩٢", "192_", "0xC0"])
def test_only_plain_digits_are_a_code(word: str) -> None:
    states = quality_states(Path("log"), "quality", pa.array([word, "192"]), (192,))
    assert states.tolist() == [1, 0]


@pytest.mark.parametrize(
    "cells",
    [
        pa.array([[1]]),
        pa.array([{"a": 1}]),
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
    def part(bad: list[bool] | None) -> RawChannel:
        return RawChannel(
            np.arange(2),
            np.ones(2),
            np.zeros(2, np.bool_),
            1,
            None if bad is None else np.array(bad),
        )

    both = RawChannel.joined([part([True, False]), part(None)])
    assert both.bad_quality is not None
    assert both.bad_quality.tolist() == [True, False, False, False]
    assert both.unparsed == 2
    assert RawChannel.joined([part(None), part(None)]).bad_quality is None
    assert both.rows(slice(1, None)).bad_quality is not None
