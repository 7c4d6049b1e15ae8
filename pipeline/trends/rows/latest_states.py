"""States of motors, made from the tables, or as the last run left them."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import polars as pl

from leakage.estimation.validation import is_poor
from pipeline.errors import StoreError
from pipeline.schema import ALARMS, FITS, LATEST, TRENDS, WATCH
from pipeline.schema.fits import FAILED, OK
from pipeline.store.tables import read_rows, read_table, whole_file
from pipeline.trends.nights.decisions import LEAKAGE, Decision, read_decisions
from pipeline.trends.nights.tonight import WITH_SAMPLES
from pipeline.trends.rows.motor_states import (
    CHANGED,
    FITS_OF_A_NIGHT,
    LIMITS,
    TONIGHTS_FITS,
    MotorState,
    fit_words,
    state_of_row,
    with_acknowledgement,
)
from pipeline.trends.rows.watch_rows import WatchRow
from pipeline.trends.sentences import limit_dates

Row = dict[str, Any]

# Columns that a state is made from.
FIT_COLUMNS = ("motor_id", "night", "status", "reason", "is_primary", *TONIGHTS_FITS)
TREND_COLUMNS = (
    *("motor_id", "night", "indicator", "value", "state_reason", "sensor_health", *LIMITS),
)
# Of the leakage that is told: the fleet's reference conditions, or the motor's own.
LEAKAGES = ("reference_leakage", "own_reference_leakage")


@dataclass(frozen=True, slots=True)
class StateTables:
    """Rows that states of motors are made from: all of `fits`, the newest of each motor's nights
    of `watch` and `trends`, and its changes of state."""

    fits: pl.DataFrame
    watch: pl.DataFrame
    trends: pl.DataFrame
    alarms: pl.DataFrame

    @classmethod
    def read(cls, output: Path, motor_ids: Sequence[str]) -> StateTables:
        """Of some motors; raises StoreError if a table is damaged."""
        watch = _newest(read_rows(output, WATCH, motor_ids).sort("night"))
        nights = set(watch["night"])
        return cls(
            read_rows(output, FITS, motor_ids, FIT_COLUMNS),
            watch,
            read_rows(output, TRENDS, motor_ids, TREND_COLUMNS, nights=nights),
            read_rows(output, ALARMS, motor_ids).filter(indicator=LEAKAGE),
        )


def latest_states(output: Path, motor_ids: Sequence[str]) -> list[MotorState]:
    """States of some motors by the tables.

    Raises StoreError if a table is damaged.
    """
    states = motor_states(motor_ids, StateTables.read(output, motor_ids), read_decisions(output))
    newest = max((one.data_night for one in states if one.data_night), default=None)
    return [
        replace(one, data_age_nights=(newest - one.data_night).days)
        if newest and one.data_night
        else one
        for one in states
    ]


def published_states(output: Path, motor_ids: Sequence[str]) -> list[MotorState]:
    """States of some motors as the last run left them, with what was said of them since.

    Without a table `latest` that is whole they are made from the other tables.

    Raises StoreError if one of these is damaged.
    """
    try:
        rows = read_table(whole_file(output, LATEST), LATEST)
    except StoreError as error:
        if error.code != "store_read":
            raise
        return latest_states(output, motor_ids)
    known = {row["motor_id"]: state_of_row(row) for row in rows.to_dicts()}
    return _with_decisions([known.get(one, _unknown(one)) for one in motor_ids], output)


def _with_decisions(states: Sequence[MotorState], output: Path) -> list[MotorState]:
    decisions = read_decisions(output)
    return [with_acknowledgement(one, _of(one.motor_id, decisions)) for one in states]


def _of(motor_id: str, decisions: Sequence[Decision]) -> list[Decision]:
    return [one for one in decisions if one.motor_id == motor_id]


def _unknown(motor_id: str) -> MotorState:
    return MotorState(motor_id, "insufficient", "no night yet", "Wait for more nights.")


def motor_states(
    motor_ids: Sequence[str], tables: StateTables, decisions: Sequence[Decision]
) -> list[MotorState]:
    """States of some motors, from rows of the tables and the decisions on any."""
    fits = tables.fits.sort("night", "is_primary")
    last = _by_motor(fits)
    good = _by_motor(fits.filter(status=OK))
    data = _by_motor(fits.filter(pl.col("status").is_in(WITH_SAMPLES)))
    watch = _by_motor(tables.watch)
    trends: dict[tuple[str, dt.date], dict[str, Row]] = {}
    for row in tables.trends.iter_rows(named=True):
        trends.setdefault((row["motor_id"], row["night"]), {})[row["indicator"]] = row
    found = []
    for motor_id in motor_ids:
        state = replace(
            _unknown(motor_id),
            last_night=last.get(motor_id, {}).get("night"),
            last_good_night=good.get(motor_id, {}).get("night"),
            data_night=data.get(motor_id, {}).get("night"),
            poor_fit=_poor_fit(good.get(motor_id, {})),
            failure=_failure(last.get(motor_id, {})),
        )
        if state.last_night is not None:
            state = replace(state, reason="no trends yet")
        if motor_id in watch:
            told = WatchRow.of(watch[motor_id])
            since = _since(tables.alarms.filter(motor_id=motor_id), told.state)
            state = _with_watch(state, told, trends.get((motor_id, told.night), {}), since)
        found.append(with_acknowledgement(state, _of(motor_id, decisions)))
    return found


def _with_watch(
    state: MotorState, told: WatchRow, trends: Mapping[str, Row], since: dt.date | None
) -> MotorState:
    """A state with what the watch says of the motor's newest night."""
    at_reference = told.reference_leakage_l_per_min is not None
    limit = trends.get(LEAKAGES[0] if at_reference else LEAKAGES[1], {})
    is_changed = told.state in CHANGED
    advice = told.advice
    if state.failure and not is_changed:
        advice = "Mend what failed in the last night."
    limits: dict[str, Any] = {name: limit.get(name) for name in LIMITS}
    return replace(
        state,
        state=told.state,
        reason=told.sentence,
        advice=advice,
        watch=told,
        state_since=since,
        sensor_health=limit.get("sensor_health"),
        oil=trends.get("oil_viscosity", {}).get("state_reason") or "",
        limit_dates=limit_dates(limit) if limit and is_changed else "",
        **limits,
    )


def _since(alarms: pl.DataFrame, state: str) -> dt.date | None:
    """First night of a state that stands, by the changes of state; None where it is ok."""
    if state == "ok":
        return None
    first = None
    for row in alarms.sort("night").iter_rows(named=True):
        if row["to_state"] != state:
            first = None
        elif first is None:
            first = row["night"]
    return first


def _newest(rows: pl.DataFrame) -> pl.DataFrame:
    """The last of each motor's rows, which are in order of their nights."""
    return rows.unique("motor_id", keep="last", maintain_order=True)


def _by_motor(rows: pl.DataFrame) -> dict[str, Row]:
    """The last of each motor's rows, by motor."""
    return {row["motor_id"]: row for row in _newest(rows).iter_rows(named=True)}


def _failure(last: Row) -> str:
    """Sentence on a motor's last night if it failed; else empty."""
    if last.get("status") != FAILED:
        return ""
    return f"night of {last['night']} failed: {last['reason']}"


def _poor_fit(last: Row) -> str:
    """Sentence on the fit of a motor's last good night if it is poor; else empty."""
    poor = [
        fit_words(FITS_OF_A_NIGHT[name], last[name])
        for name in TONIGHTS_FITS
        if last and is_poor(last[name])
    ]
    return f"fit of {last['night']}: {', '.join(poor)}" if poor else ""
