"""Request of a run, and its result."""

from __future__ import annotations

import datetime as dt
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pipeline.clock import now
from pipeline.config import Fleet, MotorSpec
from pipeline.run.tasks import MotorOutcome
from pipeline.schema.fits import FAILED
from pipeline.store.published import TableFault


@dataclass(frozen=True, slots=True)
class RunRequest:
    """Request of a run."""

    fleet: Fleet  # the config
    motors: tuple[str, ...] = ()  # ids of the motors to do; empty for all
    # since, until: labels of the first and last night to do; None: no limit.
    since: dt.date | None = None
    until: dt.date | None = None
    force: bool = False  # whether to make nights anew from their logs that nothing has changed of
    retry: bool = False  # whether to try nights and logs again that failed
    # The time of the run, by which logs lie in the future.
    clock: dt.datetime = field(default_factory=now)

    @property
    def specs(self) -> tuple[MotorSpec, ...]:
        """The motors that are asked for."""
        return tuple(
            spec for spec in self.fleet.motors if not self.motors or spec.motor_id in self.motors
        )


@dataclass(frozen=True, slots=True)
class RunResult:
    """Result of a run."""

    run_id: str  # hash of the inputs' contents, the code's version and the config
    outcomes: tuple[MotorOutcome, ...]  # one a motor, sorted by id
    n_nights: int  # nights of motors that were written
    # Whether the run was stopped before all motors were done; what was finished is published.
    interrupted: bool
    seconds: float  # wall-clock time
    alarms: tuple[Mapping[str, Any], ...] = ()  # new rows of `alarms`
    # Of these: `motors_s` until all tasks were done, `publish_s` and `trends_s`.
    seconds_by_stage: Mapping[str, float] = field(default_factory=dict)
    damage: tuple[TableFault, ...] = ()  # published files that were found damaged or gone
    damage_left: tuple[TableFault, ...] = ()  # what of it could not be made anew

    @property
    def files(self) -> Counter[str]:
        """Log files of all motors by what came of them: read, unchanged, growing, failed, left."""
        return sum((Counter(outcome.files) for outcome in self.outcomes), Counter())

    @property
    def n_standing(self) -> int:
        """Failures of nights and logs that stand, of this run or of one before."""
        return sum(outcome.n_standing for outcome in self.outcomes)

    @property
    def is_good(self) -> bool:
        """True where it went through all motors, and no failure stands."""
        return not (self.interrupted or self.failed or self.n_standing)

    @property
    def failed(self) -> tuple[MotorOutcome, ...]:
        """Motors with at least one failed night."""
        return tuple(outcome for outcome in self.outcomes if outcome.status == FAILED)
