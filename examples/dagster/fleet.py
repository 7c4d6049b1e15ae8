"""The nightly run as a Dagster asset, with checks of state and freshness.

Needs dagster and polars. FLEET names the fleet file, OUTPUT the output folder.
"""

import os
import subprocess
from datetime import timedelta

import dagster as dg
import polars as pl


def table() -> pl.DataFrame:
    """The table `latest`: a row a motor."""
    return pl.read_parquet(f"{os.environ['OUTPUT']}/tables/latest/latest.parquet")


@dg.asset
def latest() -> dg.MaterializeResult:
    """Fit the new nights; exit code 1: at least one motor failed, the others are published."""
    code = subprocess.run(
        ["motor-leakage", "fit-fleet", os.environ["FLEET"]], check=False
    ).returncode
    if code > 1:
        raise dg.Failure(f"motor-leakage ended with {code}")
    return dg.MaterializeResult(metadata={"exit_code": code, "motors": table().height})


@dg.asset_check(asset=latest)
def no_alarm() -> dg.AssetCheckResult:
    """No motor is in alarm."""
    found = table().filter(state="alarm")
    return dg.AssetCheckResult(
        passed=found.is_empty(), metadata=dict(found.select("motor_id", "sentence").iter_rows())
    )


@dg.asset_check(asset=latest)
def data_are_fresh() -> dg.AssetCheckResult:
    """Every motor has samples of the fleet's newest night or the one before."""
    old = table().filter(pl.col("data_age_nights").fill_null(99) > 1)["motor_id"].to_list()
    return dg.AssetCheckResult(passed=not old, metadata={"motors": old})


late = dg.build_last_update_freshness_checks(assets=[latest], lower_bound_delta=timedelta(hours=26))
every_night = dg.ScheduleDefinition(
    job=dg.define_asset_job("nightly", [latest]), cron_schedule="30 7 * * *"
)
defs = dg.Definitions(
    [latest], asset_checks=[no_alarm, data_are_fresh, *late], schedules=[every_night]
)
