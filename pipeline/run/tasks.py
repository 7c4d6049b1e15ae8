"""Requests, tasks and their outcomes: plain data that processes exchange."""

from __future__ import annotations

import datetime as dt
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Any

from pipeline.clock import latest_us, now
from pipeline.config import Fleet, MotorSpec
from pipeline.ingest import RawChannel
from pipeline.logs.finding import legible
from pipeline.logs.processed import FileRecord, ProcessedChange, ProcessedLogs
from pipeline.schema import FAILED
from pipeline.store.published import TableFault
from pipeline.trends.decisions import Kind, read_decisions
from pipeline.workers.process import Loss

# A motor of which more nights than this take their worker with them, or more logs than this do not
# answer, is given up as a whole.
MOST_GIVEN_UP = 3


FirstLook = Callable[
    [
        MotorSpec,
        dt.date,
        Sequence[tuple[dt.date, str]],
        Callable[[str], Path],
        Mapping[str, RawChannel],
    ],
    Iterable[str],
]
"""What is said of columns and units of the newest night of a motor's first run.

It gets motor, night, the logs that can be read in order of time with the last night of each, how to
find a log, and the night's raw channels.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """Nights that a person asks for, and how they are made."""

    # since, until: labels of the first and last night to do; None: no limit.
    since: dt.date | None = None
    until: dt.date | None = None
    # redo: first and last night to make anew from the logs that there are, whatever they lack.
    redo: tuple[dt.date, dt.date] | None = None
    retry: bool = False  # whether to try nights and logs again that failed
    first_look: FirstLook | None = None  # what looks at motors of the first run

    def asks_for(self, label: dt.date) -> bool:
        """Return True where a person wants a night made anew, whatever its logs lack."""
        return self.redo is not None and self.redo[0] <= label <= self.redo[1]

    def wants(self, label: dt.date) -> bool:
        """Return True where a night lies within the asked-for range."""
        return (self.since is None or label >= self.since) and (
            self.until is None or label <= self.until
        )


@dataclass(frozen=True, slots=True)
class RunRequest(Selection):
    """Request of a run."""

    fleet: Fleet  # the config
    motors: tuple[str, ...] = ()  # ids of the motors to do; empty for all
    repair: bool = False  # whether to prove every table file before
    # The time of the run, by which logs lie in the future.
    clock: dt.datetime = field(default_factory=now)

    @property
    def specs(self) -> tuple[MotorSpec, ...]:
        """The motors that are asked for."""
        return tuple(
            spec for spec in self.fleet.motors if not self.motors or spec.motor_id in self.motors
        )

    def tasks(self, staging: Path) -> list[MotorTask]:
        """Return a task for each motor that is asked for."""
        decided: defaultdict[tuple[str, Kind], set[dt.date]] = defaultdict(set)
        for decision in read_decisions(self.fleet.output):
            decided[decision.motor_id, decision.kind].add(decision.night)
        return [
            MotorTask(
                spec=spec,
                output=self.fleet.output,
                staging=staging,
                since=self.since,
                until=self.until,
                redo=self.redo,
                retry=self.retry,
                first_look=self.first_look,
                latest_us=latest_us(self.clock),
                excluded=frozenset(decided[spec.motor_id, "excluded"]),
                released=frozenset(decided[spec.motor_id, "released"]),
            )
            for spec in self.specs
        ]


class Work(Enum):
    """Source of a night that is made anew: its log, or its statistics; neither where it stays."""

    READ = "read"
    REFIT = "refit"
    STAY = "stay"


@dataclass(frozen=True, slots=True)
class Step:
    """A night that is to be made anew, or cannot be: how far, and why, in words."""

    work: Work
    reason: str


@dataclass(frozen=True, slots=True)
class MotorTask(Selection):
    """A motor for a worker: plain data, small enough to send."""

    spec: MotorSpec  # the motor with its resolved config
    output: Path  # output folder, for the tables (read only)
    staging: Path  # folder for this run's staged rows
    # processed: The motor's, as the run before left it.
    processed: ProcessedLogs = field(default_factory=ProcessedLogs)
    # Losses of this run, each in a night that is not made, or at a log that is not opened.
    given_up: tuple[Loss, ...] = ()
    # The motor's logs where they are known to be as they were; None: they are to be looked at.
    log_records: Mapping[str, FileRecord] | None = None
    # Samples after this time are refused [µs since 1970]: a day after the run's clock.
    latest_us: int = field(default_factory=latest_us)
    # Nights that people accepted as failed, and those that they released for fitting.
    excluded: frozenset[dt.date] = frozenset()
    released: frozenset[dt.date] = frozenset()

    def __str__(self) -> str:
        return self.spec.motor_id

    @property
    def lost_nights(self) -> dict[dt.date, Loss]:
        """Nights that this run's workers were lost in, each time."""
        return {dt.date.fromisoformat(loss.part): loss for loss in self.given_up if not loss.log}

    @property
    def silent(self) -> dict[str, Loss]:
        """Logs that did not answer, and patterns of logs whose folders did not."""
        return {loss.log: loss for loss in self.given_up if loss.log}


@dataclass(frozen=True, slots=True)
class MotorOutcome:
    """The outcome of a motor's task."""

    motor_id: str
    # failed if a night failed; else ok if a night was fitted; else what came of its nights.
    status: str
    # error_code, message: the first failure; without any, why there is no fit at all, and no code.
    error_code: str | None = None
    message: str | None = None
    counts: Mapping[str, int] = field(default_factory=dict)  # nights by outcome
    nights: tuple[dt.date, ...] = ()  # labels of the nights whose rows are staged
    anew: str = ""  # how many published nights other settings made anew, and which; in words
    inputs: tuple[str, ...] = ()  # hashes of the contents that were read, in the order of the files
    # Log files by what came of them: read, unchanged, growing, failed or left.
    files: Mapping[str, int] = field(default_factory=dict)
    # Nights that stay as published from this run on, and why.
    stays: Mapping[dt.date, str] = field(default_factory=dict)
    # What there is to say of each file that is changed while it is read.
    growing: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()  # what is said of files of which rows were left out
    # Of a motor's first run: what may be wrong with its units and columns.
    findings: tuple[str, ...] = ()
    # Nights and logs that failed, in this run or before, and are as they were.
    n_standing: int = 0
    n_refitted: int = 0  # nights that were fitted anew from their stored statistics, without a log
    seconds: Mapping[str, float] = field(default_factory=dict)  # time by stage
    peak_memory_mib: float | None = None  # largest memory of the worker so far
    # change: Of the motor's record of processed logs.
    change: ProcessedChange = field(default_factory=ProcessedChange)

    @property
    def changed_from(self) -> dt.date | None:
        """First night of which something else is published than before; None without any."""
        return min((*self.nights, *self.stays), default=None)

    @property
    def finished(self) -> bool:
        """True where the task came to its end, whatever came of its nights."""
        return self.peak_memory_mib is not None


def lost(task: MotorTask, loss: Loss) -> MotorOutcome:
    """Return the outcome of a task that was lost as a whole."""
    return MotorOutcome(task.spec.motor_id, FAILED, loss.code, legible(loss.how))


def without_lost_part(task: MotorTask, loss: Loss) -> MotorTask | None:
    """Return the task that gives up the log or night it was lost in; None: unknown, or too many."""
    if MOST_GIVEN_UP in (len(task.lost_nights), len(task.silent)) or not (loss.log or loss.part):
        return None
    return replace(task, given_up=(*task.given_up, loss))


@dataclass(frozen=True, slots=True)
class RunResult:
    """Result of a run."""

    run_id: str  # hash of the inputs' contents, the code's version and the config
    outcomes: tuple[MotorOutcome, ...]  # by motor, sorted by id
    n_nights: int  # nights of motors that were written
    # Whether the run was stopped before all motors were done; what was finished is published.
    interrupted: bool
    # Wall-clock time by stage: `motors_s` until all tasks were done, `publish_s` and `trends_s`.
    seconds_by_stage: Mapping[str, float] = field(default_factory=dict)
    alarms: tuple[Mapping[str, Any], ...] = ()  # new rows of `alarms`
    damage: tuple[TableFault, ...] = ()  # published files that were found damaged or gone
    damage_left: tuple[TableFault, ...] = ()  # what of it could not be made anew
    copy_fault: str = ""  # why the tables could not be copied to `folders.copy_to`

    @property
    def seconds(self) -> float:
        """Wall-clock time."""
        return sum(self.seconds_by_stage.values())

    @property
    def files(self) -> Counter[str]:
        """Log files of all motors by what came of them: read, unchanged, growing, failed, left."""
        return sum((Counter(outcome.files) for outcome in self.outcomes), Counter())

    @property
    def n_standing(self) -> int:
        """Failures of nights and logs that stand, of this run or of runs before."""
        return sum(outcome.n_standing for outcome in self.outcomes)

    @property
    def is_good(self) -> bool:
        """True where it went through all motors, some had a log, and no failure stands."""
        return not (self.interrupted or self.failed or self.n_standing or self.without_logs)

    @property
    def without_logs(self) -> bool:
        """True where no motor has any log: the folder may not be mounted."""
        if self.interrupted:
            return False
        return not any(outcome.files or not outcome.finished for outcome in self.outcomes)

    @property
    def failed(self) -> tuple[MotorOutcome, ...]:
        """Motors with a failed night."""
        return tuple(outcome for outcome in self.outcomes if outcome.status == FAILED)
