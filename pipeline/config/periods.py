"""Training and validation periods that an engineer has chosen, as far as they touch a night."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable
from dataclasses import dataclass

from pipeline.config.motors import Periods
from pipeline.config.nights import Night

Stretch = tuple[int, int]
"""Begin and end, UTC microseconds, half open."""


@dataclass(frozen=True, slots=True)
class ChosenPeriods:
    """Chosen periods of a night, in order of time."""

    training: tuple[Stretch, ...] = ()
    validation: tuple[Stretch, ...] = ()

    @classmethod
    def of(cls, periods: Periods, night: Night) -> ChosenPeriods:
        """Those of a motor's periods that touch a night."""

        def touching(chosen: Iterable[tuple[dt.datetime, dt.datetime]]) -> tuple[Stretch, ...]:
            stretches = ((_microseconds(begin), _microseconds(end)) for begin, end in chosen)
            return tuple(
                sorted(
                    (begin, end)
                    for begin, end in stretches
                    if begin < night.end_us and end > night.start_us
                )
            )

        return cls(touching(periods.training), touching(periods.validation))

    def __bool__(self) -> bool:
        return bool(self.training or self.validation)


NONE_CHOSEN = ChosenPeriods()


def _microseconds(time: dt.datetime) -> int:
    return (time - dt.datetime(1970, 1, 1, tzinfo=dt.UTC)) // dt.timedelta(microseconds=1)
