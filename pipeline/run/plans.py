"""The plan of a run, before anything is done."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from pipeline.clock import latest_us
from pipeline.config import MotorSpec
from pipeline.config.hashes import settings_of, why_anew
from pipeline.logs.ledger import as_published, read_ledger, read_settings
from pipeline.run.motor_nights import plan_motor
from pipeline.run.request import RunRequest
from pipeline.run.tasks import MotorTask, Step
from pipeline.store.state import read_state_file
from pipeline.trends.circuits import decisions_of
from pipeline.trends.nights.decisions import read_decisions
from pipeline.trends.nights.trend_record import read_records, trend_hash


def task_of(request: RunRequest, spec: MotorSpec, staging: Path) -> MotorTask:
    """The task of a motor."""
    return MotorTask(
        spec=spec,
        output=request.fleet.output,
        staging=staging,
        since=request.since,
        until=request.until,
        force=request.force,
        retry=request.retry,
        latest_us=latest_us(request.clock),
    )


def plan_fleet(request: RunRequest) -> Iterator[tuple[str, Mapping[dt.date, Step]]]:
    """The plan of a run, motor by motor; of logs only the ends are read, and nothing is written.

    Raises StoreError if a published table that is needed is damaged.
    """
    output = request.fleet.output
    with read_state_file(output) as state:
        for spec in request.specs:
            task = task_of(request, spec, output / "staging")
            ledger = read_ledger(state, spec.motor_id)
            yield spec.motor_id, plan_motor(replace(task, ledger=ledger))


def plan_trends(request: RunRequest) -> Iterator[tuple[str, str]]:
    """Motors whose trends a run would make anew from their first night on, and why, in words.

    Those of nights that are new or made anew follow in any case.
    """
    output, specs = request.fleet.output, request.specs
    decisions = decisions_of(specs, read_decisions(output))
    with read_state_file(output) as state:
        records, settings = read_records(state), read_settings(state)
    for spec in (as_published(one, settings.get(one.motor_id)) for one in specs):
        record = records.get(spec.motor_id)
        if record is not None and record.trend_hash != trend_hash(spec, decisions[spec.motor_id]):
            before, now = settings.get(spec.motor_id, {}), settings_of(spec)
            yield (
                spec.motor_id,
                "a baseline was reset, or a new version"
                if before == now
                else why_anew(before, now, trends=True),
            )
