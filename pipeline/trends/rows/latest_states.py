"""States of motors, made from their rows of `trends` and `fits`, or as the last run left them."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import polars as pl

from leakage.estimation.validation import is_poor
from pipeline.errors import StoreError
from pipeline.schema import FITS, LATEST, TRENDS
from pipeline.store.tables import published_rows, read_rows, whole_file
from pipeline.trends.nights.decisions import Decision, read_decisions
from pipeline.trends.nights.tonight import WITH_SAMPLES
from pipeline.trends.rows.motor_states import (
    CHANGED,
    FITS_OF_A_NIGHT,
    GAP,
    LIMITS,
    MODEL_MISFIT,
    OIL_VISCOSITY,
    ORDER,
    REFERENCES,
    SENSORS,
    STORED,
    TEMPERATURE_EFFECT,
    TONIGHTS_FITS,
    MotorState,
    Row,
    fit_words,
    with_acknowledgement,
)
from pipeline.trends.states.words import limit_dates

# Columns that a state is made from.
FIGURES = ("motor_id", "night", "indicator", "value", "lower", "upper", "deviation_percent")
STATES = ("n_slope", "state", "state_reason", "change_start", "path", "sensor_health")
TREND_COLUMNS = (*FIGURES, *STATES, "model_verdict", *LIMITS)
FIT_KEYS = ("motor_id", "night", "status", "reason", "is_primary", "reference_verdict")
FIT_COLUMNS = (*FIT_KEYS, *TONIGHTS_FITS)


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
    newest = trends.filter(pl.col("night") == pl.col("night").max())
    tonight = {row["indicator"]: row for row in newest.iter_rows(named=True)}
    watched = [row for row in tonight.values() if row["n_slope"] is not None]
    worst = min(
        watched, key=lambda row: (ORDER.index(row["state"]), -(row["deviation_percent"] or 0.0))
    )
    # A motor that never sees the fleet's conditions is judged by its other indicators.
    if worst["state"] in ("insufficient", "stale") and any(one["state"] == "ok" for one in watched):
        worst = worst | {"state": "ok"}
    if worst["state"] == "insufficient":
        worst = worst | {"state_reason": tonight.get("baseline_progress", worst)["state_reason"]}
    is_ok = worst["state"] == "ok"
    drifts = [
        row["state_reason"]
        for name, row in tonight.items()
        if name in SENSORS and row["state"] == "warning"
    ]
    effect, misfit = tonight.get(TEMPERATURE_EFFECT, {}), tonight.get(MODEL_MISFIT, {})
    starts = [row["change_start"] for row in tonight.values() if row["state"] in CHANGED]
    began = max((one for one in starts if one), default=None)
    leakage_night, leakage = _leakage(trends, tonight, began)
    gap = _largest_gap_change(trends, tonight, began)
    found = replace(
        state,
        state=worst["state"],
        indicator=None if is_ok else worst["indicator"],
        reason=next(iter(drifts), None) if is_ok else worst["state_reason"],
        leakage_l_per_min=leakage.get("value"),
        deviation_percent=leakage.get("deviation_percent"),
        sensor_health=worst["sensor_health"],
        state_since=None if is_ok else _since(worst, trends, [worst["state"]]),
        leakage_night=leakage_night,
        change_start=began,
        leakage_indicator=leakage.get("indicator"),
        leakage_lower=leakage.get("lower"),
        leakage_upper=leakage.get("upper"),
        leakage_verdict=_verdict(fits, leakage_night, leakage),
        gap_path=gap["indicator"].removeprefix(GAP) if gap else None,
        gap_change_percent=gap.get("value"),
        limit_dates="" if is_ok else limit_dates(worst),
        temperature_effect=(effect.get("state") == "ok" and effect["state_reason"]) or "",
        model_misfit=misfit.get("state_reason") or "",
        model_verdict=misfit.get("model_verdict"),
        oil=tonight.get(OIL_VISCOSITY, {}).get("state_reason") or "",
        path=_paths(worst, watched),
        known_since=_since(worst, trends, CHANGED) if worst["state"] in CHANGED else None,
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


def _leakage(
    trends: pl.DataFrame, tonight: Mapping[str, Row], change_start: dt.date | None
) -> tuple[dt.date | None, Row]:
    """Last night and row of the reference leakage, of the fleet's conditions or the motor's own."""
    found = [one for name in REFERENCES if (one := _newest(trends, tonight, name, change_start))]
    return next((one for one in found if one[1]), found[0] if found else (None, {}))


def _verdict(fits: pl.DataFrame, night: dt.date | None, leakage: Row) -> str | None:
    """Verdict of a night on the leakage at the fleet's reference conditions."""
    if leakage.get("indicator") != REFERENCES[0]:
        return None
    rows = fits.filter("is_primary", pl.col("night") == night)["reference_verdict"]
    return None if rows.is_empty() else str(rows[0])


def _largest_gap_change(
    trends: pl.DataFrame, tonight: Mapping[str, Row], change_start: dt.date | None
) -> Row:
    """Row of the gap that has changed most; empty without one."""
    names = sorted(name for name in trends["indicator"].unique() if name.startswith(GAP))
    found = [_newest(trends, tonight, name, change_start) for name in names]
    rows = [one[1] for one in found if one and one[1]]
    return max(rows, key=lambda row: abs(row["value"]), default={})


def _newest(
    trends: pl.DataFrame,
    tonight: Mapping[str, Row],
    indicator: str,
    change_start: dt.date | None,
) -> tuple[dt.date, Row] | None:
    """Night and row of an indicator's newest figure; the row is empty where it no longer holds."""
    last = tonight.get(indicator, {})
    holds = True
    if last.get("value") is None:
        own = trends.filter(indicator=indicator).sort("night")
        known = own.filter(pl.col("value").is_not_null())
        if known.is_empty():
            return None
        # Without a baseline nothing says when a figure is stale.
        last, newest = known.row(-1, named=True), own.row(-1, named=True)
        holds = last["night"] == newest["night"] or newest["state"] not in ("stale", "insufficient")
    night = last["night"]
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


def _paths(worst: Row, watched: Sequence[Row]) -> str | None:
    """Paths behind the worst indicator: all gaps in its state, if it is one of a gap."""
    if not worst["indicator"].startswith("K_"):
        return None if worst["path"] is None else str(worst["path"])
    beside = [one["indicator"] for one in watched if one["state"] == worst["state"]]
    gaps = [worst["indicator"], *(name for name in beside if name.startswith("K_"))]
    return " and ".join(name.removeprefix("K_") for name in dict.fromkeys(gaps))


def _since(worst: Row, trends: pl.DataFrame, states: Sequence[str]) -> dt.date:
    """First night of the stretch of some states up to a row of tonight, which has one of them."""
    own = trends.filter(indicator=worst["indicator"]).sort("night")
    before = _last(own.filter(~pl.col("state").is_in(states)))
    first: dt.date = (own if before is None else own.filter(pl.col("night") > before))["night"][0]
    return first
