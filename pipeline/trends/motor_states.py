"""A motor's state in one row: what `status` prints, and the table `latest` publishes."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import polars as pl

from leakage.validation import is_poor
from pipeline.errors import StoreError
from pipeline.schema import FITS, LATEST, TRENDS
from pipeline.store.tables import published_rows, read_rows, whole_file
from pipeline.trends.decisions import Decision, read_decisions
from pipeline.trends.tonight import WITH_SAMPLES
from pipeline.trends.words import FALL, limit_dates

Row = dict[str, Any]

# From what needs attention most to what needs none.
CHANGED = ("alarm", "warning", "common_cause")
ORDER = (*CHANGED, "duty_outside", "stale", "insufficient", "ok")
REFERENCES = ("reference_leakage", "own_reference_leakage", "comparable_drain_flow")
GAP = "gap_change_"
SENSORS = ("pressure_zero", "flow_zero")
TEMPERATURE_EFFECT, MODEL_MISFIT = "temperature_effect", "model_misfit"
OIL_VISCOSITY = "oil_viscosity"
TONIGHTS_FITS = ("training_fit_percent", "validation_fit_percent")
FITS_OF_A_NIGHT = {
    "training_fit_percent": "training",
    "validation_fit_percent": "validation",
    "previous_model_fit_percent": "the model before, on tonight",
}
LIMITS = ("days_to_limit", "days_to_limit_lower", "days_to_limit_upper", "days_to_limit_status")
# Columns that a state is made from.
FIGURES = ("motor_id", "night", "indicator", "value", "lower", "upper", "deviation_percent")
STATES = ("n_slope", "state", "state_reason", "change_start", "path", "sensor_health")
TREND_COLUMNS = (*FIGURES, *STATES, "model_verdict", *LIMITS)
FIT_KEYS = ("motor_id", "night", "status", "reason", "is_primary", "reference_verdict")
FIT_COLUMNS = (*FIT_KEYS, *TONIGHTS_FITS)
# States that ask for something.
TOLD = (*CHANGED, "stale")
# States of the looks within the day: a sudden rise, and none.
LOOK_NOW, CLEAR = "look_now", "clear"
ADVICE = {
    "common_cause": "Check oil, temperature and charge pressure of the circuit first.",
    "duty_outside": "Begin a new baseline if this duty is to stay.",
    "stale": "Check whether the motor's logs arrive, and the reason of its last nights.",
    "insufficient": "Wait for more good nights.",
    "ok": "Nothing to do.",
}


@dataclass(frozen=True, slots=True)
class LookStanding:
    """State of a motor's looks, for people.

    Attributes
    ----------
    state, since, reason
        As of `LookState`; since None: no change of state yet.
    told, confirmed, withdrawn
        Rises told, and those that a night confirmed or withdrew.
    """

    state: str
    since: dt.datetime | None
    reason: str
    told: int = 0
    confirmed: int = 0
    withdrawn: int = 0

    @property
    def words(self) -> str:
        """State in words.

        Examples
        --------
        >>> LookStanding("not_ready", None, "12 of 30 good nights").words
        'within the day not ready: 12 of 30 good nights'
        """
        since = "" if self.since is None else f" since {self.since:%Y-%m-%d %H:%M} UTC"
        return f"within the day {self.state.replace('_', ' ')}{since}: {self.reason}"


@dataclass(frozen=True, slots=True)
class MotorState:
    """A motor's state in its newest night.

    Attributes
    ----------
    state
        The worst of its indicators.
    indicator, reason
        That indicator and its reason in words; of a motor that is ok, the drift of a sensor.
    leakage_l_per_min, deviation_percent
        Reference leakage now, and its deviation from the baseline; at the motor's own conditions
        where it is not known at the fleet's. None where neither is known: a figure counts neither
        if it is older than the change in force, nor if it is stale.
    sensor_health
        ok, drifted or unknown.
    last_night, last_good_night
        Last night with a row, and with a fit; None without one.
    acknowledged
        Note of the last acknowledgement since the state began; empty without one.
    leakage_night
        Last night with a reference leakage; None without one.
    change_start
        First night of the newest change in force; None without one.
    poor_fit, failure
        Sentence on a poor fit of the last good night, and on the last night if it failed; else
        empty.
    leakage_indicator, leakage_lower, leakage_upper
        Indicator that the leakage is from, and its 95 % interval.
    leakage_verdict
        Verdict on the leakage at the reference conditions; None for that at the motor's own.
    gap_path, gap_change_percent
        Path with the largest gap change now, and that change; None where no gap is known.
    limit_dates
        Dates between which the indicator reaches its limit, in words; empty without one.
    temperature_effect
        That loss factors change with temperature, in words; empty where they do not.
    model_misfit
        That the model does not describe the motor, in words; empty where it does.
    model_verdict
        The same as a verdict: supported, doubtful or disproved; None without one.
    oil
        The oil as measured, in words; empty where its data sheet holds.
    path
        Paths whose growth explains the state; None where none is told.
    gap_change_lower, gap_change_upper
        95 % interval of the gap change.
    state_since, known_since
        First night of the state, of the indicator that tells it, and of its stretch of warnings,
        alarms or common causes; None of a motor that is ok.
    days_to_limit, days_to_limit_lower, days_to_limit_upper, days_to_limit_status
        Of the indicator that tells the state, as in `trends`.
    look
        Standing of the looks within the day, which the table `latest` does not hold; None where
        there was none.
    data_night, data_age_nights
        Newest night with samples, and nights from it to the fleet's newest such night.
    """

    motor_id: str
    state: str
    indicator: str | None = None
    reason: str | None = None
    leakage_l_per_min: float | None = None
    deviation_percent: float | None = None
    sensor_health: str | None = None
    last_night: dt.date | None = None
    last_good_night: dt.date | None = None
    acknowledged: str = ""
    leakage_night: dt.date | None = None
    change_start: dt.date | None = None
    poor_fit: str = ""
    failure: str = ""
    leakage_indicator: str | None = None
    leakage_lower: float | None = None
    leakage_upper: float | None = None
    gap_path: str | None = None
    gap_change_percent: float | None = None
    leakage_verdict: str | None = None
    limit_dates: str = ""
    temperature_effect: str = ""
    model_misfit: str = ""
    model_verdict: str | None = None
    oil: str = ""
    path: str | None = None
    gap_change_lower: float | None = None
    gap_change_upper: float | None = None
    state_since: dt.date | None = None
    known_since: dt.date | None = None
    days_to_limit: float | None = None
    days_to_limit_lower: float | None = None
    days_to_limit_upper: float | None = None
    days_to_limit_status: str | None = None
    look: LookStanding | None = None
    data_night: dt.date | None = None
    data_age_nights: int | None = None

    @property
    def sentence(self) -> str:
        """The state in words, a sudden rise within the day first."""
        reason = self.reason or "no change of external leakage"
        rise = self.look.words if self.look is not None and self.is_sudden else ""
        return f"{rise}; {reason}" if rise else reason

    @property
    def notes(self) -> tuple[str, ...]:
        """Further notes on the motor, in words."""
        dates = f"its limit {self.limit_dates}" if self.limit_dates else ""
        oil = "" if self.oil in self.sentence else self.oil
        beside = (self.temperature_effect, self.model_misfit, self.failure, self.poor_fit)
        is_told = self.look is not None and not self.is_sudden and self.look.state != CLEAR
        look = self.look.words if self.look is not None and is_told else ""
        return tuple(note for note in (dates, *beside, oil, look) if note)

    @property
    def why(self) -> str:
        """The sentence with its notes, and an acknowledgement."""
        words = "; ".join((self.sentence, *self.notes))
        return f"{words} (acknowledged: {self.acknowledged})" if self.acknowledged else words

    @property
    def advice(self) -> str:
        """Advice on the state, in words."""
        if self.state in CHANGED and self.reason and FALL in self.reason:
            return "Check oil, sensors and flushing first."
        if self.state in ("warning", "alarm"):
            look = "Look at" if self.state == "alarm" else "Plan a look at"
            parts = (self.path or "").replace("_", " ").replace(" and ", " and the ")
            found = f"the {parts}" if parts else "the motor, as its part is not known,"
            return f"{look} {found}{' at the next stop' if self.state == 'alarm' else ''}."
        if self.failure and self.state not in CHANGED:
            return "Mend what failed in the last night."
        return ADVICE[self.state]

    @property
    def needs_attention(self) -> bool:
        """The state asks for something, or the last night failed."""
        return self.is_sudden or self.state in TOLD or bool(self.failure)

    @property
    def is_sudden(self) -> bool:
        """A sudden rise within the day stands."""
        return self.look is not None and self.look.state == LOOK_NOW


# What `latest` holds.
STORED = tuple(one.name for one in fields(MotorState) if one.name != "look")


def latest_states(output: Path, motor_ids: Sequence[str]) -> list[MotorState]:
    """States of some motors by `trends` and `fits`.

    Raises
    ------
    StoreError
        If a table is damaged.
    """
    rows = read_rows(output, TRENDS, motor_ids, TREND_COLUMNS)
    trends = rows.partition_by("motor_id", as_dict=True)
    fits = read_rows(output, FITS, motor_ids, FIT_COLUMNS)
    own_fits = fits.partition_by("motor_id", as_dict=True)
    decisions = read_decisions(output)
    none = rows.clear(), fits.clear()
    states = [
        motor_state(
            motor_id,
            trends.get((motor_id,), none[0]),
            own_fits.get((motor_id,), none[1]),
            [one for one in decisions if one.motor_id == motor_id],
        )
        for motor_id in motor_ids
    ]
    newest = max((one.data_night for one in states if one.data_night), default=None)
    return [
        replace(one, data_age_nights=(newest - one.data_night).days)
        if newest and one.data_night
        else one
        for one in states
    ]


def latest_rows(states: Iterable[MotorState], run_id: str) -> list[Row]:
    """Rows of `latest`."""
    own = ({name: getattr(one, name) for name in STORED} | {"sentence": one.why} for one in states)
    return [row | {"run_id": run_id} for row in own]


def published_states(output: Path, motor_ids: Sequence[str]) -> list[MotorState]:
    """States of some motors as the last run left them, with what was said of them since.

    Without a table `latest` that is whole they are made from the other tables.

    Raises
    ------
    StoreError
        If one of these is damaged.
    """
    try:
        rows = published_rows(output, whole_file(output, LATEST), LATEST)
    except StoreError as error:
        if error.code != "store_read":
            raise
        return latest_states(output, motor_ids)
    known = {row["motor_id"]: MotorState(**row) for row in rows.select(STORED).to_dicts()}
    decisions = read_decisions(output)
    return [
        with_acknowledgement(
            known.get(motor_id, MotorState(motor_id, "insufficient", reason="no night yet")),
            [one for one in decisions if one.motor_id == motor_id],
        )
        for motor_id in motor_ids
    ]


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
    return place, -(motor.deviation_percent or 0.0), motor.motor_id


def motor_state(
    motor_id: str, trends: pl.DataFrame, fits: pl.DataFrame, decisions: Sequence[Decision]
) -> MotorState:
    """The state of one motor, from its own rows of `trends` and `fits` and its decisions."""
    state = MotorState(
        motor_id=motor_id,
        state="insufficient",
        reason="no night yet" if fits.is_empty() else "no trends yet",
        last_night=_last(fits),
        last_good_night=_last(fits.filter(status="ok")),
        poor_fit=_poor_fit(fits),
        failure=_failure(fits),
        data_night=_last(fits.filter(pl.col("status").is_in(WITH_SAMPLES))),
    )
    if trends.is_empty():
        return state
    tonight = trends.filter(pl.col("night") == pl.col("night").max())
    watched = tonight.filter(pl.col("n_slope").is_not_null())
    worst = min(
        watched.iter_rows(named=True),
        key=lambda row: (ORDER.index(row["state"]), -(row["deviation_percent"] or 0.0)),
    )
    # A motor that never sees the fleet's conditions is judged by its other indicators.
    if worst["state"] in ("insufficient", "stale") and "ok" in set(watched["state"]):
        worst = worst | {"state": "ok"}
    if worst["state"] == "insufficient":
        progress = tonight.filter(indicator="baseline_progress")["state_reason"]
        worst = worst | {"state_reason": next(iter(progress), worst["state_reason"])}
    is_ok = worst["state"] == "ok"
    drifts = tonight.filter(pl.col("indicator").is_in(SENSORS), state="warning")["state_reason"]
    effects = tonight.filter(indicator=TEMPERATURE_EFFECT, state="ok")["state_reason"]
    oils = tonight.filter(indicator=OIL_VISCOSITY)["state_reason"]
    misfit = next(tonight.filter(indicator=MODEL_MISFIT).iter_rows(named=True), {})
    began = tonight.filter(pl.col("state").is_in(CHANGED))["change_start"].max()
    assert began is None or isinstance(began, dt.date)
    leakage_night, leakage = _leakage(trends, began)
    gap = _largest_gap_change(trends, began)
    found = replace(
        state,
        state=worst["state"],
        indicator=None if is_ok else worst["indicator"],
        reason=next(iter(drifts), None) if is_ok else worst["state_reason"],
        leakage_l_per_min=leakage.get("value"),
        deviation_percent=leakage.get("deviation_percent"),
        sensor_health=worst["sensor_health"],
        state_since=None if is_ok else _state_since(worst, trends),
        leakage_night=leakage_night,
        change_start=began,
        leakage_indicator=leakage.get("indicator"),
        leakage_lower=leakage.get("lower"),
        leakage_upper=leakage.get("upper"),
        leakage_verdict=_verdict(fits, leakage_night, leakage),
        gap_path=gap["indicator"].removeprefix(GAP) if gap else None,
        gap_change_percent=gap.get("value"),
        limit_dates="" if is_ok else limit_dates(worst),
        temperature_effect=next(iter(effects), None) or "",
        model_misfit=misfit.get("state_reason") or "",
        model_verdict=misfit.get("model_verdict"),
        oil=next(iter(oils), None) or "",
        path=_paths(worst, watched),
        known_since=_known_since(worst, trends),
        gap_change_lower=gap.get("lower"),
        gap_change_upper=gap.get("upper"),
        **{name: worst[name] for name in LIMITS},
    )
    return with_acknowledgement(found, decisions)


def _last(rows: pl.DataFrame) -> dt.date | None:
    """The last night of some rows; None of none."""
    night = rows["night"].max()
    assert night is None or isinstance(night, dt.date)
    return night


def _leakage(trends: pl.DataFrame, change_start: dt.date | None) -> tuple[dt.date | None, Row]:
    """Last night and row of the reference leakage, of the fleet's conditions or the motor's own."""
    found = [one for name in REFERENCES if (one := _newest(trends, name, change_start))]
    return next((one for one in found if one[1]), found[0] if found else (None, {}))


def _verdict(fits: pl.DataFrame, night: dt.date | None, leakage: Row) -> str | None:
    """Verdict of a night on the leakage at the fleet's reference conditions."""
    if leakage.get("indicator") != REFERENCES[0]:
        return None
    rows = fits.filter("is_primary", pl.col("night") == night)["reference_verdict"]
    return None if rows.is_empty() else str(rows[0])


def _largest_gap_change(trends: pl.DataFrame, change_start: dt.date | None) -> Row:
    """Row of the gap that has changed most; empty without one."""
    names = sorted(name for name in trends["indicator"].unique() if name.startswith(GAP))
    found = [_newest(trends, name, change_start) for name in names]
    rows = [one[1] for one in found if one and one[1]]
    return max(rows, key=lambda row: abs(row["value"]), default={})


def _newest(
    trends: pl.DataFrame, indicator: str, change_start: dt.date | None
) -> tuple[dt.date, Row] | None:
    """Night and row of an indicator's newest figure; the row is empty where it no longer holds."""
    own = trends.filter(indicator=indicator).sort("night")
    known = own.filter(pl.col("value").is_not_null())
    if known.is_empty():
        return None
    last, tonight = known.row(-1, named=True), own.row(-1, named=True)
    night = last["night"]
    # Without a baseline nothing says when a figure is stale.
    holds = night == tonight["night"] or tonight["state"] not in ("stale", "insufficient")
    is_now = holds and (change_start is None or night >= change_start)
    return night, last if is_now else {}


def _failure(fits: pl.DataFrame) -> str:
    """Sentence on a motor's last night if it failed; else empty."""
    for row in fits.sort("night").tail(1).filter(status="failed").iter_rows(named=True):
        return f"night of {row['night']} failed: {row['reason']}"
    return ""


def _poor_fit(fits: pl.DataFrame) -> str:
    """Sentence on the fit of a motor's last good night if it is poor; else empty."""
    last = fits.filter("is_primary", status="ok").sort("night").tail(1)
    for row in last.iter_rows(named=True):
        poor = [
            fit_words(FITS_OF_A_NIGHT[name], row[name])
            for name in TONIGHTS_FITS
            if is_poor(row[name])
        ]
        return f"fit of {row['night']}: {', '.join(poor)}" if poor else ""
    return ""


def _paths(worst: Row, watched: pl.DataFrame) -> str | None:
    """Paths behind the worst indicator: all gaps in its state, if it is one of a gap."""
    if not worst["indicator"].startswith("K_"):
        return None if worst["path"] is None else str(worst["path"])
    beside = watched.filter(pl.col("indicator").str.starts_with("K_"), state=worst["state"])
    gaps = dict.fromkeys((worst["indicator"], *beside["indicator"]))
    return " and ".join(name.removeprefix("K_") for name in gaps)


def _known_since(worst: Row, trends: pl.DataFrame) -> dt.date | None:
    """First night of an indicator's stretch of states that tell a change; None if it has none."""
    own = trends.filter(indicator=worst["indicator"]).sort("night")
    is_told = pl.col("state").is_in(CHANGED)
    before = _last(own.filter(~is_told))
    told = own.filter(is_told) if before is None else own.filter(is_told, pl.col("night") > before)
    return None if worst["state"] not in CHANGED else told["night"][0]


def _state_since(worst: Row, trends: pl.DataFrame) -> dt.date | None:
    """First night of the state of a row of tonight."""
    own = trends.filter(indicator=worst["indicator"]).sort("night")
    before = _last(own.filter(pl.col("state") != worst["state"]))
    after = own if before is None else own.filter(pl.col("night") > before)
    first = after["night"].min()
    assert first is None or isinstance(first, dt.date)
    return first


def with_acknowledgement(state: MotorState, decisions: Sequence[Decision]) -> MotorState:
    """A state with the last acknowledgement since it began, of a motor's decisions."""
    if state.state_since is None:
        return state
    said = [
        one.note or one.kind
        for one in decisions
        if one.indicator in ("", state.indicator)
        and one.kind in ("acknowledged", "finding")
        and one.night >= state.state_since
    ]
    return replace(state, acknowledged=said[-1]) if said else state
