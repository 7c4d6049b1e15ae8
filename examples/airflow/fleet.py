"""The nightly run as an Airflow DAG: the run, then a look at `latest`.

Needs apache-airflow 3 and polars. FLEET names the fleet file, OUTPUT the output folder.
"""

import datetime as dt
import os
import subprocess

from airflow.sdk import dag, task
from airflow.sdk.exceptions import AirflowFailException


@dag(schedule="30 7 * * *", start_date=dt.datetime(2026, 1, 1), catchup=False, max_active_runs=1)
def motor_leakage():
    """Fit the new nights of the fleet every morning."""

    @task
    def fit() -> int:
        """Exit code 1: at least one motor failed, the others are published."""
        code = subprocess.run(
            ["motor-leakage", "fit-fleet", os.environ["FLEET"]], check=False
        ).returncode
        if code > 1:
            raise AirflowFailException(f"motor-leakage ended with {code}")
        return code

    @task
    def no_alarm() -> None:
        """Fail if a motor is in alarm."""
        import polars as pl

        rows = pl.read_parquet(f"{os.environ['OUTPUT']}/tables/latest/latest.parquet")
        alarmed = rows.filter(state="alarm").select("motor_id", "sentence").rows()
        if alarmed:
            raise AirflowFailException("; ".join(f"{motor}: {words}" for motor, words in alarmed))

    fit() >> no_alarm()


motor_leakage()
