"""Readings and stamps that are gathered as a log is read in pieces, each copied once.

Lists of pieces that are joined in the end would hold everything twice for a moment, and each piece
would need memory of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.ingest.assembly import Readings
from pipeline.ingest.time_stamps import WITH_ZONE, WrittenStamps

_T = TypeVar("_T", bound=np.generic)


class Growing(Generic[_T]):
    """An array that grows at its end, where it lies; a lone piece is kept as it is.

    Examples
    --------
    >>> array = Growing(np.int64)
    >>> for piece in ([1, 2], [3], [4, 5, 6]):
    ...     array.append(np.array(piece))
    >>> array.taken().tolist()
    [1, 2, 3, 4, 5, 6]
    """

    def __init__(self, dtype: type[_T]) -> None:
        self._array: NDArray[_T] = np.empty(0, dtype)
        self._size = 0
        self._is_own = False  # not a piece

    def append(self, piece: NDArray[_T]) -> None:
        """Add a piece at the end."""
        begin, self._size = self._size, self._size + piece.size
        if not begin:
            self._array = piece
            return
        if not self._is_own:
            first, self._array = self._array, np.empty(2 * self._size, piece.dtype)
            self._array[:begin] = first
            self._is_own = True
        elif self._size > self._array.size:
            # A large array is moved by its pages, not copied, and room costs nothing till used.
            self._array.resize(2 * self._size, refcheck=False)
        self._array[begin : self._size] = piece

    def taken(self) -> NDArray[_T]:
        """All elements, to be given up; room that was not needed goes back."""
        if self._is_own:
            self._array.resize(self._size, refcheck=False)
        return self._array


class GatheredStamps:
    """Time stamps as they are written, piece after piece."""

    def __init__(self) -> None:
        self._time_us = Growing(np.int64)
        self._kinds: list[NDArray[np.int8]] = []
        self._example: str | None = None

    def add(self, part: WrittenStamps) -> None:
        """Add a piece."""
        self._time_us.append(part.time_us)
        self._kinds.append(part.kind)
        self._example = self._example or part.example

    def taken(self) -> WrittenStamps:
        """All of them, to be given up."""
        kinds = _joined(self._kinds, np.int8(WITH_ZONE))
        return WrittenStamps(self._time_us.taken(), kinds, self._example)


class GatheredReadings:
    """Readings of a column or field, piece after piece."""

    def __init__(self) -> None:
        self._raw = Growing(np.float64)
        self._missing: list[NDArray[np.bool_]] = []
        self._unparsed: list[NDArray[np.bool_]] = []
        self._example: str | None = None

    def add(self, part: Readings) -> None:
        """Add a piece."""
        self._raw.append(part.raw)
        self._missing.append(part.missing)
        self._unparsed.append(part.unparsed)
        self._example = self._example or part.example

    @property
    def has_none(self) -> bool:
        """True if there are messages or rows, and nothing at all in any."""
        marks = zip(self._missing, self._unparsed, strict=True)
        return bool(self._missing) and all(gone.all() and not odd.any() for gone, odd in marks)

    def taken(self) -> Readings:
        """All of them, to be given up."""
        missing = _joined(self._missing, np.bool_(False))
        unparsed = _joined(self._unparsed, np.bool_(False))
        return Readings(self._raw.taken(), missing, unparsed, self._example)


def _joined(parts: Sequence[NDArray[_T]], usual: _T) -> NDArray[_T]:
    """Marks one after the other; in most logs all are the same, which needs no copy."""
    if all((part == usual).all() for part in parts):
        return np.full(sum(part.size for part in parts), usual)
    return np.concatenate(parts)
