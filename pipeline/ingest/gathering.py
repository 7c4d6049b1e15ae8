"""Arrays that grow as a log is read in pieces: each figure is copied once, and held once.

Lists of pieces that are joined in the end would hold everything twice for a moment, and leave holes
in the memory behind them.
"""

from __future__ import annotations

from typing import Generic, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from pipeline.ingest.assembly import Readings, convert_in_place
from pipeline.ingest.contract import ChannelSource
from pipeline.ingest.time_stamps import WrittenStamps

_T = TypeVar("_T", bound=np.generic)


class Growing(Generic[_T]):
    """An array that grows at its end.

    Parameters
    ----------
    dtype
        Of its elements.
    expected
        How many there will be, roughly: of memory only what is written to is used.

    Examples
    --------
    >>> array = Growing(np.int64, 2)
    >>> for piece in ([1, 2], [3], [4, 5, 6]):
    ...     _ = array.append(np.array(piece))
    >>> array.values.tolist()
    [1, 2, 3, 4, 5, 6]
    """

    def __init__(self, dtype: DTypeLike, expected: int = 0) -> None:
        self._array: NDArray[_T] = np.empty(expected, dtype)
        self._size = 0

    def append(self, piece: NDArray[_T]) -> NDArray[_T]:
        """Copy a piece to the end; returns where it is now, until the next one comes."""
        begin, end = self._size, self._size + piece.size
        if end > self._array.size:
            larger: NDArray[_T] = np.empty(max(end, 2 * self._array.size), self._array.dtype)
            larger[:begin] = self._array[:begin]
            self._array = larger
        self._array[begin:end] = piece
        self._size = end
        return self._array[begin:end]

    @property
    def values(self) -> NDArray[_T]:
        """All elements."""
        return self._array[: self._size]


class GatheredStamps:
    """Time stamps as they are written, piece after piece.

    Parameters
    ----------
    expected
        As of `Growing`.
    """

    def __init__(self, expected: int = 0) -> None:
        self._time_us: Growing[np.int64] = Growing(np.int64, expected)
        self._kind: Growing[np.int8] = Growing(np.int8, expected)
        self._example: str | None = None

    def add(self, part: WrittenStamps) -> None:
        """Add a piece."""
        self._example = self._example or part.example
        self._time_us.append(part.time_us)
        self._kind.append(part.kind)

    def stamps(self) -> WrittenStamps:
        """All of them."""
        return WrittenStamps(self._time_us.values, self._kind.values, self._example)


class GatheredReadings:
    """Readings of a channel, piece after piece.

    Parameters
    ----------
    channel
        Into whose canonical unit they are converted; None: they stay as they stand.
    expected
        As of `Growing`.
    """

    def __init__(self, channel: ChannelSource | None, expected: int = 0) -> None:
        self._channel = channel
        self._raw: Growing[np.float64] = Growing(np.float64, expected)
        self._missing = _Marks(expected)
        self._unparsed = _Marks(expected)
        self._example: str | None = None

    def add(self, part: Readings) -> None:
        """Add a piece."""
        raw = self._raw.append(part.raw)
        if self._channel is not None:
            convert_in_place(self._channel, raw)
        self._missing.add(part.missing)
        self._unparsed.add(part.unparsed)
        if self._example is None:
            self._example = part.example

    def readings(self) -> Readings:
        """All of them."""
        return Readings(
            self._raw.values, self._missing.values(), self._unparsed.values(), self._example
        )


class _Marks:
    """Marks of which most are not set: zeros that are never written take no memory."""

    def __init__(self, expected: int) -> None:
        self._expected = expected
        self._size = 0
        self._marks: Growing[np.bool_] | None = None

    def add(self, marks: NDArray[np.bool_]) -> None:
        if self._marks is None and marks.any():
            self._marks = Growing(np.bool_, max(self._expected, self._size + marks.size))
            self._marks.append(np.zeros(self._size, dtype=np.bool_))
        if self._marks is not None:
            self._marks.append(marks)
        self._size += marks.size

    def values(self) -> NDArray[np.bool_]:
        return np.zeros(self._size, dtype=np.bool_) if self._marks is None else self._marks.values
