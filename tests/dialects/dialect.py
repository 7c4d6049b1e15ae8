"""Common part of all dialects, and of those of tables: keys of a motor's config, and a writer."""

from __future__ import annotations

import datetime as dt
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar
from zoneinfo import ZoneInfo

import numpy as np

from pipeline.config.channels import Channel, ChannelName
from pipeline.units import QUANTITIES, canonical_unit, from_canonical
from tests.dialects.recorded import Recorded, Times, Values
from tests.pipeline.ingest.sources import Source

EPOCH = dt.datetime(1970, 1, 1, tzinfo=dt.UTC)
MICROSECOND = dt.timedelta(microseconds=1)
EXCEL_ZERO = dt.datetime(1899, 12, 30)


@dataclass(frozen=True)
class Dialect(ABC):
    """A way to write logs."""

    name: str  # in words
    # Keys of the config's `logs` section that state it.
    logs: Mapping[str, Any] = field(default_factory=dict)
    # By quantity ("pressure"), where they are not the canonical ones.
    units: Mapping[str, str] = field(default_factory=dict)
    # By channel, what it is called in the log, where that is not its canonical name.
    names: Mapping[str, str] = field(default_factory=dict)
    step_us: int = 1  # of the stamps; what lies between cannot be written

    format: ClassVar[str]

    @abstractmethod
    def write(self, folder: Path, stem: str, log: Recorded) -> list[Path]:
        """Write a log as one file or several whose names begin with `stem`; returns them."""

    def holds(self, log: Recorded) -> bool:
        """True if the dialect can write all that was recorded."""
        stamps = (log.time_us, *log.own_time_us.values())
        return not any((time_us % self.step_us).any() for time_us in stamps)

    @property
    def layout(self) -> str:
        """Wide, long or a file a channel."""
        return self.key("layout", "wide")

    def key(self, key: str, fallback: str) -> str:
        """A key of the config's `logs` section."""
        return str(self.logs.get(key, fallback))

    def unit(self, channel: str) -> str:
        """Unit that a channel is written in."""
        return self.units.get(QUANTITIES[channel], canonical_unit(channel))

    def called(self, channel: str) -> str:
        """Name of a channel in the log."""
        return self.names.get(channel, channel)

    def source(self, channel: str) -> dict[str, Any]:
        """Keys of a channel's section in the config."""
        if self.layout == "file_per_channel":
            return {"source": f"*+{channel}.*", "unit": self.unit(channel)}
        return {"source": self.called(channel), "unit": self.unit(channel)}

    def section(self) -> dict[str, Any]:
        """Keys of the config's `logs` section but for the files."""
        return {"format": self.format, **self.logs}

    def source_of(self, channels: Iterable[ChannelName]) -> Source:
        """Arguments of a reader."""
        keys = self.section()
        wanted = {name: Channel(**self.source(name)) for name in channels}
        return Source.of(keys.pop("format"), wanted, **keys)

    def in_units(self, log: Recorded) -> Recorded:
        """Readings as they are written."""
        return replace(
            log,
            values={
                name: value
                if self.unit(name) == canonical_unit(name)
                else from_canonical(name, value, self.unit(name))
                for name, value in log.values.items()
            },
        )

    def wall_clock(self, time_us: int) -> dt.datetime:
        """A stamp on the wall clock of the logger's zone."""
        zone = ZoneInfo(self.key("time_zone", "UTC"))
        return (EPOCH + time_us * MICROSECOND).astimezone(zone)

    def excel_days(self, time_us: int) -> float:
        """A stamp as days of a spreadsheet."""
        naive = self.wall_clock(time_us).replace(tzinfo=None)
        return (naive - EXCEL_ZERO) / dt.timedelta(days=1)

    def wall_clock_us(self, time_us: Times) -> Times:
        """Stamps as microseconds that the logger's wall clock shows since 1970."""
        naive = (self.wall_clock(time).replace(tzinfo=dt.UTC) for time in time_us.tolist())
        return np.array([(moment - EPOCH) // MICROSECOND for moment in naive], dtype=np.int64)


class Table(Dialect):
    """A dialect of tables in each layout."""

    @property
    @abstractmethod
    def suffix(self) -> str:
        """End of a file's name."""

    @abstractmethod
    def cells(self, values: Values) -> Sequence[Any]:
        """Readings as a column."""

    @abstractmethod
    def file(self, path: Path, time_us: Times, columns: Mapping[str, Sequence[Any]]) -> Path:
        """Write a table; returns its path."""

    def write(self, folder: Path, stem: str, log: Recorded) -> list[Path]:
        log, value = self.in_units(log), self.key("value_column", "value")
        if self.layout == "file_per_channel":
            parts = {name: log.channel(name) for name in log.values}
            return [
                self.file(
                    folder / f"{stem}+{name}{self.suffix}", time_us, {value: self.cells(part)}
                )
                for name, (time_us, part) in parts.items()
            ]
        if self.layout == "long":
            time_us, numbers, values = log.samples()
            names = [self.called(name) for name in log.values]
            channels = [names[number] for number in numbers]
            columns = {self.key("channel_column", "channel"): channels, value: self.cells(values)}
        else:
            time_us, by_name = log.rows()
            columns = {self.called(name): self.cells(part) for name, part in by_name.items()}
        return [self.file(folder / f"{stem}{self.suffix}", time_us, columns)]
