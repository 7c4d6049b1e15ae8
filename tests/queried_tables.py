"""Tables that the queries of `docs/queries.md` are asked of, with known differences."""

from __future__ import annotations

import datetime as dt
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import polars as pl

from pipeline.schema import (
    ALARMS,
    BASELINES,
    DECISIONS,
    FITS,
    LATEST,
    PARAMETERS,
    TRENDS,
    WATCH,
    Table,
    frame,
)
from pipeline.store.tables import table_folder, whole_file, write_table
from pipeline.store.views import write_views
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.rows.motor_states import MotorState, latest_rows
from pipeline.trends.rows.watch_rows import WatchRow
from tests.pipeline.written import write_nights

EARLIER = dt.timedelta(days=40)
NEWEST = dt.date(2026, 1, 4)
FAILED, THIN, STEADY = "CB560-01", "CB400-01", "CB560-02"

Rows = list[dict[str, Any]]


WORN, SLOW, HEALTHY = "CB560-01", "CB400-02", "CB400-01"
FIRST_OF_WATCH, LAST_OF_WATCH = dt.date(2026, 1, 2), dt.date(2026, 4, 21)
SINCE, TOLD_ON = dt.date(2026, 3, 13), dt.date(2026, 3, 15)
PER_YEAR = 83.6


def watch_rows() -> list[WatchRow]:
    """A sleeve damaged within a day, wear that is alarmed, and a healthy motor: two nights each."""
    told = {"since": SINCE, "told_on": TOLD_ON, "change": 0.38, "goes_on": False}
    states: dict[str, tuple[str, dict[str, Any]]] = {
        WORN: ("alarm", told | {"cause": "balance_sleeve", "tonight_change": 0.4}),
        SLOW: ("warning", told | {"cause": "cannot_be_told", "tonight_change": 0.1}),
        HEALTHY: ("ok", {"tonight_change": 0.0}),
    }
    nights = (LAST_OF_WATCH - dt.timedelta(days=1), LAST_OF_WATCH)
    return [
        WatchRow(motor_id, night, state, f"it is {state}", "Look.", **figures)
        for night in nights
        for motor_id, (state, figures) in states.items()
    ]


def slopes(row: WatchRow) -> Rows:
    """Rows of `trends` of a night: only the slow one has a slope, and days to its limit."""
    key = {"motor_id": row.motor_id, "night": row.night, "indicator": "own_reference_leakage"}
    slope = {"baseline_mean": 2.0, "n_slope": 110, "slope_start": FIRST_OF_WATCH}
    slope |= {"provisional": False, "unit": "l/min"}
    if row.motor_id == SLOW:
        per_year = 0.02 * PER_YEAR
        slope |= {"slope_per_year": per_year, "slope_per_year_lower": 0.9 * per_year}
        slope |= {"slope_per_year_upper": 1.1 * per_year, "slope_per_1000_h": per_year / 4.383}
        slope |= {"days_to_limit": 90.0, "days_to_limit_lower": 60.0, "days_to_limit_upper": 150.0}
        slope |= {"days_to_limit_status": "finite", "limit": 2.6}
    if row.motor_id == WORN:
        slope |= {"slope_per_year": 0.1, "slope_per_year_lower": -0.1}
        slope |= {"days_to_limit_lower": 0.0, "days_to_limit_status": "already_crossed"}
    return [key | slope]


def write_trends(output: Path) -> None:
    """The trend tables of those motors, and what people said of the first."""
    watch = watch_rows()
    raised: dict[str, Any] = {
        "indicator": "leakage",
        "from_state": "ok",
        "to_state": "warning",
        "way": "change",
    }
    raised |= {"time": dt.datetime(2026, 3, 15, 6, tzinfo=dt.UTC), "night": TOLD_ON}
    reset = {"motor_id": WORN, "night": TOLD_ON, "indicator": "leakage", "n": 8}
    reset |= {"start": SINCE + dt.timedelta(days=3), "reason": "reset: sleeves seen"}
    first = reset | {"start": FIRST_OF_WATCH, "night": FIRST_OF_WATCH, "reason": "first nights"}
    rows: dict[Table, Rows] = {
        WATCH: [one.row for one in watch],
        TRENDS: [row for one in watch for row in slopes(one)],
        ALARMS: [raised | {"motor_id": motor_id} for motor_id in (WORN, SLOW)],
        BASELINES: [reset, first, first | {"motor_id": SLOW}],
    }
    for table, own in rows.items():
        whole = frame(table, [{"run_id": "made", **row} for row in own])
        write_nights(output, table, whole)
    states = [
        MotorState(one.motor_id, one.state, one.sentence, one.advice, one)
        for one in watch
        if one.night == LAST_OF_WATCH
    ]
    write_table(whole_file(output, LATEST), frame(LATEST, latest_rows(states, "made")))
    said = [{"run_id": "made", **asdict(one)} for one in decisions()]
    decisions_file = table_folder(output, DECISIONS) / "decisions.parquet"
    write_table(decisions_file, frame(DECISIONS, said).sort(DECISIONS.key))
    write_views(output)


def decisions() -> list[Decision]:
    """The sleeves' alarm was inspected twice, a sensor's once and in vain."""
    when = dt.datetime(2026, 4, 1, tzinfo=dt.UTC)
    first = Decision(WORN, "leakage", when, "finding", TOLD_ON, "not_confirmed", "nothing")
    second = replace(first, time=when + EARLIER, finding="confirmed", note="a sleeve is scored")
    vain = replace(first, motor_id=SLOW)
    seen = replace(first, kind="acknowledged", finding=None, motor_id=HEALTHY)
    return [first, second, vain, seen]


def known(rows: pl.DataFrame, table: Table) -> pl.DataFrame:
    if table is not PARAMETERS:
        return rows
    is_factor = pl.col("parameter").str.starts_with("K_") & (pl.col("verdict") != "fixed")
    verdict = pl.when(is_factor).then(pl.lit("identified")).otherwise("verdict")
    return rows.with_columns(verdict=verdict)


def less_worn(table: Table) -> dict[str, pl.Expr]:
    if table is FITS:
        return {"reference_leakage_l_per_min": 0.8 * pl.col("reference_leakage_l_per_min")}
    if table is PARAMETERS:
        half = pl.when(pl.col("parameter") == "K_piston_ring").then(0.5).otherwise(1.0)
        return {"value": half * pl.col("value")}
    return {}


def with_faults(rows: pl.DataFrame) -> pl.DataFrame:
    failed, thin = pl.col("motor_id") == FAILED, pl.col("motor_id") == THIN
    figures = [
        name
        for name, kind in FITS.schema.items()
        if kind == pl.Float64 or name.endswith(("verdict", "interval_status"))
    ]
    return rows.with_columns(
        pl.when(failed).then(None).otherwise(pl.col(name)).alias(name) for name in figures
    ).with_columns(
        status=pl.when(failed).then(pl.lit("failed")).otherwise("status"),
        error_code=pl.when(failed).then(pl.lit("log_truncated")).otherwise("error_code"),
        kept_share=pl.when(thin).then(0.5).otherwise("kept_share"),
        validation_fit_percent=pl.when(thin)
        .then(pl.col("training_fit_percent") - 30)
        .otherwise("validation_fit_percent"),
    )
