"""Task and outcome records: plain data that processes exchange."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path

from pipeline.clock import latest_us
from pipeline.config import MotorSpec
from pipeline.logs.files import NEW_LOG
from pipeline.logs.finding import legible
from pipeline.logs.ledger import Ledger, SeenLogs
from pipeline.schema.fits import FAILED
from pipeline.workers.process import Loss

# A motor of which more nights than this take their worker with them, or more logs than this do not
# answer, is given up as a whole.
MOST_GIVEN_UP = 3


class Work(Enum):
    """Source of a night that is made anew: its log, its statistics, or the model before only."""

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
    """A motor for a worker: plain data, small enough to send."""

    spec: MotorSpec  # the motor with its resolved config
    output: Path  # output folder, for the tables (read only)
    staging: Path  # folder for this run's staged rows
    ledger: Ledger = field(default_factory=Ledger)  # the motor's, as the run before left it
    # since, until: labels of the first and last night to do; None: no limit.
    since: dt.date | None = None
    until: dt.date | None = None
    force: bool = False  # whether to make nights anew from their logs that nothing has changed of
    retry: bool = False  # whether to try nights and logs again that failed
    # Whether to look at a log before it is read, though it is the only new one: its worker died.
    looks_first: bool = False
    # Losses of this run, each in a night that is not made, or at a log that is not opened.
    given_up: tuple[Loss, ...] = ()
    # The motor's logs as they were looked at before in this run; None: not yet.
    looked_at: SeenLogs | None = None
    # Samples after this time are refused [µs since 1970]: a day after the run's clock.
    latest_us: int = field(default_factory=latest_us)

    @property
    def lost_nights(self) -> dict[dt.date, Loss]:
        """Nights that this run's workers were lost in, each time."""
        return {dt.date.fromisoformat(one.part): one for one in self.given_up if not one.log}

    @property
    def silent(self) -> dict[str, Loss]:
        """Logs that did not answer, and patterns of logs whose folders did not."""
        return {one.log: one for one in self.given_up if one.log}

    def wants(self, label: dt.date) -> bool:
        """True where a night lies within the asked-for range."""
        return (self.since is None or label >= self.since) and (
            self.until is None or label <= self.until
        )


@dataclass(frozen=True, slots=True)
class MotorOutcome:
    """The outcome of a motor's task."""

    motor_id: str
    # failed if a night failed; else ok if a night was fitted; else what came of its nights.
    status: str
    # error_code, message: the first failure; without one, why there is no fit at all, and no code.
    error_code: str | None = None
    message: str | None = None
    counts: Mapping[str, int] = field(default_factory=dict)  # nights by outcome
    nights: tuple[dt.date, ...] = ()  # labels of the nights whose rows are staged
    # Those of them that are no nights, as only the name or time of an unreadable log told them:
    # their rows go.
    withdrawn: tuple[dt.date, ...] = ()
    inputs: tuple[str, ...] = ()  # hashes of the contents that were read, in the order of the files
    # Log files by what came of them: read, unchanged, growing, failed or left.
    files: Mapping[str, int] = field(default_factory=dict)
    # What there is to say of each file that is changed while it is read.
    growing: tuple[str, ...] = ()
    # Nights and logs that failed, in this run or in one before, and are as they were.
    n_standing: int = 0
    n_refitted: int = 0  # nights that were fitted anew from their stored statistics, without a log
    reasons: Mapping[str, int] = field(default_factory=dict)  # nights by why they were made anew
    seconds: Mapping[str, float] = field(default_factory=dict)  # time by stage
    peak_memory_mib: float | None = None  # largest memory of the worker so far

    @property
    def finished(self) -> bool:
        """True where the task came to its end, whatever came of its nights."""
        return self.peak_memory_mib is not None


def lost(task: MotorTask, loss: Loss) -> MotorOutcome:
    """The outcome of a task that was lost as a whole."""
    return MotorOutcome(task.spec.motor_id, FAILED, loss.code, legible(loss.how))


def without_lost_part(task: MotorTask, loss: Loss) -> MotorTask | None:
    """The task that gives up the log or night it was lost in; None: unknown, or too many.

    Of a log that was read before any night was known, the night is found out first.
    """
    if loss.part == NEW_LOG and not loss.log:
        return replace(task, looks_first=True)
    if MOST_GIVEN_UP in (len(task.lost_nights), len(task.silent)) or not (loss.log or loss.part):
        return None
    return replace(task, given_up=(*task.given_up, loss))
