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
from pipeline.store.verification import TableFault


@dataclass(frozen=True, slots=True)
class RunRequest:
    """Request of a run.

    Attributes
    ----------
    fleet
        The config.
    motors
        Ids of the motors to do; empty for all.
    since, until
        Labels of the first and last night to do; None: no limit.
    force
        Whether to make nights anew from their logs that nothing has changed of.
    retry
        Whether to try nights and logs again that failed.
    with_starts
        Whether nights that are, or were, fitted anew without their log get the starts of their
        search.
    clock
        The time of the run, by which logs lie in the future.
    """

    fleet: Fleet
    motors: tuple[str, ...] = ()
    since: dt.date | None = None
    until: dt.date | None = None
    force: bool = False
    retry: bool = False
    with_starts: bool = False
    clock: dt.datetime = field(default_factory=now)

    @property
    def specs(self) -> tuple[MotorSpec, ...]:
        """The motors that are asked for."""
        return tuple(
            spec for spec in self.fleet.motors if not self.motors or spec.motor_id in self.motors
        )


@dataclass(frozen=True, slots=True)
class RunResult:
    """Result of a run.

    Attributes
    ----------
    run_id
        Hash of the inputs' contents, the code's version and the config.
    outcomes
        One a motor, sorted by id.
    n_nights
        Nights of motors that were written.
    interrupted
        Whether the run was stopped before all motors were done; what was finished is published.
    seconds
        Wall-clock time.
    alarms
        New rows of `alarms`.
    seconds_by_stage
        Of these: `motors_s` until all tasks were done, `publish_s` and `trends_s`.
    damage
        Published files that were found damaged or gone.
    damage_left
        What of it could not be made anew.
    """

    run_id: str
    outcomes: tuple[MotorOutcome, ...]
    n_nights: int
    interrupted: bool
    seconds: float
    alarms: tuple[Mapping[str, Any], ...] = ()
    seconds_by_stage: Mapping[str, float] = field(default_factory=dict)
    damage: tuple[TableFault, ...] = ()
    damage_left: tuple[TableFault, ...] = ()

    @property
    def files(self) -> Counter[str]:
        """Log files of all motors by what came of them: read, unchanged, growing, failed, left."""
        return sum((Counter(outcome.files) for outcome in self.outcomes), Counter())

    @property
    def failed(self) -> tuple[MotorOutcome, ...]:
        """Motors with at least one failed night."""
        return tuple(outcome for outcome in self.outcomes if outcome.status == FAILED)
