"""A motor trained on one period of its logs and validated on another, across nights."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

from leakage.frame.result import FrameFit
from pipeline.clock import microseconds, utc
from pipeline.config import Fleet, Nights
from pipeline.config.nights import night, night_of, nights_between
from pipeline.errors import UsageError
from pipeline.notebook.preparing import Prepared, motor_of, prepare_nights

Moments = tuple[dt.datetime, dt.datetime]


def fit_periods(
    config: Fleet | Path | str, motor_id: str, train: str, validate: str | None = None
) -> tuple[FrameFit, Prepared]:
    """Fit a motor to one period of its logs, and judge it on another.

    Parameters
    ----------
    config
        The fleet, or its file.
    motor_id
        The motor.
    train, validate
        Begin and end as ``A..B``: nights, both included, or moments such as 2026-01-02T22:00, in
        UTC where they state no zone.

    Returns
    -------
    FrameFit
    Prepared
        The samples of the nights that the periods touch.

    Raises
    ------
    UsageError
        ``period``: a period is not of this form; and as of :func:`prepare_log`.
    LeakageError
        As of :func:`leakage.fit_frame`.
    """
    spec = motor_of(config, motor_id)
    nights = spec.settings.nights
    periods = [_period(text, nights) for text in (train, validate) if text]
    labels = {label for period in periods for label in _labels(period, nights)}
    prepared = prepare_nights(spec, labels)
    found = prepared.fit(train=periods[0], validate=periods[1] if validate else None)
    return found, prepared


def _period(text: str, nights: Nights) -> Moments:
    """Begin and end of a period, half open."""
    begin, _, end = text.partition("..")
    try:
        first, last = (dt.date.fromisoformat(part) for part in (begin, end))
        found = (utc(night(first, nights).start_us), utc(night(last, nights).end_us))
    except ValueError:
        try:
            found = (_moment(begin), _moment(end))
        except ValueError as error:
            raise UsageError(
                "period", f"{text!r}: write a period as 2026-01-02..2026-01-08, or with times"
            ) from error
    if not found[0] < found[1]:
        raise UsageError("period", f"{text!r} ends before it begins")
    return found


def _moment(text: str) -> dt.datetime:
    moment = dt.datetime.fromisoformat(text)
    return moment if moment.tzinfo else moment.replace(tzinfo=dt.UTC)


def _labels(period: Moments, nights: Nights) -> list[dt.date]:
    first, last = map(microseconds, period)
    return nights_between(night_of(first, nights), night_of(last - 1, nights))
