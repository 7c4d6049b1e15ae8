"""Arrays that grow: the same as all pieces joined in the end."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.ingest.assembly import Readings
from pipeline.ingest.contract import ChannelSource
from pipeline.ingest.gathering import GatheredReadings, GatheredStamps, Growing
from pipeline.ingest.time_stamps import WrittenStamps

pieces = st.lists(st.lists(st.floats(allow_nan=False, width=32), max_size=9), max_size=9)


@given(pieces, st.integers(0, 50))
def test_pieces_of_any_size_one_after_the_other(lists: list[list[float]], expected: int) -> None:
    array: Growing[np.float64] = Growing(np.float64, expected)
    stamps = GatheredStamps(expected)
    for piece in lists:
        here = array.append(np.array(piece))
        assert here.tolist() == piece
        times = np.arange(len(piece), dtype=np.int64)
        stamps.add(WrittenStamps(times, np.full(times.size, 2, dtype=np.int8)))
    assert array.values.tolist() == [one for piece in lists for one in piece]
    assert stamps.stamps().time_us.tolist() == [i for piece in lists for i in range(len(piece))]
    assert stamps.stamps().kind.tolist() == [2] * array.values.size


@given(st.lists(st.lists(st.sampled_from([1.0, None, "?"]), max_size=5), max_size=6))
def test_marks_stay_with_their_readings(lists: list[list[float | str | None]]) -> None:
    channel = ChannelSource("oil_temperature", "T", "degF", scale=9.0, offset=23.0)
    as_written, converted = GatheredReadings(None), GatheredReadings(channel)
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
        readings = gathered.readings()
        expected = [value if cell == 1.0 else np.nan for cell in cells]
        np.testing.assert_array_equal(readings.raw, expected)
        assert readings.missing.tolist() == [cell != 1.0 for cell in cells]
        assert readings.unparsed.tolist() == [cell == "?" for cell in cells]
        assert readings.example == ("?" if "?" in cells else None)
