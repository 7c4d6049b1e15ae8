"""A motor's state in one row: what `status` prints, and the table `latest` publishes."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import islice
from pathlib import Path
from statistics import median
from typing import Any

import polars as pl

from leakage.estimation.validation import is_poor
from pipeline.errors import StoreError
from pipeline.schema import (
    ALARMS,
    FITS,
    INPUT_FILES,
    LATEST,
    OPERATION,
    TRENDS,
    WATCH,
)
from pipeline.schema.fits import FAILED, OK, WITH_SAMPLES
from pipeline.store.tables import nights_back, read_rows, read_table, whole_file
from pipeline.trends.nights.decisions import LEAKAGE, SENSORS, Decision, read_decisions
from pipeline.trends.rows.watch_rows import WATCH_COLUMNS, WatchRow
from pipeline.trends.sentences import limit_dates

Row = dict[str, Any]

# From what needs attention most to what needs none.
CHANGED = ("alarm", "warning", "common_cause")
ORDER = (*CHANGED, "stale", "insufficient", "ok")
NEWEST_FITS = ("training_fit_percent", "validation_fit_percent")
FITS_OF_A_NIGHT = {
    "training_fit_percent": "training",
    "validation_fit_percent": "validation",
    "previous_model_fit_percent": "the model before, on that night",
}
LIMITS = ("days_to_limit", "days_to_limit_lower", "days_to_limit_upper", "days_to_limit_status")
# States that ask for something.
TOLD = (*CHANGED, "stale")
# States of the intraday check: a sudden rise, and none.
RISEN, CLEAR = "risen", "clear"
# Columns of `latest` that the watch fills under the names they have in its own table.
AS_IN_WATCH = tuple(
    name
    for name in WATCH_COLUMNS
    if name not in ("motor_id", "night", "state", "sentence", "advice")
)


@dataclass(frozen=True, slots=True)
class IntradayStatus:
    """State of a motor's intraday check, for people."""

    state: str
    since: dt.datetime
    reason: str
    # risen, confirmed, withdrawn: rises reported, and those that a night confirmed or withdrew.
    risen: int = 0
    confirmed: int = 0
    withdrawn: int = 0

    @property
    def words(self) -> str:
        """State in words."""
        return f"within the day {self.state} since {self.since:%Y-%m-%d %H:%M} UTC: {self.reason}"


@dataclass(frozen=True, slots=True)
class MotorState:
    """A motor's state in its newest night."""

    motor_id: str
    state: str
    # reason, advice: what is reported of it, and what to do: the watch's, or of a motor that is ok
    # the drift of a sensor.
    reason: str
    advice: str
    watch: WatchRow | None = None  # its newest row of `watch`; None without one
    state_since: dt.date | None = None  # first night of the state; None where ok
    sensor_health: str | None = None  # ok, drifted or unknown
    # last_night, last_good_night: last night with a row, and with a fit; None without one.
    last_night: dt.date | None = None
    last_good_night: dt.date | None = None
    # data_night, data_age_nights: newest night with samples, and nights from it to the fleet's
    # newest such night.
    data_night: dt.date | None = None
    data_age_nights: int | None = None
    # poor_fit, failure: sentence on a poor fit of the last good night, and on the last night if it
    # failed; else empty.
    poor_fit: str = ""
    failure: str = ""
    # What the log of the newest night with samples lacks, in words; empty where it is as usual.
    log_note: str = ""
    oil: str = ""  # the oil as measured, in words; empty where its data sheet holds
    # As in `trends`, of the leakage: when it reaches its limit; the same as dates, in words.
    days_to_limit: float | None = None
    days_to_limit_lower: float | None = None
    days_to_limit_upper: float | None = None
    days_to_limit_status: str | None = None
    limit_dates: str = ""
    # Note of the last acknowledgement since the state began; empty without one.
    acknowledged: str = ""
    # State of its intraday check, which the table `latest` does not hold; None where it reported
    # nothing.
    intraday: IntradayStatus | None = None

    @property
    def sentence(self) -> str:
        """The state in words, a sudden rise within the day first."""
        rise = self.intraday.words if self.intraday is not None and self.is_sudden else ""
        return f"{rise}; {self.reason}" if rise else self.reason

    @property
    def notes(self) -> tuple[str, ...]:
        """Further notes on the motor, in words."""
        dates = f"its limit {self.limit_dates}" if self.limit_dates else ""
        every = (dates, self.failure, self.log_note, self.poor_fit, self.oil)
        return tuple(note for note in every if note)

    @property
    def why(self) -> str:
        """The sentence with its notes, and an acknowledgement."""
        words = "; ".join((self.sentence, *self.notes))
        return f"{words} (acknowledged: {self.acknowledged})" if self.acknowledged else words

    @property
    def needs_attention(self) -> bool:
        """The state asks for something, or the last night failed."""
        return self.is_sudden or self.state in TOLD or bool(self.failure)

    @property
    def is_sudden(self) -> bool:
        """A sudden rise within the day stands."""
        return self.intraday is not None and self.intraday.state == RISEN

    @property
    def path(self) -> str | None:
        """The path that the cause names; None where it names none."""
        return None if self.watch is None else self.watch.path

    @property
    def change_percent(self) -> float | None:
        """Change of the newest night's flow from the baseline [%]; None where it is not known."""
        newest_night = None if self.watch is None else self.watch.tonight_change
        return None if newest_night is None else 100.0 * newest_night


# Fields of a state that are columns of `latest` as they are.
STORED = tuple(one.name for one in fields(MotorState) if one.name not in ("watch", "intraday"))


def latest_rows(states: Iterable[MotorState], run_id: str) -> list[Row]:
    """Rows of `latest`."""
    return [_latest_row(one) | {"run_id": run_id} for one in states]


def _latest_row(state: MotorState) -> Row:
    row: Row = {name: getattr(state, name) for name in STORED} | {"sentence": state.why}
    if (watch := state.watch) is None:
        return row
    gap = (watch.gap_growth, watch.gap_growth_lower, watch.gap_growth_upper)
    gap_percent = [None if one is None else 100.0 * one for one in gap]
    indicator, conditions = "reference_leakage", "reference"
    if watch.reference_leakage_l_per_min is None:
        indicator, conditions = "own_reference_leakage", "own"
    leakage = {
        f"leakage_{end}": getattr(watch, f"{conditions}_leakage_{end}")
        for end in ("l_per_min", "lower", "upper")
    }
    is_known = leakage["leakage_l_per_min"] is not None
    return (
        row
        | {name: getattr(watch, name) for name in AS_IN_WATCH}
        | leakage
        | {
            "leakage_indicator": indicator if is_known else None,
            "leakage_night": watch.night if is_known else None,
            "watch_night": watch.night,
            "indicator": None if state.state == "ok" else LEAKAGE,
            "path": watch.path,
            "known_since": watch.told_on,
            "change_start": watch.since,
            "deviation_percent": state.change_percent,
            "gap_path": None if gap[0] is None else watch.path,
            "gap_change_percent": gap_percent[0],
            "gap_change_lower": gap_percent[1],
            "gap_change_upper": gap_percent[2],
        }
    )


def state_of_row(row: Mapping[str, Any]) -> MotorState:
    """The state of a row of `latest`."""
    known: Row = {name: row[name] for name in STORED}
    known["log_note"] = known["log_note"] or ""
    if row["watch_night"] is not None:
        watch = {**row, "night": row["watch_night"], "sentence": row["reason"]}
        known["watch"] = WatchRow.of(watch)
    return MotorState(**known)


def fit_words(name: str, percent: float) -> str:
    """A fit with its name; a poor one is called that.

    Examples
    --------
    >>> fit_words("training", 99.14), fit_words("validation", -1295.0)
    ('training 99.1 %', 'validation -1295.0 % (poor: worse than a constant flow)')
    """
    poor = " (poor: worse than a constant flow)" if is_poor(percent) else ""
    return f"{name} {percent:.1f} %{poor}"


def urgency(motor: MotorState) -> tuple[int, float, str]:
    """Sort key of motors: a sudden rise first; a failed night no later than a stale motor."""
    place = -1 if motor.is_sudden else ORDER.index(motor.state)
    if motor.failure:
        place = min(place, ORDER.index("stale"))
    return place, -(motor.change_percent or 0.0), motor.motor_id


def with_acknowledgement(state: MotorState, decisions: Sequence[Decision]) -> MotorState:
    """A state with the last acknowledgement since it began."""
    if state.state_since is None:
        return state
    said = [
        one.note or one.kind
        for one in decisions
        if one.motor_id == state.motor_id
        and one.indicator not in SENSORS
        and one.kind in ("acknowledged", "finding")
        and one.night >= state.state_since
    ]
    return replace(state, acknowledged=said[-1]) if said else state


# Columns that a state is made from.
FIT_COLUMNS = ("motor_id", "night", "status", "reason", "is_primary", *NEWEST_FITS)
TREND_COLUMNS = (
    *("motor_id", "night", "indicator", "value", "state_reason", "sensor_health", *LIMITS),
)
# Of the leakage that is told: the fleet's reference conditions, or the motor's own.
LEAKAGES = ("reference_leakage", "own_reference_leakage")
HOURS_COLUMNS = ("motor_id", "night", "logged_hours")
FILE_COLUMNS = ("motor_id", "night", "message")
# A night is short that has less than this share of the short ones of the last nights before.
SHORT, NIGHTS_COMPARED, FEWEST_COMPARED = 0.8, 15, 5


def latest_states(output: Path, motor_ids: Sequence[str]) -> list[MotorState]:
    """States of some motors by the tables; raises StoreError if one is damaged."""
    fits = read_rows(output, FITS, motor_ids, FIT_COLUMNS).sort("night", "is_primary")
    last, good, data = (
        _by_motor(some)
        for some in (
            fits,
            fits.filter(status=OK),
            fits.filter(pl.col("status").is_in(WITH_SAMPLES)),
        )
    )
    newest = max((row["night"] for row in data.values()), default=None)
    notes = _log_notes(output, data)
    watch = _by_motor(read_rows(output, WATCH, motor_ids).sort("night"))
    nights = {row["night"] for row in watch.values()}
    trends: dict[str, dict[str, Row]] = {name: {} for name in watch}
    for row in read_rows(output, TRENDS, motor_ids, TREND_COLUMNS, nights=nights).to_dicts():
        if row["night"] == watch[row["motor_id"]]["night"]:
            trends[row["motor_id"]][row["indicator"]] = row
    alarms: dict[str, list[Row]] = {}
    for row in read_rows(output, ALARMS, motor_ids).filter(indicator=LEAKAGE).to_dicts():
        alarms.setdefault(row["motor_id"], []).append(row)
    decisions = read_decisions(output)
    found = []
    for name in motor_ids:
        night, newest_row = data.get(name, {}).get("night"), last.get(name, {})
        is_failed = newest_row.get("status") == FAILED
        state = replace(
            _unknown(name),
            reason="no trends yet" if name in last else "no night yet",
            last_night=newest_row.get("night"),
            last_good_night=good.get(name, {}).get("night"),
            data_night=night,
            data_age_nights=(newest - night).days if newest and night else None,
            poor_fit=_poor_fit(good.get(name, {})),
            failure=f"night of {newest_row['night']} failed: {newest_row['reason']}"
            if is_failed
            else "",
            log_note=notes.get(name, ""),
        )
        if name in watch:
            told = WatchRow.of(watch[name])
            since = _since(alarms.get(name, ()), told.state)
            state = _with_watch(state, told, trends[name], since)
        found.append(with_acknowledgement(state, decisions))
    return found


def published_states(output: Path, motor_ids: Sequence[str]) -> list[MotorState]:
    """States of some motors as the last run left them, with what was said of them since.

    Without a table `latest` that is whole they are made from the other tables; raises StoreError if
    one of these is damaged.
    """
    try:
        rows = read_table(whole_file(output, LATEST), LATEST)
    except StoreError as error:
        if error.code != "store_read":
            raise
        return latest_states(output, motor_ids)
    known = {row["motor_id"]: state_of_row(row) for row in rows.to_dicts()}
    decisions = read_decisions(output)
    return [with_acknowledgement(known.get(one, _unknown(one)), decisions) for one in motor_ids]


def _unknown(motor_id: str) -> MotorState:
    return MotorState(motor_id, "insufficient", "no night yet", "Wait for more nights.")


def _with_watch(
    state: MotorState, told: WatchRow, trends: Mapping[str, Row], since: dt.date | None
) -> MotorState:
    """A state with what the watch says of the motor's newest night."""
    at_reference = told.reference_leakage_l_per_min is not None
    limit = trends.get(LEAKAGES[0] if at_reference else LEAKAGES[1], {})
    is_changed = told.state in CHANGED
    mends = state.failure and not is_changed
    limits: dict[str, Any] = {name: limit.get(name) for name in LIMITS}
    return replace(
        state,
        state=told.state,
        reason=told.sentence,
        advice="Mend what failed in the last night." if mends else told.advice,
        watch=told,
        state_since=since,
        sensor_health=limit.get("sensor_health"),
        oil=trends.get("oil_viscosity", {}).get("state_reason") or "",
        limit_dates=limit_dates(limit) if limit and is_changed else "",
        **limits,
    )


def _since(alarms: Iterable[Row], state: str) -> dt.date | None:
    """First night of a state that stands, by the changes of state; None where it is ok."""
    first = None
    for row in sorted(alarms, key=lambda row: row["night"]):
        if row["to_state"] != state:
            first = None
        elif first is None:
            first = row["night"]
    return None if state == "ok" else first


def _by_motor(rows: pl.DataFrame) -> dict[str, Row]:
    """The last of each motor's rows, by motor."""
    last = rows.unique("motor_id", keep="last", maintain_order=True)
    return {row["motor_id"]: row for row in last.iter_rows(named=True)}


def _log_notes(output: Path, data: Mapping[str, Row]) -> dict[str, str]:
    """What the log of each motor's newest night lacks: it is shorter than before, or cut."""
    nights = list(islice(nights_back(output, OPERATION), NIGHTS_COMPARED))
    logged = read_rows(output, OPERATION, list(data), HOURS_COLUMNS, nights=nights)
    files = read_rows(output, INPUT_FILES, list(data), FILE_COLUMNS, nights=nights)
    hours: dict[str, list[float]] = {name: [] for name in data}
    for row in logged.sort("night").drop_nulls().to_dicts():
        if row["night"] <= data[row["motor_id"]]["night"]:
            hours[row["motor_id"]].append(row["logged_hours"])
    said: dict[str, list[str]] = {name: [] for name in data}
    for row in files.drop_nulls().to_dicts():
        if row["night"] == data[row["motor_id"]]["night"]:
            said[row["motor_id"]].append(row["message"])
    found = {}
    for name, parts in said.items():
        before, last = sorted(hours[name][:-1]), hours[name][-1:]
        # Nights before that are short, too, one in five, are no measure.
        if len(before) >= FEWEST_COMPARED and last[0] < SHORT * before[len(before) // 5]:
            parts.insert(0, f"{last[0]:.1f} h of log, {median(before):.1f} h in the nights before")
        if parts:
            found[name] = f"night of {data[name]['night']}: {'; '.join(parts)}"
    return found


def _poor_fit(last: Row) -> str:
    """Sentence on the fit of a motor's last good night if it is poor; else empty."""
    poor = [
        fit_words(FITS_OF_A_NIGHT[name], last[name])
        for name in NEWEST_FITS
        if last and is_poor(last[name])
    ]
    return f"fit of {last['night']}: {', '.join(poor)}" if poor else ""
