"""Arrays that grow as a log is read in pieces: each figure is copied once, and held once.

Lists of pieces that are joined in the end would hold everything twice for a moment, and leave holes
in the memory behind them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.ingest.assembly import Readings
from pipeline.ingest.time_stamps import WITH_ZONE, WrittenStamps

_T = TypeVar("_T", bound=np.generic)

_FIRST_ROOM = 2**12
_MOST_ROOM = 2**18
_MOST_EXPECTED = 2**24
"""Two days at 100 Hz; what a file claims beyond that is believed when it comes."""


class Growing(Generic[_T]):
    """An array that grows at its end, where it lies.

    Room is made for about as many elements as expected; memory is used by those that are written.
    A first piece that is all that is expected is kept as it is.

    Examples
    --------
    >>> array = Growing(np.int64, 2)
    >>> for piece in ([1, 2], [3], [4, 5, 6]):
    ...     _ = array.append(np.array(piece))
    >>> array.taken().tolist()
    [1, 2, 3, 4, 5, 6]
    """

    def __init__(self, dtype: type[_T], expected: int = 0) -> None:
        self._expected = min(expected, _MOST_EXPECTED)
        self._array: NDArray[_T] = np.empty(max(self._expected, _FIRST_ROOM), dtype)
        self._size = 0

    def append(self, piece: NDArray[_T]) -> None:
        """Add a piece at the end."""
        begin, end, room = self._size, self._size + piece.size, self._array.size
        self._size = end
        if not begin and piece.size >= self._expected > 0:
            self._array = piece
            return
        if end > room:
            if not self._array.flags.owndata or not self._array.flags.writeable:
                self._array = self._array.copy()
            # Small steps cost little: a large array is moved by its pages, not copied.
            self._array.resize(max(end, room + min(room // 8, _MOST_ROOM)), refcheck=False)
        self._array[begin:end] = piece

    def taken(self) -> NDArray[_T]:
        """All elements, to be given up; room that was not needed goes back."""
        array, self._array = self._array, np.empty(0, self._array.dtype)
        if array.size != self._size:
            array.resize(self._size, refcheck=False)
        self._size = 0
        return array


class GatheredStamps:
    """Time stamps as they are written, piece after piece."""

    def __init__(self, expected: int = 0) -> None:
        self._time_us = Growing(np.int64, expected)
        self._kind = _Marks(np.int8(WITH_ZONE), expected)
        self._example: str | None = None

    def add(self, part: WrittenStamps) -> None:
        """Add a piece."""
        self._time_us.append(part.time_us)
        self._kind.append(part.kind)
        self._example = self._example or part.example

    def taken(self) -> WrittenStamps:
        """All of them, to be given up."""
        return WrittenStamps(self._time_us.taken(), self._kind.taken(), self._example)


class GatheredReadings:
    """Readings of a channel or field, piece after piece, each converted."""

    def __init__(
        self,
        convert: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None,
        expected: int = 0,
    ) -> None:
        self._convert = convert
        self._raw = Growing(np.float64, expected)
        self._missing: _Marks[np.bool_] = _Marks(np.bool_(False), expected)
        self._unparsed: _Marks[np.bool_] = _Marks(np.bool_(False), expected)
        self._example: str | None = None

    def add(self, part: Readings) -> None:
        """Add a piece."""
        self._raw.append(part.raw if self._convert is None else self._convert(part.raw))
        self._missing.append(part.missing)
        self._unparsed.append(part.unparsed)
        self._example = self._example or part.example

    def taken(self) -> Readings:
        """All of them, to be given up."""
        marks = self._missing.taken(), self._unparsed.taken()
        return Readings(self._raw.taken(), *marks, self._example)


class _Marks(Generic[_T]):
    """Values one after the other, which take no memory as long as all are the same."""

    def __init__(self, usual: _T, expected: int) -> None:
        self._usual = usual
        self._expected = expected
        self._marks: Growing[_T] | None = None
        self._size = 0

    def append(self, marks: NDArray[_T]) -> None:
        if self._marks is None and (marks != self._usual).any():
            self._marks = Growing(type(self._usual), self._expected)
            self._marks.append(np.full(self._size, self._usual))
        if self._marks is not None:
            self._marks.append(marks)
        self._size += marks.size

    def taken(self) -> NDArray[_T]:
        """All of them, to be given up."""
        if self._marks is not None:
            return self._marks.taken()
        # Not broadcast: each count of such marks takes ten times as long.
        return np.full(self._size, self._usual)
