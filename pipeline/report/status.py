"""The fleet's state tonight, from the published tables: what needs attention first."""

from __future__ import annotations

import datetime as dt
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import polars as pl

from leakage.validation import is_poor
from pipeline.errors import UsageError
from pipeline.look.state import CLEAR, LOOK_NOW, LookStanding, look_standings
from pipeline.report.explain import FITS_OF_A_NIGHT, fit_words
from pipeline.schema import ALARMS, FITS, TRENDS
from pipeline.store.heartbeat import Beat, last_good_run, read_heartbeat
from pipeline.store.manifest import manifest_keys
from pipeline.store.tables import read_rows
from pipeline.store.verification import TableFault, compare_published
from pipeline.telling.delivery import Receiver
from pipeline.telling.outbox import Backlog, backlogs
from pipeline.trends.decisions import Decision, read_decisions
from pipeline.trends.words import limit_dates

Row = dict[str, Any]

# From what needs attention most to what needs none.
CHANGED = ("alarm", "warning", "common_cause")
ORDER = (*CHANGED, "stale", "insufficient", "ok")
REFERENCES = ("reference_leakage", "own_reference_leakage", "comparable_drain_flow")
GAP = "gap_change_"
SENSORS = ("pressure_zero", "flow_zero")
TEMPERATURE_EFFECT, MODEL_MISFIT = "temperature_effect", "model_misfit"
TONIGHTS_FITS = ("training_fit_percent", "validation_fit_percent")
# States that an inspection can confirm, and those that can be acknowledged.
RAISED = ("warning", "alarm", "common_cause")
TOLD = (*RAISED, "stale")


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
    look
        Standing of the looks within the day; None where there was none.
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
    look: LookStanding | None = None

    @property
    def why(self) -> str:
        """The state in words, with what else is to be known, and an acknowledgement."""
        dates = f"its limit {self.limit_dates}" if self.limit_dates else ""
        reason = self.reason or "no change of external leakage"
        beside = (self.temperature_effect, self.model_misfit, self.failure, self.poor_fit)
        look = "" if self.look is None or self.look.state == CLEAR else self.look.words
        parts = (look, reason, dates, *beside)
        words = "; ".join(part for part in parts if part)
        return f"{words} (acknowledged: {self.acknowledged})" if self.acknowledged else words


@dataclass(frozen=True, slots=True)
class FleetStatus:
    """All motors, those that need attention first.

    Attributes
    ----------
    motors
        One each.
    last_good_run
        When the last run ended that went through all motors; None where none did.
    findings_confirmed, findings
        Alarms with wear found at the inspection, and all inspected alarms.
    beat
        Heartbeat of the current or the last run; None before the first.
    receivers
        Changes of state not yet delivered, by receiver.
    damage
        Published files that are gone, or were written to since and are not what was published.
    """

    motors: tuple[MotorState, ...]
    last_good_run: dt.datetime | None
    findings_confirmed: int
    findings: int
    beat: Beat | None = None
    receivers: tuple[Backlog, ...] = ()
    damage: tuple[TableFault, ...] = ()


def fleet_status(
    output: Path, motor_ids: Sequence[str], receivers: Sequence[Receiver] = (), fleet: str = ""
) -> FleetStatus:
    """The state of some motors, and undelivered changes by receiver.

    Raises
    ------
    StoreError
        If a table is damaged.
    """
    trends = read_rows(output, TRENDS, motor_ids)
    keys = ("motor_id", "night", "status", "reason", "is_primary")
    columns = (*keys, "reference_verdict", *TONIGHTS_FITS)
    fits = read_rows(output, FITS, motor_ids, columns)
    decisions = read_decisions(output)
    looks = look_standings(output, motor_ids)
    motors = [
        motor_state(
            motor_id,
            trends.filter(motor_id=motor_id),
            fits.filter(motor_id=motor_id),
            [one for one in decisions if one.motor_id == motor_id],
            looks.get(motor_id),
        )
        for motor_id in motor_ids
    ]
    findings = last_findings(decisions)
    return FleetStatus(
        tuple(sorted(motors, key=urgency)),
        last_good_run(output),
        findings.count("confirmed"),
        len(findings),
        read_heartbeat(output),
        backlogs(output, receivers, fleet),
        compare_published(output, manifest_keys(output), lambda _: False).faults,
    )


def last_findings(decisions: Sequence[Decision]) -> list[str]:
    """Finding of each alarm that was inspected; of several the last."""
    found = {
        (one.motor_id, one.indicator, one.night): one.finding
        for one in decisions
        if one.finding is not None
    }
    return list(found.values())


def urgency(motor: MotorState) -> tuple[int, float, str]:
    """Sort key of motors: a sudden rise first; a failed night no later than a stale motor."""
    is_sudden = motor.look is not None and motor.look.state == LOOK_NOW
    place = -1 if is_sudden else ORDER.index(motor.state)
    if motor.failure:
        place = min(place, ORDER.index("stale"))
    return place, -(motor.deviation_percent or 0.0), motor.motor_id


def motor_state(
    motor_id: str,
    trends: pl.DataFrame,
    fits: pl.DataFrame,
    decisions: Sequence[Decision],
    look: LookStanding | None = None,
) -> MotorState:
    """The state of one motor, from its own rows of `trends` and `fits`, decisions and looks."""
    state = MotorState(
        motor_id=motor_id,
        state="insufficient",
        reason="no night yet" if fits.is_empty() else "no trends yet",
        last_night=_last(fits),
        last_good_night=_last(fits.filter(status="ok")),
        poor_fit=_poor_fit(fits),
        failure=_failure(fits),
        look=look,
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
    effects = tonight.filter(indicator=TEMPERATURE_EFFECT)["state_reason"]
    misfits = tonight.filter(indicator=MODEL_MISFIT)["state_reason"]
    began = tonight.filter(pl.col("state").is_in(CHANGED))["change_start"].max()
    assert began is None or isinstance(began, dt.date)
    leakage_night, leakage = _leakage(trends, began)
    gap = _largest_gap_change(trends, began)
    return replace(
        state,
        state=worst["state"],
        indicator=None if is_ok else worst["indicator"],
        reason=next(iter(drifts), None) if is_ok else worst["state_reason"],
        leakage_l_per_min=leakage.get("value"),
        deviation_percent=leakage.get("deviation_percent"),
        sensor_health=worst["sensor_health"],
        acknowledged=_acknowledged(worst, trends, decisions),
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
        model_misfit=next(iter(misfits), None) or "",
    )


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


def _acknowledged(
    worst: dict[str, object], trends: pl.DataFrame, decisions: Sequence[Decision]
) -> str:
    if worst["state"] == "ok":
        return ""
    own = trends.filter(indicator=worst["indicator"]).sort("night")
    before = _last(own.filter(pl.col("state") != worst["state"]))
    said = [
        one
        for one in decisions
        if one.indicator in ("", worst["indicator"])
        and one.kind in ("acknowledged", "finding")
        and (before is None or one.night > before)
    ]
    return said[-1].note or said[-1].kind if said else ""


def last_alarm(
    output: Path, motor_id: str, name: str, states: Collection[str]
) -> tuple[str, dt.date]:
    """The indicator of a name, and the night of its last alarm in one of some states.

    The name is that in the tables (``K_piston_ring``) or in words (piston ring leakage).

    Raises
    ------
    UsageError
        ``no_alarm``: there was none; the message lists the alarms so far.
    """
    rows = read_rows(output, ALARMS, [motor_id], ("motor_id", "night", "indicator", "to_state"))
    raised = rows.filter(pl.col("to_state").is_in(list(states)))
    known = sorted(raised["indicator"].unique())
    indicator = name if name in known else _in_words(known).get(_plain(name))
    if indicator is None:
        named = ", ".join(known) or "none"
        raise UsageError(
            "no_alarm", f"{motor_id} has had no alarm of {name!r}; alarms so far: {named}"
        )
    night = _last(raised.filter(indicator=indicator))
    assert night is not None
    return indicator, night


def _in_words(indicators: Sequence[str]) -> dict[str, str]:
    """Indicators by all that they are called; a path's name alone is its leakage."""
    from pipeline.trends.words import name_of  # heavy, and seldom needed

    paths = {_plain(one.removeprefix("K_")): one for one in indicators if one.startswith("K_")}
    names = {_plain(name): one for one in indicators for name in (one, name_of(one))}
    return paths | names


def _plain(name: str) -> str:
    return name.strip().replace("_", " ").lower().removeprefix("the ")


def known_indicators(output: Path, motor_id: str) -> list[str]:
    """Indicators of a motor that have a baseline of their own, by its trends; none before those."""
    rows = read_rows(output, TRENDS, [motor_id], ("motor_id", "indicator", "n_slope", "state"))
    # What follows from another one (a path's leakage, its gap) begins anew with that.
    own = rows.filter(pl.col("n_slope").is_not_null() | pl.col("indicator").is_in(SENSORS))
    return sorted(own["indicator"].unique())


def age_in_hours(text: str) -> float:
    """Hours of an age such as 26h, 90m or 2d.

    Raises
    ------
    UsageError
        ``age``.

    Examples
    --------
    >>> age_in_hours("26h"), age_in_hours("2d"), age_in_hours("90m")
    (26.0, 48.0, 1.5)
    """
    factors = {"m": 1 / 60, "h": 1.0, "d": 24.0}
    try:
        hours = float(text[:-1]) * factors[text[-1]]
    except (ValueError, KeyError, IndexError):
        raise UsageError("age", f"got {text!r}; expected an age such as 26h, 90m or 2d") from None
    if not 0 < hours < float("inf"):
        raise UsageError("age", f"got {text!r}; expected an age such as 26h, 90m or 2d")
    return hours
