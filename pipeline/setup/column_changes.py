"""Readings that from one log on look like those of other columns or units."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from pipeline.config import MotorSpec
from pipeline.config.channels import COUNTED
from pipeline.errors import LogError
from pipeline.ingest import RawChannel, read_log
from pipeline.logs.files import labels_of
from pipeline.logs.ledger import FileRecord
from pipeline.night.column_change import COLUMNS, column_change
from pipeline.setup.promise import conditions_at, is_valid


def changed_readings(
    spec: MotorSpec,
    records: Mapping[str, FileRecord],
    path_of: Callable[[str], Path],
    newest: Mapping[str, RawChannel],
) -> str | None:
    """The log from which on readings look like those of other columns or units; None: none.

    The first log since the last event and the newest are compared, then others by halves.
    """
    since = max((one.date for one in spec.file.baseline_events), default=dt.date.min)
    dated = sorted((max(labels_of(one)), name) for name, one in records.items() if one.nights)
    names = [name for night, name in dated if night >= since]

    def means(at: int) -> dict[str, float]:
        try:
            log = read_log(path_of(names[at]), spec.file.logs, spec.file.channels)
        except LogError:  # which is a fault of that log already
            return {}
        return _typical(spec, log.channels)

    usual, now = means(0) if len(names) > 1 else {}, _typical(spec, newest)
    why = column_change(spec, usual, now) if usual and now else None
    if why is None:
        return None
    low, high = 0, len(names) - 1
    while high - low > 1:
        middle = (low + high) // 2
        known = means(middle)
        is_changed = bool(known) and column_change(spec, usual, known) is not None
        low, high = (low, middle) if is_changed else (middle, high)
    return f"columns_changed: from {names[high]} on: {why}"


def _typical(spec: MotorSpec, channels: Mapping[str, RawChannel]) -> dict[str, float]:
    """Medians of a log while the motor turned; empty where one is not known."""
    if spec.file.channels[COUNTED].counts is not None:
        return {}
    flow = channels[COUNTED]
    known = is_valid(spec, COUNTED, flow)
    pressure, speed, degrees = conditions_at(spec, channels, flow.time_us[known])
    if pressure is None or speed is None or degrees is None:
        return {}
    ran = speed > spec.settings.cleaning.standstill_rpm
    if not ran.any():
        return {}
    readings = (pressure, degrees, speed, flow.value[known])
    medians = (float(np.median(one[ran])) for one in readings)
    return dict(zip(COLUMNS, medians, strict=True))
