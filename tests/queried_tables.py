"""Tables that the queries of `docs/queries.md` are asked of, with known differences."""

from __future__ import annotations

import datetime as dt
from dataclasses import asdict, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import polars as pl

from pipeline.schema import DECISIONS, FITS, PARAMETERS, TREND_TABLES, TRENDS, Table, frame
from pipeline.store.encoding import write_table
from pipeline.store.tables import night_file, table_folder
from pipeline.store.views import write_views
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.rows.alarm_rows import alarm_rows
from pipeline.trends.rows.baseline_rows import baseline_rows, change_point_rows
from pipeline.trends.rows.q_values import with_q_values
from pipeline.trends.rows.trend_rows import trend_rows
from pipeline.trends.states.standing import Standing
from tests.pipeline.trends.nights import Nights, motor, named, ramp, reset, standing, step

EARLIER = dt.timedelta(days=40)
NEWEST = dt.date(2026, 1, 4)
FAILED, THIN, STEADY = "CB560-01", "CB400-01", "CB560-02"

Rows = list[dict[str, Any]]


WORN_AT, NIGHTS_OF_TRENDS = 70, 110
WORN, SLOW, HEALTHY = "CB560-01", "CB400-02", "CB400-01"


@lru_cache(maxsize=1)
def standing_motors() -> dict[str, Standing]:
    """Sleeves damaged within a day, rings that wear since the first night, and none."""
    n = NIGHTS_OF_TRENDS
    wear = {
        WORN: {"balance_sleeve": step(n, WORN_AT, 0.4)},
        SLOW: {"piston_ring": ramp(n, 0, 0.25)},
        HEALTHY: {},
    }
    nights = [
        Nights(named(motor(), name), n, own, seed=number)
        for number, (name, own) in enumerate(wear.items())
    ]
    return {
        one.spec.motor_id: standing(one, *([RESET] if one.spec.motor_id == WORN else []))
        for one in nights
    }


RESET = reset(WORN_AT + 3, "own_reference_leakage", "sleeves seen", motor_id=WORN)


def write_trends(output: Path) -> None:
    """The trend tables of those motors, and what people said of the first."""
    rows: dict[str, Rows] = {table.name: [] for table in TREND_TABLES}
    places = range(NIGHTS_OF_TRENDS)
    for found in standing_motors().values():
        rows["trends"] += trend_rows(found, places[-2:])
        rows["alarms"] += alarm_rows(found, places)
        rows["baselines"] += baseline_rows(found, places)
        rows["change_points"] += change_point_rows(found, places)
    for table in TREND_TABLES:
        whole = frame(table, [{"run_id": "made", **row} for row in rows[table.name]])
        for (night,), part in whole.partition_by("night", as_dict=True).items():
            if table is TRENDS:
                part = with_q_values(part, list(standing_motors()), 0.1)
            write_table(night_file(output, table, night), part.sort(table.key))
    said = [{"run_id": "made", **asdict(one)} for one in decisions()]
    whole_file = table_folder(output, DECISIONS) / "decisions.parquet"
    write_table(whole_file, frame(DECISIONS, said).sort(DECISIONS.key))
    write_views(output)


def decisions() -> list[Decision]:
    """The sleeves' alarm was inspected twice, the deviation's once and in vain."""
    (raised,) = (
        row["night"]
        for row in alarm_rows(standing_motors()[WORN], range(NIGHTS_OF_TRENDS))
        if row["indicator"] == "K_balance_sleeve" and row["to_state"] == "alarm"
    )
    when = dt.datetime(2026, 4, 1, tzinfo=dt.UTC)
    first = Decision(WORN, "K_balance_sleeve", when, "finding", raised, "not_confirmed", "nothing")
    second = replace(first, time=when + EARLIER, finding="confirmed", note="a sleeve is scored")
    vain = replace(first, indicator="baseline_deviation")
    seen = replace(first, kind="acknowledged", finding=None, indicator="reference_leakage")
    return [first, second, vain, seen, RESET]


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
