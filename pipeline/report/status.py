"""The fleet's state tonight, from the published tables: what needs attention first."""

from __future__ import annotations

import datetime as dt
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import polars as pl

from leakage.validation import is_poor
from pipeline.errors import UsageError
from pipeline.report.explain import FITS_OF_A_NIGHT, fit_words
from pipeline.schema import ALARMS, FITS, TRENDS
from pipeline.store.heartbeat import Beat, last_good_run, read_heartbeat
from pipeline.store.manifest import manifest_keys
from pipeline.store.tables import read_rows
from pipeline.store.verification import TableFault, compare_published
from pipeline.telling.delivery import Receiver
from pipeline.telling.outbox import Backlog, backlogs
from pipeline.trends.decisions import Decision, read_decisions

# From what needs attention most to what needs none.
CHANGED = ("alarm", "warning", "common_cause")
ORDER = (*CHANGED, "stale", "insufficient", "ok")
REFERENCES = ("reference_leakage", "own_reference_leakage")
SENSORS = ("pressure_zero", "flow_zero")
TONIGHTS_FITS = ("training_fit_percent", "validation_fit_percent")
# States that an inspection can confirm, and those that can be acknowledged.
RAISED = ("warning", "alarm", "common_cause")
TOLD = (*RAISED, "stale")


@dataclass(frozen=True, slots=True)
class MotorState:
    """A motor as it stands.

    Attributes
    ----------
    state
        The worst of its indicators.
    indicator, reason
        Of that one: which, and why in words; of a motor that is ok, that a sensor drifts.
    leakage_l_per_min, deviation_percent
        Reference leakage now, and how far from its baseline; of the motor's own conditions where
        the fleet's is not known. None where neither is: nights before the change that stands told
        do not count, nor do those before the figure went stale.
    sensor_health
        ok, drifted or unknown.
    last_night, last_good_night
        Last night with a row, and with a fit; None without one.
    acknowledged
        What somebody said of it since the state began; empty for nothing.
    leakage_night
        Last night with a reference leakage; None where there never was one.
    change_start
        First night of the newest change that stands told; None where none does.
    poor_fit
        That the model of the last good night describes it poorly, in words; empty where not.
    """

    motor_id: str
    state: str
    indicator: str | None
    reason: str | None
    leakage_l_per_min: float | None
    deviation_percent: float | None
    sensor_health: str | None
    last_night: dt.date | None
    last_good_night: dt.date | None
    acknowledged: str
    leakage_night: dt.date | None = None
    change_start: dt.date | None = None
    poor_fit: str = ""


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
        Alarms whose inspection found wear, and all that were inspected.
    beat
        What the run that is under way, or the last one, says of itself; None before the first.
    receivers
        What each receiver of changes of state has not been told.
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
    """The state of some motors, and what receivers of the fleet's alarms have yet to be told.

    Raises
    ------
    StoreError
        If a table is damaged.
    """
    trends = read_rows(output, TRENDS, motor_ids)
    columns = ("motor_id", "night", "status", "is_primary", *TONIGHTS_FITS)
    fits = read_rows(output, FITS, motor_ids, columns)
    decisions = read_decisions(output)
    motors = [
        motor_state(
            motor_id,
            trends.filter(motor_id=motor_id),
            fits.filter(motor_id=motor_id),
            [one for one in decisions if one.motor_id == motor_id],
        )
        for motor_id in motor_ids
    ]
    findings = last_findings(decisions)
    return FleetStatus(
        tuple(sorted(motors, key=_urgency)),
        last_good_run(output),
        findings.count("confirmed"),
        len(findings),
        read_heartbeat(output),
        backlogs(output, receivers, fleet),
        compare_published(output, manifest_keys(output), lambda _: False).faults,
    )


def last_findings(decisions: Sequence[Decision]) -> list[str]:
    """What was found of each alarm that was inspected; said again, the last word counts."""
    found = {
        (one.motor_id, one.indicator, one.night): one.finding
        for one in decisions
        if one.finding is not None
    }
    return list(found.values())


def _urgency(motor: MotorState) -> tuple[int, float, str]:
    return ORDER.index(motor.state), -(motor.deviation_percent or 0.0), motor.motor_id


def motor_state(
    motor_id: str, trends: pl.DataFrame, fits: pl.DataFrame, decisions: Sequence[Decision]
) -> MotorState:
    """The state of one motor, from its own rows of `trends` and `fits` and what was said of it."""
    last_night, good = _last(fits), _last(fits.filter(status="ok"))
    if trends.is_empty():
        return MotorState(
            motor_id=motor_id,
            state="insufficient",
            indicator=None,
            reason="no trends yet",
            leakage_l_per_min=None,
            deviation_percent=None,
            sensor_health=None,
            last_night=last_night,
            last_good_night=good,
            acknowledged="",
            poor_fit=_poor_fit(fits),
        )
    tonight = trends.filter(pl.col("night") == pl.col("night").max())
    watched = tonight.filter(pl.col("n_slope").is_not_null())
    worst = min(
        watched.iter_rows(named=True),
        key=lambda row: (ORDER.index(row["state"]), -(row["deviation_percent"] or 0.0)),
    )
    # A motor that never sees the fleet's conditions is judged by its other indicators.
    if worst["state"] in ("insufficient", "stale") and "ok" in set(watched["state"]):
        worst = worst | {"state": "ok"}
    drifts = tonight.filter(pl.col("indicator").is_in(SENSORS), state="warning")["state_reason"]
    began = tonight.filter(pl.col("state").is_in(CHANGED))["change_start"].max()
    assert began is None or isinstance(began, dt.date)
    leakage = _leakage(trends, began)
    return MotorState(
        motor_id=motor_id,
        state=worst["state"],
        indicator=worst["indicator"] if worst["state"] != "ok" else None,
        reason=worst["state_reason"] if worst["state"] != "ok" else next(iter(drifts), None),
        leakage_l_per_min=leakage.l_per_min,
        deviation_percent=leakage.deviation_percent,
        sensor_health=worst["sensor_health"],
        last_night=last_night,
        last_good_night=good,
        acknowledged=_acknowledged(worst, trends, decisions),
        leakage_night=leakage.night,
        change_start=began,
        poor_fit=_poor_fit(fits),
    )


def _last(rows: pl.DataFrame) -> dt.date | None:
    """The last night of some rows; None of none."""
    night = rows["night"].max()
    assert night is None or isinstance(night, dt.date)
    return night


@dataclass(frozen=True, slots=True)
class _Leakage:
    """A reference leakage: figures where they hold now, and the night of the last there was."""

    l_per_min: float | None = None
    deviation_percent: float | None = None
    night: dt.date | None = None


def _leakage(trends: pl.DataFrame, change_start: dt.date | None) -> _Leakage:
    """The reference leakage now, of the fleet's conditions or else of the motor's."""
    last = [one for name in REFERENCES if (one := _last_leakage(trends, name, change_start))]
    now = [one for one in last if one.l_per_min is not None]
    return next(iter(now or last), _Leakage())


def _last_leakage(trends: pl.DataFrame, name: str, change_start: dt.date | None) -> _Leakage | None:
    """A reference leakage that was ever known; without figures where they say nothing of now."""
    own = trends.filter(indicator=name).sort("night")
    known = own.filter(pl.col("value").is_not_null())
    if known.is_empty():
        return None
    last, tonight = known.row(-1, named=True), own.row(-1, named=True)
    night = last["night"]
    # Without a baseline nothing says when a figure is stale.
    held = night == tonight["night"] or tonight["state"] not in ("stale", "insufficient")
    if not held or (change_start is not None and night < change_start):
        return _Leakage(night=night)
    return _Leakage(last["value"], last["deviation_percent"], night)


def _poor_fit(fits: pl.DataFrame) -> str:
    """That the fit of a motor's last good night is poor, in words; empty where it is not."""
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
    """The indicator that a name stands for, and the night in which it was last raised.

    Parameters
    ----------
    output, motor_id
        Whose.
    name
        Of the indicator, in the tables (``K_piston_ring``) or in words (piston ring leakage).
    states
        States that count.

    Raises
    ------
    UsageError
        ``no_alarm``: there was none; the message names those that there were.
    """
    rows = read_rows(output, ALARMS, [motor_id], ("motor_id", "night", "indicator", "to_state"))
    raised = rows.filter(pl.col("to_state").is_in(list(states)))
    known = sorted(raised["indicator"].unique())
    indicator = name if name in known else _in_words(known).get(_plain(name))
    if indicator is None:
        named = ", ".join(known) or "none at all"
        raise UsageError(
            "no_alarm", f"{motor_id} has had no alarm of {name!r}; there were of: {named}"
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
