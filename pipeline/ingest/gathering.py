"""Rows that are gathered as a log is read in pieces, each copied once.

Lists of pieces that are joined in the end would hold everything twice for a moment, and each piece
would need memory of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Rows
from pipeline.config.channels import Channels
from pipeline.ingest.assembly import Readings, raw_channel
from pipeline.ingest.contract import RawChannel
from pipeline.ingest.quality import BLANK
from pipeline.ingest.time_stamps import TimeStamps, WrittenStamps, placed

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


class _Column:
    """Readings of a column or field."""

    def __init__(self) -> None:
        self.raw = Growing(np.float64)
        self.missing, self.unparsed = Growing(np.bool_), Growing(np.bool_)
        self.example: str | None = None
        self.is_nothing = True  # no cell holds anything

    def add(self, part: Readings) -> None:
        self.raw.append(part.raw)
        self.missing.append(part.missing)
        self.unparsed.append(part.unparsed)
        self.example = self.example or part.example
        self.is_nothing &= bool(part.missing.all()) and not part.unparsed.any()

    def taken(self) -> Readings:
        parts = self.raw.taken(), self.missing.taken(), self.unparsed.taken()
        return Readings(*parts, self.example)


class Gathered:
    """Rows of a table, or messages of a topic, in the order of the file.

    Readings go by the column or field that they stand in, states of quality by that and what is
    good there.
    """

    def __init__(self) -> None:
        self._time_us, self._kind = Growing(np.int64), Growing(np.int8)
        self._example: str | None = None
        self._columns: dict[Any, _Column] = {}
        self._states: dict[Any, Growing[np.uint8]] = {}
        self._blank: dict[Any, bool] = {}  # by those, whether no cell tells of a quality

    def add(
        self,
        stamps: WrittenStamps,
        readings: Mapping[Any, Readings],
        states: Mapping[Any, NDArray[np.uint8]],
    ) -> None:
        """Add a piece."""
        self._time_us.append(stamps.time_us)
        self._kind.append(stamps.kind)
        self._example = self._example or stamps.example
        for key, part in readings.items():
            self._columns.setdefault(key, _Column()).add(part)
        for key, marks in states.items():
            self._states.setdefault(key, Growing(np.uint8)).append(marks)
            self._blank[key] = self._blank.get(key, True) and bool((marks == BLANK).all())

    def nothing(self) -> list[Any]:
        """Columns and fields that are blank in all rows; none without rows."""
        found: list[Any] = [key for key, column in self._columns.items() if column.is_nothing]
        return found + [key[0] for key, is_blank in self._blank.items() if is_blank]

    def stamps(self, zone: str) -> TimeStamps:
        """Time stamps of all rows, to be given up."""
        stamps = WrittenStamps(self._time_us.taken(), self._kind.taken(), self._example)
        return placed(stamps, zone)

    def channels(
        self,
        path: Path,
        channels: Channels,
        keys: Mapping[Any, tuple[Any, Any]],
        places: Mapping[Any, tuple[Rows, NDArray[np.int64]]],
    ) -> dict[str, RawChannel]:
        """Channels by the keys of their readings and states, and by their rows and time stamps.

        A column is given up with its last channel, so that a long log is not held twice.
        """
        found: dict[str, RawChannel] = {}
        states = {key: marks.taken() for key, marks in self._states.items()}
        for column in dict.fromkeys(column for column, _ in keys.values()):
            readings = self._columns.pop(column, _Column()).taken()
            for name in [name for name, key in keys.items() if key[0] == column]:
                rows, time_us = places[name]
                marks = states.get(keys[name][1])
                own = None if marks is None else marks[rows]
                some = readings.rows(rows)
                found[name] = raw_channel(path, name, channels[name], time_us, some, own)
        return {name: found[name] for name in channels}
