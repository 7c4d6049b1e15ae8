"""Metrics of the last run as a text file for the node exporter of Prometheus."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.config import Fleet
from pipeline.errors import StoreError
from pipeline.intraday.rows import NOT_JUDGED
from pipeline.notification.outbox import Backlog
from pipeline.run.tasks import MotorOutcome
from pipeline.schema import LATEST
from pipeline.store.atomic_files import put, remove_leftovers
from pipeline.trends.rows.motor_states import CLEAR, ORDER, RISEN, MotorState

if TYPE_CHECKING:
    from pipeline.intraday.check import MotorCheck

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


def write_metrics(path: Path, text: str) -> None:
    """Replace a text file whole; its folder is not made.

    Raises StoreError (``metrics_file``) if it cannot be written.
    """
    try:
        if not path.parent.is_dir():
            raise StoreError("metrics_file", f"{path.parent} is no folder; make it")
        remove_leftovers([path.parent], below=False)
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
            f'{key}="{_escaped(text)}"' for key, text in {"fleet": fleet, **labels}.items()
        )
        yield f"{name}{{{pairs}}} {value!r}"


def _escaped(text: str) -> str:
    """Return a label's value.

    Examples
    --------
    >>> print(_escaped('a"b'))
    a\\"b
    """
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
