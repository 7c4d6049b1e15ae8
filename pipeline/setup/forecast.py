"""What a run would make of a motor's nights, by its own rules: fitted, or refused and why."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pipeline.clock import latest_us
from pipeline.config import MotorSpec
from pipeline.config.nights import night
from pipeline.logs.files import reaches_us, slice_night
from pipeline.logs.motor_logs import MotorLogs
from pipeline.logs.processed import FileRecord
from pipeline.night.column_change import (
    USUAL_NIGHTS,
    column_change,
    readings_of,
    usual_readings,
)
from pipeline.night.fit_night import fit_night
from pipeline.schema.fits import FAILED, LAG_COLUMNS, NO_NEW_DATA, OK


@dataclass(frozen=True, slots=True)
class NightForecast:
    """What a run would make of a night."""

    night: str
    status: str  # as in `nights`
    reason: str
    # As in `fits`: lag of its drain flow, and what it explains.
    drain_lag_s: float | None = None
    drain_lag_gain_percent: float | None = None


def forecasts(
    spec: MotorSpec,
    labels: Sequence[dt.date] | None = None,
    records: Mapping[str, FileRecord] | None = None,
) -> Iterator[NightForecast]:
    """Yield the forecast of each night, or of some, in order of time.

    `records` are those of the logs as far as they were looked at.
    """
    logs = MotorLogs(spec, {}, latest_us(), {}, records)
    fitted: dict[dt.date, Mapping[str, Any]] = {}
    for label in sorted(logs.present() if labels is None else labels):
        status, reason, row, lag = _forecast(spec, logs, label)
        since = _era(spec, label)
        nights = [day for day in fitted if day >= since][-USUAL_NIGHTS:]
        usual, now = usual_readings(fitted[night] for night in nights), readings_of(row)
        if usual and now and (why := column_change(spec, usual, now)):
            status, reason = FAILED, why
        if status == OK:
            fitted[label] = row
        yield NightForecast(label.isoformat(), status, reason, **lag)


def _forecast(
    spec: MotorSpec, logs: MotorLogs, label: dt.date
) -> tuple[str, str, Mapping[str, Any], Mapping[str, float | None]]:
    here = night(label, spec.settings.nights)
    names = logs.of_night(label)
    contents = [logs.content(name) for name in (*logs.before_night(here), *names)]
    broken = [record for name in names if (record := logs.files[name]).status != "ok"]
    if broken:
        return FAILED, broken[0].message or "", {}, {}
    read = [content for content in contents if content is not None]
    channels = slice_night(read, here, reaches_us(spec))
    if not any((channel.time_us >= here.start_us).any() for channel in channels.values()):
        return NO_NEW_DATA, "no log covers this night", {}, {}
    outcome = fit_night(spec, here, channels)
    logs.let_go_until(label)
    lag = {name: outcome.rows["fits"][0].get(name) for name in LAG_COLUMNS}
    return outcome.status, outcome.reason or "", outcome.rows["nights"][0], lag


def _era(spec: MotorSpec, label: dt.date) -> dt.date:
    """Return the begin of the baseline period of a night."""
    begins = (event.date for event in spec.file.baseline_events if event.date <= label)
    return max(begins, default=dt.date.min)
