"""Training and validation periods that an engineer has chosen, as far as they touch a night."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable

from leakage.estimation import sample_blocks
from leakage.estimation.sample_blocks import Stretch
from pipeline.config.motors import Periods
from pipeline.config.nights import Night


class ChosenPeriods(sample_blocks.ChosenPeriods):
    """Chosen periods of a night, in order of time."""

    __slots__ = ()

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


def _microseconds(time: dt.datetime) -> int:
    return (time - dt.datetime(1970, 1, 1, tzinfo=dt.UTC)) // dt.timedelta(microseconds=1)
