"""The plan of a run, before anything is done."""

from __future__ import annotations

import datetime as dt
from collections.abc import Collection, Iterator, Mapping

from pipeline.config.hashes import settings_of, why_anew
from pipeline.logs.processed import as_published, read_processed, read_settings
from pipeline.run.motor_nights import MotorNights
from pipeline.run.tasks import RunRequest, Step
from pipeline.store.state import read_state_file
from pipeline.trends.nights.decisions import read_decisions
from pipeline.trends.nights.trend_record import read_records, trend_hash
from pipeline.trends.rows.motor_states import CHANGED, published_states
from pipeline.trends.tasks import decisions_of


def plan_fleet(request: RunRequest) -> Iterator[tuple[str, Mapping[dt.date, Step]]]:
    """Nights that a run would do, motor by motor, and why; of logs only the ends are read.

    Raises StoreError if a published table that is needed is damaged.
    """
    with read_state_file(request.fleet.output) as state:
        for spec in request.specs:
            processed = read_processed(state, spec.motor_id)
            task = request.task(spec, request.fleet.output / "staging", processed)
            yield spec.motor_id, dict(sorted(MotorNights(task).open_nights().items()))


def plan_states(request: RunRequest, stays: Collection[str]) -> Iterator[tuple[str, str]]:
    """Yield motors with a state in force whose nights or trends are made anew by other settings,
    with what becomes of it, in words; `stays` are those of which some nights stay as they are.
    """
    states = published_states(request.fleet.output, [spec.motor_id for spec in request.specs])
    changed = {motor_id for motor_id, _ in plan_trends(request)}
    for motor in states:
        if motor.state in CHANGED and motor.motor_id in changed:
            how = "is judged anew: it stays in force, or its end is reported"
            if motor.motor_id in stays:
                how = "stays in force: nights before keep the settings they were made with"
            yield motor.motor_id, f"{motor.state} since {motor.row['state_since']} {how}"


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
                if {**before, **now} == before
                else why_anew(before, now, trends=True),
            )
