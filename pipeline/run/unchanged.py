"""Motors of which nothing is new: told before any worker is there, and without the science.

A thread asks the log files for size and time, as their folders may be on a mount that hangs; what
it does not tell is left to the motors' tasks.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import replace
from queue import Empty, SimpleQueue
from threading import Thread

from polars.exceptions import PanicException

from pipeline.config import Execution
from pipeline.config.hashes import reading_hash
from pipeline.errors import StoreError
from pipeline.logs.finding import FileState, states_of
from pipeline.logs.ledger import FileRecord, SeenLogs, read_ledger
from pipeline.run.motor_nights import MotorNights
from pipeline.run.tasks import MotorOutcome, MotorTask
from pipeline.schema import FITS
from pipeline.store.state import State
from pipeline.store.tables import nights_back


def unchanged_motors(
    tasks: Sequence[MotorTask], execution: Execution, state: State
) -> Iterator[MotorOutcome]:
    """Outcomes of the motors with nothing to be done."""
    asked = [task for task in tasks if _is_quick(task, execution)]
    if not asked:
        return
    try:
        published = set(nights_back(asked[0].output, FITS))
    except StoreError:  # which the tasks tell
        return
    # Without an answer, this and all further ones are left.
    for task, states in zip(asked, _states(asked, execution.answer_s), strict=False):
        known = replace(task, ledger=read_ledger(state, task.spec.motor_id))
        outcome = None if states is None else _outcome(known, states, published)
        if outcome is not None:
            yield outcome


def _is_quick(task: MotorTask, execution: Execution) -> bool:
    """True for a motor that was done before, with logs in a folder that is seen from here."""
    logs = task.spec.file.logs
    return (
        execution.backend != "dask"
        and not (task.force or task.retry)
        and not (task.spec.log_url or logs.database)
    )


def _outcome(
    task: MotorTask, states: Mapping[str, FileState], published: Set[dt.date]
) -> MotorOutcome | None:
    """The outcome of a motor whose logs are as the last run left them; None: there is work."""
    try:
        known = task.ledger.files
        if not states or not _are_known(states, known, reading_hash(task.spec)):
            return None
        seen = SeenLogs({name: known[name] for name in states})
        nights = MotorNights(replace(task, looked_at=seen), published)
        if not nights.is_quiet:
            return None
        nights.stage_ledger()
        return nights.outcome()
    except (Exception, PanicException):
        return None


def _are_known(
    states: Mapping[str, FileState], known: Mapping[str, FileRecord], read_with: str
) -> bool:
    """True where each log has a record of the same file, read with the same settings."""
    return all(
        (one := known.get(name)) is not None
        and one.sha256 is not None
        and one.read_with == read_with
        and (one.size, one.modified_ns, one.inode, one.changed_ns) == state
        for name, state in states.items()
    )


def _states(
    tasks: Sequence[MotorTask], answer_s: float
) -> Iterator[Mapping[str, FileState] | None]:
    """States of each motor's logs, None where one cannot be told; ends early where one hangs."""
    told: SimpleQueue[Mapping[str, FileState] | None] = SimpleQueue()

    def look() -> None:
        for task in tasks:
            told.put(states_of(task.spec.log_root, task.spec.file.logs.files))

    Thread(target=look, daemon=True, name="look at logs").start()
    with suppress(Empty):
        for _ in tasks:
            yield told.get(timeout=answer_s)
