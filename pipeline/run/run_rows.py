"""Rows of `runs` and `motor_outcomes`, and the hash that names a run."""

from __future__ import annotations

import datetime as dt
import hashlib
import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version

from pipeline.config.hashes import config_hash as hash_of_config
from pipeline.config.hashes import hash_of, own_version
from pipeline.logs.motor_logs import FATES
from pipeline.run.request import RunRequest, RunResult
from pipeline.run.tasks import MotorOutcome, MotorTask
from pipeline.schema import MOTOR_OUTCOMES, RUNS, SCHEMA_VERSION
from pipeline.store.publishing import Publisher
from pipeline.store.views import write_views

# Seconds of a motor's task by stage, as `motor_outcomes` names them, and of a run, as `runs` does.
MOTOR_STAGES = (
    "read_s",
    "clean_s",
    "statistics_s",
    "fit_s",
    "residuals_s",
    "refit_s",
    "store_s",
)
STAGES = ("motors_s", "publish_s", "trends_s")
# Packages whose versions `runs` has.
DEPENDENCIES = ("polars", "pyarrow", "numpy", "scipy")


def config_hash_of(tasks: Sequence[MotorTask]) -> str:
    """Hash of the settings of all motors."""
    return hash_of({task.spec.motor_id: hash_of_config(task.spec) for task in tasks})


def run_id_of(outcomes: Sequence[MotorOutcome], config_hash: str) -> str:
    """Hash of the code, the settings and the contents that were read."""
    inputs = [one for outcome in outcomes for one in (outcome.motor_id, *outcome.inputs)]
    text = "|".join((own_version(), str(SCHEMA_VERSION), config_hash, *inputs))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def publish_run(
    publisher: Publisher,
    request: RunRequest,
    result: RunResult,
    started: dt.datetime,
    config_hash: str,
) -> None:
    """Publish the rows of `runs` and `motor_outcomes`, and the views of all tables."""
    fleet = request.fleet
    seeds = {spec.settings.estimation.seed for spec in fleet.motors}
    run = {
        "run_id": result.run_id,
        "started_at": started,
        "finished_at": dt.datetime.now(dt.UTC),
        "status": "interrupted"
        if result.interrupted
        else "motors_failed"
        if not result.is_good
        else "ok",
        "fleet": fleet.name,
        "version": own_version(),
        "python_version": platform.python_version(),
        **{f"{name}_version": version(name) for name in DEPENDENCIES},
        "schema_version": SCHEMA_VERSION,
        "config_hash": config_hash,
        "seed": min(seeds),
        "workers": fleet.execution.workers,
        "n_motors": len(result.outcomes),
        "n_motors_failed": len(result.failed),
        "n_nights": result.n_nights,
        "seconds": result.seconds,
        **result.seconds_by_stage,
        "damage": [str(one) for one in result.damage],
    }
    rows = [_outcome_row(outcome, result.run_id, started) for outcome in result.outcomes]
    publisher.add(f"{started:%Y-%m}", {RUNS: [run], MOTOR_OUTCOMES: rows})
    write_views(fleet.output)


def _outcome_row(outcome: MotorOutcome, run_id: str, started: dt.datetime) -> Mapping[str, object]:
    statuses = ("ok", "stood_still", "insufficient_data", "no_new_data", "failed")
    return {
        "run_id": run_id,
        "started_at": started,
        "motor_id": outcome.motor_id,
        "status": outcome.status,
        "error_code": outcome.error_code,
        "message": outcome.message,
        "peak_memory_mib": outcome.peak_memory_mib,
        "n_refitted": outcome.n_refitted,
        **{stage: outcome.seconds.get(stage, 0.0) for stage in MOTOR_STAGES},
        **{f"n_{status}": outcome.counts.get(status, 0) for status in statuses},
        **{f"n_files_{fate}": outcome.files.get(fate, 0) for fate in FATES},
        "growing": list(outcome.growing),
    }
