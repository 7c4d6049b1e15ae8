"""What a motor's task is given, and what comes of it: plain data that processes exchange."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path

from pipeline.clock import latest_us
from pipeline.config import MotorSpec
from pipeline.logs.files import legible
from pipeline.logs.ledger import FileRecord, Ledger
from pipeline.logs.motor_logs import Sight
from pipeline.night.fit_night import FAILED, NightOutcome
from pipeline.workers.process import Loss

# A motor of which more nights than this take their worker with them, or more logs than this do not
# answer, is given up as a whole.
MOST_GIVEN_UP = 3


class Work(Enum):
    """How far a night is made anew: from its log, from its statistics, or the model before only."""

    READ = "read"
    REFIT = "refit"
    JUDGE = "judge"


@dataclass(frozen=True, slots=True)
class Step:
    """A night that is to be made anew: how far, and why, in words."""

    work: Work
    reason: str


@dataclass(frozen=True, slots=True)
class MotorTask:
    """What a worker needs to do a motor: plain data, small enough to send.

    Attributes
    ----------
    spec
        The motor with its resolved config.
    output
        Output folder, for the ledger (read only).
    staging
        Folder for this run's staged rows.
    since, until
        Labels of the first and last night to do; None: no limit.
    force
        Whether to make nights anew from their logs that nothing has changed of.
    retry
        Whether to try nights and logs again that failed.
    with_starts
        Whether nights that are, or were, fitted anew without their log get the starts of their
        search.
    given_up
        Nights that this run's workers were lost in, each time.
    silent
        Logs that did not answer, and patterns of logs whose folders did not; none is opened.
    nights_a_part
        A motor with more nights to read than this is split into parts of so many; 0: never.
    looked_at
        What an earlier task of this run has seen of its logs; None: nothing.
    parts
        Files below the staging folder with nights that other tasks have made.
    latest_us
        Samples after this time are refused [µs since 1970]: a day after the run's clock.
    """

    spec: MotorSpec
    output: Path
    staging: Path
    since: dt.date | None = None
    until: dt.date | None = None
    force: bool = False
    retry: bool = False
    with_starts: bool = False
    given_up: Mapping[dt.date, Loss] = field(default_factory=dict)
    silent: Mapping[str, Loss] = field(default_factory=dict)
    nights_a_part: int = 0
    looked_at: Mapping[str, FileRecord] | None = None
    parts: tuple[str, ...] = ()
    latest_us: int = field(default_factory=latest_us)

    def wants(self, label: dt.date) -> bool:
        """Whether a night lies within the asked-for range."""
        return (self.since is None or label >= self.since) and (
            self.until is None or label <= self.until
        )


@dataclass(frozen=True, slots=True)
class MotorOutcome:
    """What came of a motor in a run.

    Attributes
    ----------
    status
        failed if a night failed; else ok if a night was fitted; else what came of its nights.
    error_code, message
        The first failure; without one, why there is no fit at all, and no code.
    counts
        Nights by outcome.
    nights
        Labels of the nights whose rows are staged.
    withdrawn
        Those of them that are no nights, as only the name or time of an unreadable log told them:
        their rows go.
    inputs
        Hashes of the contents that were read, in the order of the files.
    files
        Log files by what came of them: read, unchanged, growing, failed or left.
    growing
        What there is to say of each file that is changed while it is read.
    n_refitted
        Nights that were fitted anew from their stored statistics, without a log.
    reasons
        Nights by why they were made anew.
    ledger
        What is to be remembered of the months that changed, once its rows are published.
    seconds
        Time by stage.
    peak_memory_mib
        Largest memory of the worker so far.
    is_set_aside
        Whether its task was lost once, and is tried again when the others are published.
    """

    motor_id: str
    status: str
    error_code: str | None = None
    message: str | None = None
    counts: Mapping[str, int] = field(default_factory=dict)
    nights: tuple[dt.date, ...] = ()
    withdrawn: tuple[dt.date, ...] = ()
    inputs: tuple[str, ...] = ()
    files: Mapping[str, int] = field(default_factory=dict)
    growing: tuple[str, ...] = ()
    n_refitted: int = 0
    reasons: Mapping[str, int] = field(default_factory=dict)
    ledger: Mapping[str, Ledger] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    peak_memory_mib: float | None = None
    is_set_aside: bool = False

    @property
    def finished(self) -> bool:
        """Whether the task came to its end, whatever came of its nights."""
        return self.peak_memory_mib is not None


@dataclass(frozen=True, slots=True)
class SplitMotor:
    """A motor with so many nights to read that other tasks are to make them.

    Attributes
    ----------
    looked_at
        What was seen of its logs.
    parts
        Nights of each part, in order of time.
    """

    motor_id: str
    looked_at: Mapping[str, FileRecord]
    parts: tuple[tuple[dt.date, ...], ...]


@dataclass(frozen=True, slots=True)
class PartTask:
    """Some nights of a motor, to be read and fitted apart from the others.

    Attributes
    ----------
    motor
        The motor's own task.
    nights
        Which nights.
    staging
        Folder in which they are left, as `name`.
    """

    motor: MotorTask
    nights: tuple[dt.date, ...]
    staging: Path

    @property
    def name(self) -> str:
        """Its file below the staging folder."""
        return f"parts/{self.motor.spec.motor_id}@{min(self.nights)}"


@dataclass(frozen=True, slots=True)
class PartOutcome:
    """That a part is made, or why not.

    Attributes
    ----------
    name
        Its file below the staging folder.
    failure
        What then comes of the motor; None: the part is made.
    given_up, silent
        Nights that workers were lost in, each time, which are not made, and logs that did not
        answer.
    seconds
        Time by stage.
    peak_memory_mib
        Largest memory of the worker so far.
    """

    motor_id: str
    name: str
    failure: MotorOutcome | None = None
    given_up: Mapping[dt.date, Loss] = field(default_factory=dict)
    silent: Mapping[str, Loss] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    peak_memory_mib: float | None = None


@dataclass(frozen=True, slots=True)
class MadeNight:
    """A night as another task has made it, and what it saw of which logs.

    Nights hang together by the model before alone, which is judged again when they are joined.
    """

    outcome: NightOutcome
    seen: Mapping[str, Sight]
    used: tuple[str, ...]


def lost(task: MotorTask, loss: Loss) -> MotorOutcome:
    """The outcome of a motor whose task was lost as a whole."""
    return MotorOutcome(task.spec.motor_id, FAILED, loss.code, legible(loss.how))


def set_aside(task: MotorTask, loss: Loss) -> MotorOutcome:
    """The outcome of a motor whose task was lost, and is to be tried again later."""
    how = f"{loss.how}; tried again when the other motors are published"
    return replace(lost(task, replace(loss, how=how)), is_set_aside=True)


def without_lost_part(task: MotorTask, loss: Loss) -> MotorTask | None:
    """The task that gives up what it was lost in, a log or a night; None where that is not known.

    Nor where it has given up too much already.
    """
    if MOST_GIVEN_UP in (len(task.given_up), len(task.silent)):
        return None
    if loss.log:
        return replace(task, silent={**task.silent, loss.log: loss})
    if loss.part:
        return replace(task, given_up={**task.given_up, dt.date.fromisoformat(loss.part): loss})
    return None


def part_without_lost_part(task: PartTask, loss: Loss) -> PartTask | None:
    """As `without_lost_part`, of a part of a motor."""
    motor = without_lost_part(task.motor, loss)
    return None if motor is None else replace(task, motor=motor)
