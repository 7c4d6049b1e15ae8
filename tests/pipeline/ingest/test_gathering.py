"""Arrays that grow: the same as all pieces joined in the end."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.config import Channel
from pipeline.ingest.assembly import Readings, in_canonical_unit
from pipeline.ingest.gathering import GatheredReadings, GatheredStamps, Growing
from pipeline.ingest.time_stamps import WITH_ZONE, WrittenStamps

pieces = st.lists(st.lists(st.floats(allow_nan=False, width=32), max_size=9), max_size=9)


@given(pieces, st.integers(0, 50))
def test_pieces_of_any_size_one_after_the_other(lists: list[list[float]], expected: int) -> None:
    array = Growing(np.float64, expected)
    stamps = GatheredStamps(expected)
    for piece in lists:
        array.append(np.array(piece))
        times = np.arange(len(piece), dtype=np.int64)
        stamps.add(WrittenStamps(times, np.full(times.size, 2, dtype=np.int8)))
    whole, written = array.taken(), stamps.taken()
    assert whole.tolist() == [one for piece in lists for one in piece]
    assert written.time_us.tolist() == [i for piece in lists for i in range(len(piece))]
    assert written.kind.tolist() == [2] * whole.size
    assert array.taken().size == 0


@given(st.lists(st.lists(st.sampled_from([1.0, None, "?"]), max_size=5), max_size=6))
def test_marks_stay_with_their_readings(lists: list[list[float | str | None]]) -> None:
    channel = Channel(source="T", unit="degF", scale=9.0, offset=23.0)
    convert = partial(in_canonical_unit, "oil_temperature", channel)
    as_written, converted = GatheredReadings(), GatheredReadings(convert)
    for piece in lists:
        raw = np.array([1.0 if cell == 1.0 else np.nan for cell in piece])
        unparsed = np.array([cell == "?" for cell in piece], dtype=np.bool_)
        part = Readings(raw, np.isnan(raw), unparsed, "?" if unparsed.any() else None)
        as_written.add(part)
        converted.add(part)
        assert raw.tolist() == pytest.approx(
            [1.0 if c == 1.0 else np.nan for c in piece], nan_ok=True
        )
    cells = [cell for piece in lists for cell in piece]
    for gathered, value in ((as_written, 1.0), (converted, 0.0)):
        readings = gathered.taken()
        expected = [value if cell == 1.0 else np.nan for cell in cells]
        np.testing.assert_array_equal(readings.raw, expected)
        assert readings.missing.tolist() == [cell != 1.0 for cell in cells]
        assert readings.unparsed.tolist() == [cell == "?" for cell in cells]
        assert readings.example == ("?" if "?" in cells else None)


def test_beyond_any_room_that_was_expected() -> None:
    array = Growing(np.int64, 3)
    for begin in range(0, 100_000, 777):
        array.append(np.arange(begin, begin + 777))
    np.testing.assert_array_equal(array.taken(), np.arange(100_000 // 777 * 777 + 777))


def test_stamps_of_one_kind_until_another_comes() -> None:
    gathered = GatheredStamps()
    for kind in (WITH_ZONE, WITH_ZONE, 1):
        gathered.add(WrittenStamps(np.arange(5), np.full(5, kind, np.int8)))
    assert gathered.taken().kind.tolist() == [WITH_ZONE] * 10 + [1] * 5
