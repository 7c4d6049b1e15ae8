"""Columns that grow where they lie, so that a long log is never held twice."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline.ingest.assembly import Readings
from pipeline.ingest.time_stamps import WITH_ZONE, WrittenStamps

_T = TypeVar("_T", bound=np.generic)

_FIRST_ROOM = 2**12
_MOST_ROOM = 2**18


class Column(Generic[_T]):
    """Values one after the other."""

    def __init__(self, dtype: type[_T]) -> None:
        self._values: NDArray[_T] = np.empty(_FIRST_ROOM, dtype)
        self._size = 0

    def append(self, values: NDArray[_T]) -> None:
        """Add values."""
        end, room = self._size + values.size, self._values.size
        if end > room:
            # Small steps cost little: a large array is moved by its pages, not copied.
            self._values.resize(max(end, room + min(room // 8, _MOST_ROOM)), refcheck=False)
        self._values[self._size : end] = values
        self._size = end

    def taken(self) -> NDArray[_T]:
        """All values, to be given up by the column."""
        values, self._values = self._values, np.empty(0, self._values.dtype)
        values.resize(self._size, refcheck=False)
        self._size = 0
        return values


class Marks(Generic[_T]):
    """Values one after the other, which take no memory as long as all are the same."""

    def __init__(self, usual: _T) -> None:
        self._usual = usual
        self._values: Column[_T] | None = None
        self._size = 0

    def append(self, values: NDArray[_T]) -> None:
        """Add values."""
        if self._values is None and (values != self._usual).any():
            self._values = Column(type(self._usual))
            self._values.append(np.full(self._size, self._usual))
        if self._values is not None:
            self._values.append(values)
        self._size += values.size

    def taken(self) -> NDArray[_T]:
        """All values, to be given up; where all are the same they cannot be written."""
        if self._values is not None:
            return self._values.taken()
        return np.broadcast_to(self._usual, self._size)


@dataclass(slots=True)
class ReadingsColumn:
    """Readings of a field."""

    raw: Column[np.float64] = field(default_factory=lambda: Column(np.float64))
    missing: Marks[np.bool_] = field(default_factory=lambda: Marks(np.False_))
    unparsed: Marks[np.bool_] = field(default_factory=lambda: Marks(np.False_))
    example: str | None = None

    def append(self, readings: Readings) -> None:
        """Add readings."""
        self.raw.append(readings.raw)
        self.missing.append(readings.missing)
        self.unparsed.append(readings.unparsed)
        self.example = self.example or readings.example

    def taken(self) -> Readings:
        """All readings, to be given up by the column."""
        return Readings(self.raw.taken(), self.missing.taken(), self.unparsed.taken(), self.example)


@dataclass(slots=True)
class StampsColumn:
    """Time stamps of a topic."""

    time_us: Column[np.int64] = field(default_factory=lambda: Column(np.int64))
    kind: Marks[np.int8] = field(default_factory=lambda: Marks(np.int8(WITH_ZONE)))
    example: str | None = None

    def append(self, stamps: WrittenStamps) -> None:
        """Add stamps."""
        self.time_us.append(stamps.time_us)
        self.kind.append(stamps.kind)
        self.example = self.example or stamps.example

    def taken(self) -> WrittenStamps:
        """All stamps, to be given up by the column."""
        return WrittenStamps(self.time_us.taken(), self.kind.taken(), self.example)
