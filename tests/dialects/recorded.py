"""Records of a motor in a night, before they are written in a dialect."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Times = NDArray[np.int64]
Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Recorded:
    """Readings of a motor's channels in the order in which they were logged."""

    time_us: Times  # stamp of each row, UTC, shape (n,)
    # By channel, in its canonical unit, shape (n,) each; nan where there is no reading.
    values: Mapping[str, Values]
    # By channel, its own stamps where the channels do not share those of the row; shape (n,) each.
    # What has no reading was then not logged at all.
    own_time_us: Mapping[str, Times] = field(default_factory=dict)

    def samples(self) -> tuple[Times, NDArray[np.intp], Values]:
        """One after the other: stamp, number of the channel and reading; shape (m,) each."""
        stamps = [self.own_time_us.get(name, self.time_us) for name in self.values]
        numbers = np.repeat(np.arange(len(self.values)), self.time_us.size)
        places = np.tile(np.arange(self.time_us.size), len(self.values))
        time_us, value = np.concatenate(stamps), np.concatenate(list(self.values.values()))
        order = np.lexsort((time_us, places))
        if self.own_time_us:
            order = order[~np.isnan(value[order])]
        return time_us[order], numbers[order], value[order]

    def channel(self, name: str) -> tuple[Times, Values]:
        """Stamps and readings of one channel."""
        value = self.values[name]
        if name not in self.own_time_us:
            return self.time_us, value
        known = ~np.isnan(value)
        return self.own_time_us[name][known], value[known]

    def rows(self) -> tuple[Times, dict[str, Values]]:
        """As the rows of a table, blank cells as nan; channels without common stamps take turns."""
        if not self.own_time_us:
            return self.time_us, dict(self.values)
        time_us, numbers, value = self.samples()
        return time_us, {
            name: np.where(numbers == number, value, np.nan)
            for number, name in enumerate(self.values)
        }
