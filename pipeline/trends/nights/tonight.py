"""Tonight: the night up to which motors are judged, by the samples that there are."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import polars as pl

from pipeline.schema import FITS, OPERATION
from pipeline.schema.fits import INSUFFICIENT_DATA, OK, STOOD_STILL
from pipeline.store.tables import nights_back, read_rows

# Outcomes of nights of which a log could be read.
WITH_SAMPLES = (OK, STOOD_STILL, INSUFFICIENT_DATA)


@dataclass(frozen=True, slots=True)
class Tonight:
    """The fleet's newest night with kept samples, since which motors without a log are silent.

    `further` has by motor its newest night with samples after that, of which it kept none.
    """

    night: dt.date
    further: Mapping[str, dt.date] = field(default_factory=dict)

    def of(self, motor_id: str) -> dt.date:
        """The last night of a motor of which something is said."""
        return self.further.get(motor_id, self.night)


def tonight_of(output: Path, motor_ids: Sequence[str], latest: dt.date) -> Tonight | None:
    """Tonight by the published tables; None where no motor has kept a sample.

    A night that only an unreadable log tells, or that lies in the future, after `latest`, is not
    tonight: it would make every other motor silent since.

    Raises StoreError if a table file is damaged.
    """
    further: dict[str, dt.date] = {}
    for night in nights_back(output, FITS):
        fits = read_rows(output, FITS, motor_ids, ("motor_id", "status"), nights=[night])
        for motor_id in fits.filter(pl.col("status").is_in(WITH_SAMPLES))["motor_id"]:
            further.setdefault(motor_id, night)
        kept = read_rows(output, OPERATION, motor_ids, ("kept_hours",), nights=[night])
        if night <= latest and (kept["kept_hours"] > 0).any():
            return Tonight(night, further)
    return None
