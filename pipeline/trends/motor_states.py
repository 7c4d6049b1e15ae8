"""A motor's state as rows: what `status` prints and `latest` publishes, and changes in `alarms`.

What was raised is never deleted.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

import polars as pl

from leakage.estimation.validation import is_poor
from pipeline.errors import StoreError
from pipeline.schema import ALARM_CONTENT, ALARMS, FAILED, LATEST, NIGHTS, OK, WITH_SAMPLES, Row
from pipeline.store.tables import read_rows, read_table, whole_file
from pipeline.trends.decisions import LEAKAGE, SENSORS, Decision, read_decisions
from pipeline.trends.sentences import WAIT, change_in_force, headline, limit_dates

# From what needs attention most to what needs none.
CHANGED = ("alarm", "warning", "common_cause")
# Of a motor that the config has no more, until a person confirms it.
REMOVED = "removed"
STALE = "stale"
ORDER = (*CHANGED, STALE, REMOVED, "insufficient", "ok")
FITS_OF_A_NIGHT = {
    "training_fit_percent": "training",
    "validation_fit_percent": "validation",
    "previous_model_fit_percent": "previous night's model",
}
# States that ask for something.
ACTIONABLE = (*CHANGED, STALE, REMOVED)
# States of the intraday check: a sudden rise, and none.
RISEN, CLEAR = "risen", "clear"


# What is said of a motor, and stays in force in a night of which no trends are made.
CARRIED = (
    *(column.name for column in NIGHTS.columns if column.group in ("state", "baseline")),
    *("sentence", "advice"),
)
NO_TRENDS: Row = {"state": "insufficient", "sentence": "no trends yet", "advice": WAIT}


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
    """A motor's state: its row of `latest`, and its intraday check; None where that is silent."""

    row: Mapping[str, Any]
    intraday: IntradayStatus | None = None

    @property
    def motor_id(self) -> str:
        """The motor."""
        return str(self.row["motor_id"])

    @property
    def state(self) -> str:
        """Its state, as in `nights`."""
        return str(self.row["state"])

    @property
    def advice(self) -> str:
        """What to do."""
        if self.failure and self.state not in CHANGED:
            return "Mend what failed in the last night."
        return str(self.row["advice"])

    @property
    def change(self) -> str:
        """Leakage against its baseline, with its interval; empty where it is not known."""
        return change_in_force(self.row)

    @property
    def headline(self) -> str:
        """The same, since when, and the part; the sentence where that says more."""
        is_present = not self.is_sudden and self.state not in (STALE, REMOVED)
        return (headline(self.row) if is_present else "") or self.sentence

    @property
    def since(self) -> str:
        """First night of the change, else of the state; empty where ok."""
        return str(self.row["onset"] or self.row["state_since"] or "")

    @property
    def sentence(self) -> str:
        """The state in words, a sudden rise within the day first."""
        rise = self.intraday.words if self.intraday is not None and self.is_sudden else ""
        return f"{rise}; {self.row['sentence']}" if rise else str(self.row["sentence"])

    @property
    def failure(self) -> str:
        """Sentence on its newest night if that failed; else empty."""
        if self.row["status"] != FAILED:
            return ""
        return f"night of {self.row['night']} failed: {self.row['reason']}"

    @property
    def poor_fit(self) -> str:
        """Sentence on the newest fit if it is poor; else empty."""
        newest = {name: self.row[f"{name}_fit_percent"] for name in ("training", "validation")}
        poor = [fit_words(name, fit) for name, fit in newest.items() if is_poor(fit)]
        return f"fit of {self.row['last_fit_night']}: {', '.join(poor)}" if poor else ""

    @property
    def notes(self) -> tuple[str, ...]:
        """Further notes on the motor, in words."""
        dates = limit_dates(self.row) if self.state in CHANGED else ""
        if dates:
            dates = f"alarm level (+{self.row['alarm_level_percent']:g} %) {dates}"
        log_note = self.row["log_note"]
        log = f"night of {self.row['night']}: {log_note}" if log_note else ""
        return tuple(filter(None, (dates, self.failure, log, self.poor_fit)))

    @property
    def why(self) -> str:
        """The sentence with its notes, and an acknowledgement."""
        words = "; ".join((self.sentence, *self.notes))
        acknowledgement = self.row["acknowledged"]
        return f"{words} (acknowledged: {acknowledgement})" if acknowledgement else words

    @property
    def needs_attention(self) -> bool:
        """The state asks for something, or the last night failed."""
        return self.is_sudden or self.state in ACTIONABLE or bool(self.failure)

    @property
    def needs_acknowledgement(self) -> bool:
        """A change of state is in force that a person may acknowledge."""
        return self.state in ACTIONABLE

    @property
    def is_sudden(self) -> bool:
        """A sudden rise within the day is in force."""
        return self.intraday is not None and self.intraday.state == RISEN


def fit_words(name: str, percent: float) -> str:
    """Return a fit with its name; a poor fit is called that.

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
        place = min(place, ORDER.index(STALE))
    return place, -(motor.row["leakage_change_percent"] or 0.0), motor.motor_id


def with_acknowledgement(row: Row, decisions: Sequence[Decision]) -> Row:
    """Return a row of `latest` with the last acknowledgement since its state began."""
    acknowledgements = [
        decision.note or decision.kind
        for decision in decisions
        if row["state_since"] is not None
        and decision.motor_id == row["motor_id"]
        and decision.indicator not in SENSORS
        and decision.kind in ("acknowledged", "finding")
        and decision.night >= row["state_since"]
    ]
    return row | {"acknowledged": acknowledgements[-1]} if acknowledgements else row


def latest_rows(output: Path, motor_ids: Sequence[str], gone: Sequence[str] = ()) -> list[Row]:
    """Return rows of `latest` of some motors, and of those that are gone."""
    every = [*motor_ids, *gone]
    nights = read_rows(output, NIGHTS, every).drop("run_id").sort("night")
    last, data, fitted = (
        _by_motor(some)
        for some in (
            nights,
            nights.filter(pl.col("status").is_in(WITH_SAMPLES)),
            nights.filter(status=OK),
        )
    )
    newest = max((row["night"] for row in data.values()), default=None)
    sensors = _sensors(output, every)
    decisions = read_decisions(output)
    rows = []
    for name in every:
        row = _unknown(name)
        if name in last:
            of_data = data.get(name, {})
            row |= of_data | {key: value for key, value in last[name].items() if value is not None}
            row["sensor_health"] = sensors.get(name, "unknown")
            if of_data and newest is not None:
                row["data_age_nights"] = (newest - of_data["night"]).days
            row["last_fit_night"] = fitted.get(name, {}).get("night")
        row = with_acknowledgement(row, decisions)
        rows.append(_as_removed(row) if name in gone else row)
    return rows


def in_state_before(row: Row, published: pl.DataFrame) -> Row:
    """Return night's own row in the state of its motor, given the published rows in order."""
    before = published.filter(pl.col("night") <= row["night"]).select(CARRIED)
    return row | (before.row(-1, named=True) if before.height else NO_TRENDS)


def _as_removed(row: Row) -> Row:
    was = f"{row['state'].replace('_', ' ')}: {row['sentence']}"
    since = f"the state in force then, since {row['state_since']}" if row["state_since"] else "then"
    advice = "Put its file back, name it as `formerly` of another motor, or confirm it with `ack`."
    sentence = f"in the config no more; {since}, {was}"
    return row | {"state": REMOVED, "sentence": sentence, "advice": advice}


def is_confirmed(row: Row, decisions: Sequence[Decision]) -> bool:
    """Return True where a person has confirmed that a motor is gone."""
    return any(
        (decision.motor_id, decision.kind) == (row["motor_id"], "removed")
        and row["night"] is not None
        and decision.night >= row["night"]
        for decision in decisions
    )


def published_states(output: Path, motor_ids: Sequence[str]) -> list[MotorState]:
    """Return states of motors, and of those gone, by `latest`, else by the other tables."""
    try:
        rows = read_table(whole_file(output, LATEST), LATEST).drop("run_id")
    except StoreError as error:
        if error.code != "store_read":
            raise
        return [MotorState(row) for row in latest_rows(output, motor_ids)]
    known = {row["motor_id"]: row for row in rows.to_dicts()}
    decisions = read_decisions(output)
    gone = [
        name
        for name, row in known.items()
        if row["state"] == REMOVED and name not in motor_ids and not is_confirmed(row, decisions)
    ]
    return [
        MotorState(with_acknowledgement(known.get(name) or _unknown(name), decisions))
        for name in (*motor_ids, *gone)
    ]


def _unknown(motor_id: str) -> Row:
    return dict.fromkeys(LATEST.schema) | {
        "motor_id": motor_id,
        "state": "insufficient",
        "sentence": "no night yet",
        "advice": WAIT,
    }


def _by_motor(rows: pl.DataFrame) -> dict[str, Row]:
    """Return the last of each motor's rows, by motor."""
    last = rows.unique("motor_id", keep="last", maintain_order=True)
    return {row["motor_id"]: row for row in last.iter_rows(named=True)}


def _sensors(output: Path, motor_ids: Sequence[str]) -> dict[str, str]:
    """Return health of each motor's sensors, by the changes of state of their zeros."""
    rows = read_rows(output, ALARMS, motor_ids, ("motor_id", "night", "cause", "to_state"))
    last = rows.filter(pl.col("cause").is_in(SENSORS)).sort("night")
    states: dict[str, set[str]] = {}
    for row in last.unique(("motor_id", "cause"), keep="last").to_dicts():
        states.setdefault(row["motor_id"], set()).add(row["to_state"])
    return {
        name: "drifted" if "warning" in some else "ok" if "ok" in some else "unknown"
        for name, some in states.items()
    }


RECOMPUTED, RECOVERED, INSUFFICIENT = "recomputed", "recovered", "insufficient"
RAISED = ("warning", "alarm")
# Why a motor or a sensor is ok again, by the state before.
WHY_OK = {
    INSUFFICIENT: "baseline set",
    "stale": "there are blocks again",
    "common_cause": "the oil circuit is back where it was",
}
CHANGES = ("leakage_change_percent", "leakage_change_lower", "leakage_change_upper")


def what_of(row: Mapping[str, Any]) -> str:
    """Return what a row of `alarms` is of: the leakage, or the zero of a sensor."""
    return str(row["cause"]) if row["cause"] in SENSORS else LEAKAGE


def alarm_rows(states: Mapping[str, Sequence[Row]], published: Sequence[Row]) -> list[Row]:
    """Return changes of state in some nights, together with what had been raised in them before.

    `states` has by what they are of the states in nights in a row, up to the motor's last;
    `published` are all rows of the motor so far.
    """
    known: dict[str, dict[dt.date, Row]] = {name: {} for name in states}
    for row in published:
        known[what_of(row)][row["night"]] = row
    return [row for name, nights in states.items() for row in _changes(name, nights, known[name])]


def _changes(name: str, nights: Sequence[Row], published: Mapping[dt.date, Row]) -> Iterator[Row]:
    before = [label for label in published if label < nights[0]["night"]]
    reported = str(published[max(before)]["to_state"]) if before else INSUFFICIENT
    raised_on = max(
        (night for night in before if published[night]["to_state"] in RAISED), default=None
    )
    earlier = reported
    for night in nights:
        label, state = night["night"], night["state"]
        old = published.get(label)
        raised = old if old is not None and old["to_state"] in RAISED else None
        row = None
        if state not in (earlier, reported) or (_is_detected(night) and state in CHANGED):
            row = _row(name, night, reported, _words(night, reported, raised))
            if state == "ok" and reported != INSUFFICIENT:
                row["closed_as"] = RECOVERED
        elif raised is not None:
            row = raised
        elif reported != state:
            what = "reported before" if raised_on is None else f"raised on {raised_on}"
            words = f"recomputed: what was {what} is not in the figures as they are now"
            row = _row(name, night, reported, words) | {"closed_as": RECOMPUTED}
            row["cause"] = name if name in SENSORS else None
        if row is not None:
            yield row
            reported = row["to_state"]
            raised_on = label if reported in RAISED else raised_on
        earlier = state


def _is_detected(night: Row) -> bool:
    """Return True in the night in which a change was detected, whatever the state before."""
    return night.get("detected_on") == night["night"] and not night["still_rising"]


def _words(night: Row, before: str, raised: Row | None) -> str:
    """Return what is reported of a change of state; it ends on what to do."""
    words = str(night["sentence"])
    if night["state"] == "ok":
        words = f"{WHY_OK.get(before, 'back where it was')}: {words}"
    if raised is not None and raised["to_state"] != night["state"]:
        words += f"; before its data changed: {str(raised['sentence']).removesuffix('.')}"
    is_order = night["state"] in ACTIONABLE and night["advice"]
    return f"{words}. {night['advice']}" if is_order else words


def _row(name: str, night: Row, before: str, words: str) -> Row:
    motor_id, label = night["motor_id"], night["night"]
    return {
        "id": f"{motor_id} {label} {name}",
        "motor_id": motor_id,
        "night": label,
        "from_state": before,
        "to_state": night["state"],
        "cause": night["cause"],
        **{change: night.get(change) for change in CHANGES},
        "sentence": words,
        "closed_as": None,
    }


def new_rows(rows: Sequence[Row], published: Sequence[Row]) -> list[Row]:
    """Return rows that say something which was not published before."""
    content = itemgetter(*ALARM_CONTENT)
    before = {row["id"]: content(row) for row in published}
    return [row for row in rows if before.get(row["id"]) != content(row)]


def without_past(
    rows: Sequence[Row], new: Sequence[Row], published: Sequence[Row], last_night: dt.date
) -> list[Row]:
    """Return the new rows to notify people of: of past nights those of the state in force."""
    newest = {what_of(row): row for row in rows if row["night"] <= last_night}
    notified = []
    for row in new:
        what, state = what_of(row), row["to_state"]
        reported = max(
            ((old["night"], old["to_state"]) for old in published if what_of(old) == what),
            default=(last_night, INSUFFICIENT),
        )[1]
        is_in_force = row is newest.get(what) and state != reported
        is_news = is_in_force and (state in CHANGED or reported in CHANGED)
        if row["night"] > last_night or is_news:
            notified.append(row)
    return notified
