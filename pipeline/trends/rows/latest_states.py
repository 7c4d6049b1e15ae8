"""States of motors, made from their rows of `trends` and `fits`, or as the last run left them."""

from __future__ import annotations

import datetime as dt
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path

import polars as pl

from leakage.estimation.validation import is_poor
from pipeline.errors import StoreError
from pipeline.schema import FITS, LATEST, TRENDS
from pipeline.schema.fits import FAILED, OK
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
COURSE = ("motor_id", "indicator", "night", "state")


def latest_states(output: Path, motor_ids: Sequence[str]) -> list[MotorState]:
    """States of some motors by `trends` and `fits`.

    Raises StoreError if a table is damaged.
    """
    trends = read_rows(output, TRENDS, motor_ids, TREND_COLUMNS)
    fits = read_rows(output, FITS, motor_ids, FIT_COLUMNS)
    states = motor_states(motor_ids, trends, fits, read_decisions(output))
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


def motor_states(
    motor_ids: Sequence[str],
    trends: pl.DataFrame,
    fits: pl.DataFrame,
    decisions: Sequence[Decision],
) -> list[MotorState]:
    """States of some motors, from the rows of `trends` and `fits` and the decisions on any."""
    motors = _MotorRows.of(trends, fits)
    return [
        with_acknowledgement(
            motors.state(motor_id), [one for one in decisions if one.motor_id == motor_id]
        )
        for motor_id in motor_ids
    ]


@dataclass(frozen=True, slots=True)
class _MotorRows:
    """The rows that states of motors hang on, found in one pass over those of all motors."""

    # last_fits, good_fits, data_fits: by motor, its newest row of `fits`: of all, of those with a
    # fit, of those with samples.
    last_fits: Mapping[str, Row]
    good_fits: Mapping[str, Row]
    data_fits: Mapping[str, Row]
    # By motor and indicator, the rows of `trends` of the motor's newest night.
    tonight: Mapping[str, Mapping[str, Row]]
    # By motor and indicator of what is told beside the state, the newest row with a figure, with
    # the verdict of its night and the night and state of the indicator's newest row.
    figures: Mapping[str, Mapping[str, Row]]
    # By motor and watched indicator that is not ok tonight, its states in order of the nights.
    courses: Mapping[tuple[str, str], Sequence[tuple[dt.date, str]]]

    @classmethod
    def of(cls, trends: pl.DataFrame, fits: pl.DataFrame) -> _MotorRows:
        trends, fits = trends.select(TREND_COLUMNS), fits.sort("night", "is_primary")
        status, indicator = pl.col("status"), pl.col("indicator")
        tonight = trends.filter(pl.col("night") == pl.col("night").max().over("motor_id"))
        told = trends.filter(indicator.is_in(REFERENCES) | indicator.str.starts_with(GAP))
        newest = pl.col("night", "state").last().over("motor_id", "indicator")
        known = told.sort("night").with_columns(newest.name.prefix("newest_"))
        known = _newest(known.filter(pl.col("value").is_not_null()), "indicator")
        verdicts = fits.filter("is_primary").select("motor_id", "night", "reference_verdict")
        watched = tonight.filter(pl.col("n_slope").is_not_null(), pl.col("state") != "ok")
        course = trends.join(watched, on=["motor_id", "indicator"], how="semi").sort("night")
        courses: defaultdict[tuple[str, str], list[tuple[dt.date, str]]] = defaultdict(list)
        for motor_id, name, night, state in course.select(COURSE).iter_rows():
            courses[motor_id, name].append((night, state))
        return cls(
            _by_motor(fits),
            _by_motor(fits.filter(status == OK)),
            _by_motor(fits.filter(status.is_in(WITH_SAMPLES))),
            _by_indicator(tonight),
            _by_indicator(known.join(verdicts, on=["motor_id", "night"], how="left")),
            courses,
        )

    def state(self, motor_id: str) -> MotorState:
        """State of a motor without what was said of it."""
        last, good = self.last_fits.get(motor_id, {}), self.good_fits.get(motor_id, {})
        state = MotorState(
            motor_id=motor_id,
            state="insufficient",
            reason="no trends yet" if last else "no night yet",
            last_night=last.get("night"),
            last_good_night=good.get("night"),
            poor_fit=_poor_fit(good),
            failure=_failure(last),
            data_night=self.data_fits.get(motor_id, {}).get("night"),
        )
        tonight = self.tonight.get(motor_id)
        if tonight is None:
            return state
        watched = [row for row in tonight.values() if row["n_slope"] is not None]
        worst = _worst(tonight, watched)
        is_ok = worst["state"] == "ok"
        course = () if is_ok else self.courses[motor_id, worst["indicator"]]
        drifts = [
            row["state_reason"]
            for name, row in tonight.items()
            if name in SENSORS and row["state"] == "warning"
        ]
        effect, misfit = tonight.get(TEMPERATURE_EFFECT, {}), tonight.get(MODEL_MISFIT, {})
        starts = [row["change_start"] for row in tonight.values() if row["state"] in CHANGED]
        began = max((one for one in starts if one), default=None)
        figures = self.figures.get(motor_id, {})
        references = [figures[name] for name in REFERENCES if name in figures]
        leakage = next((row for row in references if _holds(row, began)), {})
        gaps = [figures[name] for name in sorted(figures) if name.startswith(GAP)]
        gap: Row = max(
            (row for row in gaps if _holds(row, began)),
            key=lambda row: abs(row["value"]),
            default={},
        )
        is_of_fleet = leakage.get("indicator") == REFERENCES[0]
        return replace(
            state,
            state=worst["state"],
            indicator=None if is_ok else worst["indicator"],
            reason=next(iter(drifts), None) if is_ok else worst["state_reason"],
            leakage_l_per_min=leakage.get("value"),
            deviation_percent=leakage.get("deviation_percent"),
            sensor_health=worst["sensor_health"],
            state_since=None if is_ok else _since(course, [worst["state"]]),
            leakage_night=next((row["night"] for row in (leakage, *references) if row), None),
            change_start=began,
            leakage_indicator=leakage.get("indicator"),
            leakage_lower=leakage.get("lower"),
            leakage_upper=leakage.get("upper"),
            leakage_verdict=leakage["reference_verdict"] if is_of_fleet else None,
            gap_path=gap["indicator"].removeprefix(GAP) if gap else None,
            gap_change_percent=gap.get("value"),
            limit_dates="" if is_ok else limit_dates(worst),
            temperature_effect=(effect.get("state") == "ok" and effect["state_reason"]) or "",
            model_misfit=misfit.get("state_reason") or "",
            model_verdict=misfit.get("model_verdict"),
            oil=tonight.get(OIL_VISCOSITY, {}).get("state_reason") or "",
            path=_paths(worst, watched),
            known_since=_since(course, CHANGED) if worst["state"] in CHANGED else None,
            gap_change_lower=gap.get("lower"),
            gap_change_upper=gap.get("upper"),
            **{name: worst[name] for name in LIMITS},
        )


def _newest(rows: pl.DataFrame, *by: str) -> pl.DataFrame:
    """The last of each motor's rows, which are in order of their nights."""
    return rows.unique(["motor_id", *by], keep="last", maintain_order=True)


def _by_motor(rows: pl.DataFrame) -> dict[str, Row]:
    """The last of each motor's rows, by motor."""
    return {row["motor_id"]: row for row in _newest(rows).iter_rows(named=True)}


def _by_indicator(rows: pl.DataFrame) -> dict[str, dict[str, Row]]:
    """Rows by motor and indicator."""
    found: defaultdict[str, dict[str, Row]] = defaultdict(dict)
    for row in rows.iter_rows(named=True):
        found[row["motor_id"]][row["indicator"]] = row
    return found


def _worst(tonight: Mapping[str, Row], watched: Sequence[Row]) -> Row:
    """Row of the watched indicator that tells a motor's state."""
    worst = min(
        watched, key=lambda row: (ORDER.index(row["state"]), -(row["deviation_percent"] or 0.0))
    )
    # A motor that never sees the fleet's conditions is judged by its other indicators.
    if worst["state"] in ("insufficient", "stale") and any(one["state"] == "ok" for one in watched):
        return worst | {"state": "ok"}
    if worst["state"] == "insufficient":
        return worst | {"state_reason": tonight.get("baseline_progress", worst)["state_reason"]}
    return worst


def _holds(row: Row, change_start: dt.date | None) -> bool:
    """True if an indicator's newest figure is neither stale nor older than a change in force."""
    # Without a baseline nothing says when a figure is stale.
    is_stale = row["newest_state"] in ("stale", "insufficient")
    is_now = row["night"] == row["newest_night"] or not is_stale
    return is_now and (change_start is None or row["night"] >= change_start)


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


def _paths(worst: Row, watched: Sequence[Row]) -> str | None:
    """Paths behind the worst indicator: all gaps in its state, if it is one of a gap."""
    if not worst["indicator"].startswith("K_"):
        return None if worst["path"] is None else str(worst["path"])
    beside = [one["indicator"] for one in watched if one["state"] == worst["state"]]
    gaps = [worst["indicator"], *(name for name in beside if name.startswith("K_"))]
    return " and ".join(name.removeprefix("K_") for name in dict.fromkeys(gaps))


def _since(course: Sequence[tuple[dt.date, str]], states: Collection[str]) -> dt.date:
    """First night of the last stretch of some states."""
    *_, (first, _) = takewhile(lambda one: one[1] in states, reversed(course))
    return first
