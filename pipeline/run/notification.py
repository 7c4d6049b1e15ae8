"""What a run, once it has published, tells others: alarms, summaries, and metrics for Prometheus's
node exporter. None of it costs anybody the run.
"""

from __future__ import annotations

import datetime as dt
import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.config import Fleet
from pipeline.errors import LockedError, StoreError
from pipeline.intraday.rows import NOT_JUDGED, open_rises
from pipeline.notification.delivery import EMAIL, Receiver, UndeliveredError
from pipeline.notification.outbox import Backlog, backlogs, deliver, deliver_summary
from pipeline.run.tasks import MotorOutcome, RunResult
from pipeline.schema import LATEST
from pipeline.store.atomic_files import put, remove_leftovers
from pipeline.store.heartbeat import last_good_run
from pipeline.store.state import StateDatabase, open_state
from pipeline.trends.motor_states import (
    CLEAR,
    ORDER,
    RISEN,
    MotorState,
    published_states,
    urgency,
)

if TYPE_CHECKING:
    from pipeline.intraday.check import MotorCheck

log = logging.getLogger(__name__)

HEAD = "# Made by motor-leakage"
# Columns of `latest` that are metrics under the same name.
FIGURES = (
    *("leakage_change_percent", "leakage_change_lower", "leakage_change_upper"),
    *("alarm_level_percent", "detection_limit_percent"),
    *("own_leakage_l_per_min", "own_leakage_lower", "own_leakage_upper"),
    *("evidence", "evidence_limit", "model_error_percent"),
)
MEANING = {column.name: column.description for column in LATEST.columns}
# Labels and value of a sample.
Sample = tuple[Mapping[str, str], float]


def settle_intraday(fleet: Fleet, state: StateDatabase) -> None:
    """Let published nights settle what the intraday check reported; if not now, the next run's."""
    try:
        rises = open_rises(fleet.output, [spec.motor_id for spec in fleet.motors])
        if rises:
            # Most runs need none of it.
            from pipeline.intraday.check import settle_rises

            settle_rises(fleet, state, rises)
    except (LockedError, StoreError) as error:
        log.warning("intraday check: %s; the next run settles what it reported", error)


def summary_rows(fleet: Fleet) -> list[dict[str, str]]:
    """Return state of each motor for a summary, the most urgent first."""
    states = published_states(fleet.output, [spec.motor_id for spec in fleet.motors])
    return [
        {
            "motor_id": state.motor_id,
            "state": state.state,
            "headline": state.headline,
            "sentence": state.why,
            "advice": state.advice,
        }
        for state in sorted(states, key=urgency)
    ]


def deliver_alarms(fleet: Fleet, receivers: Sequence[Receiver]) -> None:
    """Deliver what waits; that it cannot be delivered costs nobody the run."""
    try:
        with open_state(fleet.output) as state:
            for fault in deliver(state, receivers, fleet.name):
                log.warning("%s", fault)
            for receiver in receivers:
                if receiver.name == EMAIL:
                    _deliver_summary(fleet, state, receiver)
    except StoreError as error:
        log.warning("alarms: %s; what was delivered may be delivered again", error)


def _deliver_summary(fleet: Fleet, state: StateDatabase, receiver: Receiver) -> None:
    """Deliver the summary that is due; where it is not taken, the next run does it."""
    today = dt.datetime.now(fleet.settings.nights.zone).date()
    due = fleet.settings.alarms.email.summary_due(today)
    try:
        if due is not None:
            deliver_summary(state, receiver, fleet.name, due, lambda: summary_rows(fleet))
    except UndeliveredError as error:
        log.warning("%s: summary: %s; the next run tries again", receiver.label, error.why)


def write_run_metrics(fleet: Fleet, receivers: Sequence[Receiver], result: RunResult) -> None:
    """Write the metrics of a run, if the config names a file for them."""
    if fleet.metrics_file is None:
        return
    output = fleet.output
    try:
        text = metrics_text(
            fleet,
            published_states(output, [spec.motor_id for spec in fleet.motors]),
            result.outcomes,
            result.seconds_by_stage,
            backlogs(output, receivers),
            last_good_run(output),
        )
        write_metrics(fleet.metrics_file, text)
    except StoreError as error:
        log.warning("%s; there are no metrics of this run", error)


def write_metrics(path: Path, text: str) -> None:
    """Replace a text file whole; its folder is not made.

    Raises StoreError (``metrics_file``) if it cannot be written.
    """
    try:
        if not path.parent.is_dir():
            raise StoreError("metrics_file", f"{path.parent} is no folder; make it")
        remove_leftovers(path.parent)
        put(path, text.encode(), durable=False)
    except OSError as error:
        raise StoreError("metrics_file", f"{path}: {error.strerror}") from error


def metrics_text(
    fleet: Fleet,
    states: Sequence[MotorState],
    outcomes: Sequence[MotorOutcome],
    seconds_by_stage: Mapping[str, float],
    backlogs: Sequence[Backlog],
    last_good_run: dt.datetime | None,
) -> str:
    """Return the metrics in Prometheus's text format, each with the label `fleet`."""
    families: dict[tuple[str, str], list[Sample]] = {
        ("motor_state", "1 for the state of a motor, 0 for the others"): [
            ({"motor": motor.motor_id, "state": state}, float(motor.state == state))
            for motor in states
            for state in ORDER
        ],
        **{
            (name, MEANING[name]): [
                ({"motor": motor.motor_id}, motor.row[name])
                for motor in states
                if motor.row[name] is not None
            ]
            for name in FIGURES
        },
        ("data_timestamp_seconds", "Newest sample of a motor"): [
            ({"motor": motor.motor_id}, motor.row["last_sample"].timestamp())
            for motor in states
            if motor.row["last_sample"] is not None
        ],
        ("standing_failures", "Nights and logs of a motor that failed and are as they were"): [
            ({"motor": outcome.motor_id}, float(outcome.n_standing)) for outcome in outcomes
        ],
        ("undelivered_changes", "Changes of state that are not delivered to a receiver"): [
            ({"receiver": backlog.receiver}, float(backlog.undelivered)) for backlog in backlogs
        ],
        ("stage_duration_seconds", "Wall-clock time of the last run by stage"): [
            ({"stage": stage.removesuffix("_s")}, taken)
            for stage, taken in seconds_by_stage.items()
        ],
        ("last_good_run_timestamp_seconds", "End of the last run after which no failure stands"): [
            ({}, last_good_run.timestamp()) for _ in [0] if last_good_run is not None
        ],
    }
    return _text(fleet, families)


def intraday_metrics_file(path: Path) -> Path:
    """Return file of the intraday check beside that of the runs, as both replace theirs whole."""
    return path.with_name(f"{path.stem}-intraday{path.suffix}")


def intraday_metrics_text(fleet: Fleet, checks: Sequence[MotorCheck]) -> str:
    """Return the metrics of an intraday check, by motor."""
    return _text(
        fleet,
        {
            ("intraday_state", "1 for the state of a motor within the day, 0 for the others"): [
                ({"motor": check.motor_id, "state": state}, float(check.state == state))
                for check in checks
                for state in (RISEN, CLEAR, NOT_JUDGED)
            ],
            ("intraday_judged_timestamp_seconds", "End of the samples that were judged"): [
                ({"motor": check.motor_id}, check.end_us / 1e6) for check in checks if check.end_us
            ],
        },
    )


def _text(fleet: Fleet, families: Mapping[tuple[str, str], Sequence[Sample]]) -> str:
    lines = (
        line
        for (name, words), samples in families.items()
        for line in _family(f"motor_leakage_{name}", words, fleet.name, samples)
    )
    return "\n".join([HEAD, *lines]) + "\n"


def _family(name: str, words: str, fleet: str, samples: Iterable[Sample]) -> Iterator[str]:
    yield f"# HELP {name} {words}."
    yield f"# TYPE {name} gauge"
    for labels, value in samples:
        pairs = ",".join(
            f'{key}="{_escape(text)}"' for key, text in {"fleet": fleet, **labels}.items()
        )
        yield f"{name}{{{pairs}}} {value!r}"


def _escape(text: str) -> str:
    """Return a label's value.

    Examples
    --------
    >>> print(_escape('a"b'))
    a\\"b
    """
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
