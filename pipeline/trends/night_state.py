"""The state of a motor in a night: what the watch says of it, as a word that people act upon."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leakage.watch import Change, Estimate, Machine, NightBlocks, Verdict, Watch
from leakage.watch.attribution import LEAST_PROBABILITY, parts_of
from leakage.watch.causes import (
    ALL_FLOWS,
    ALL_GAPS,
    AND,
    BACK,
    CHANNELS,
    NO_LEAKAGE,
    NOT_IDENTIFIED,
    ODD_NIGHTS,
    OIL_GRADE,
    TANK,
    TEMPERATURE_EFFECT,
)
from leakage.watch.choices import MOSTLY, NAMED, PRESENT_NIGHTS
from leakage.watch.circuit import CircuitChange
from leakage.watch.nights import SEVERAL
from pipeline.arrays import Array
from pipeline.config import MotorSpec
from pipeline.config.settings import Conditions
from pipeline.schema import DOUBTFUL, ModelVerdict, model_verdict
from pipeline.trends.nights import BaselinePeriod
from pipeline.trends.watch_columns import FLUSHING, KNOWN

# Probability from which a level counts as exceeded.
SURE = 0.975
# Smallest change that would have been detected, beyond which nights show nothing that anybody asks.
SHOWS_NOTHING = 0.5
# What the parts are together where the model does not describe the motor; between the names of
# causes of which it is one or more.
A_PART, ONE_OF = "a_part", " or "
# Causes beside parts that may be wear.
MAY_BE_WEAR = (A_PART, ALL_GAPS, ALL_FLOWS, SEVERAL)
# Names that do not come of the shape of a change.
NOT_OF_SHAPE = (BACK, CHANNELS, ODD_NIGHTS, TANK)


@dataclass(frozen=True, slots=True)
class Baseline:
    """A baseline period: its nights, and what is frozen with it.

    `own` are the motor's own conditions, `coefficients` those of the paths as the watch has them;
    the leakages are at the motor's own and at the reference conditions, [l/min].
    """

    start: dt.date
    end: dt.date
    n: int
    own: Conditions
    coefficients: tuple[float, ...]
    own_leakage: float | None = None
    reference_leakage: float | None = None

    @classmethod
    def of(cls, watch: Watch, nights: Sequence[NightBlocks], charges: Array) -> Baseline:
        """Return baseline of some nights, after which a watch stands and their charge pressures."""
        every = np.concatenate([night.conditions for night in nights])
        temperature, pressure, speed = np.median(every, axis=0).tolist()
        known = charges[np.isfinite(charges)]
        charge = float(np.median(known)) if len(known) else None
        first, last = (dt.date.fromordinal(night.day) for night in (nights[0], nights[-1]))
        own = Conditions(pressure, temperature, speed, charge)
        columns = watch.state.baseline.columns
        theta = columns.theta[: columns.n_driven]
        return cls(first, last, len(nights), own, tuple(theta.tolist()))


@dataclass(frozen=True, slots=True)
class NightState:
    """A motor in a night: what the watch says of it, its state, and the way into that.

    The leakages are at the motor's own and at the reference conditions, [l/min], without flushing;
    a text says why there is none.
    """

    spec: MotorSpec
    place: int
    night: dt.date
    period: BaselinePeriod
    n_blocks: int
    n_waiting: int  # nights so far of a baseline that is not whole
    silent: int  # nights since the last with blocks
    why_no_blocks: str = ""  # empty where the night has some
    is_refused: bool = False  # it has samples, and too few that count
    fitted: Estimate | None = None  # reference leakage of the night's own fit
    baseline: Baseline | None = None
    watch: Watch | None = None
    verdict: Verdict | None = None
    own_leakage: Estimate | str = "no baseline yet"
    reference_leakage: Estimate | str = "no baseline yet"
    change: Change | None = None  # in force
    state: str = ""
    way: str = ""
    known: NightState | None = None  # of a stale motor: as its last nights left it

    @property
    def model_verdict(self) -> ModelVerdict | None:
        """Verdict on the model by its lack of fit; None before there is a watch."""
        return None if self.verdict is None else model_verdict(self.verdict.lack_of_fit)

    @property
    def reference(self) -> Estimate | None:
        """Leakage at the reference conditions, until there is a watch by the night's own fit."""
        leakage = self.reference_leakage
        return self.fitted if isinstance(leakage, str) else leakage

    @property
    def circuit(self) -> CircuitChange | None:
        """The change in force beside those of the circuit's other motors; None without them."""
        if self.watch is None or self.change is None or self.watch.state.in_force is None:
            return None
        return self.watch.state.in_force.circuit

    @property
    def is_beyond_circuit_nights(self) -> bool:
        """True if the change has lasted for longer than the nights that `circuit` is of."""
        since = None if self.change is None else self.change.since
        return since is not None and self.night.toordinal() - since >= PRESENT_NIGHTS

    @property
    def gap_growth(self) -> Estimate | None:
        """Relative change of the gap that the cause names; None where it names none."""
        watch, change = self.watch, self.change
        growth = None if change is None else change.path_growth
        if watch is None or change is None or growth is None:
            return None
        if change.cause not in watch.state.machine.gaps or growth.value <= -1.0:
            return None
        height = math.cbrt(1.0 + growth.value)
        return Estimate(height - 1.0, growth.sd / (3.0 * height**2))

    @property
    def may_wear(self) -> bool:
        """True unless what changed is no wear: then no time to a limit follows (issue 49.9)."""
        change = self.change
        if change is None or self.state == "common_cause":
            return change is None
        parts = frozenset() if self.watch is None else parts_in(self.watch.state.machine)
        wears = {*parts, *MAY_BE_WEAR}
        share = sum(
            probability
            for label, probability in change.candidates.items()
            if not wears.isdisjoint(label.split(ONE_OF)) or AND in label
        )
        return change.is_rise and (share >= MOSTLY or not change.candidates)


def parts_in(machine: Machine) -> frozenset[str]:
    """Return names of the paths that are parts."""
    return frozenset(machine.paths) - {FLUSHING, KNOWN}


def with_state(night: NightState) -> NightState:
    """Return a night with its change, as people see it, and its state."""
    if night.verdict is not None and night.verdict.change is not None:
        night = replace(night, change=_as_shown(night.verdict.change, night))
    state, way = _state(night)
    night = replace(night, state=state, way=way)
    if night.silent > night.spec.settings.alarms.stale_after_nights:
        return replace(night, state="stale", way="stale", known=night)
    return night


def _as_shown(change: Change, night: NightState) -> Change:
    """Return a change as people see it: causes that nothing tells apart are one (model.md, 7c.4).

    A motor that the model does not describe names no part. Another oil is among what moves all
    flows.
    """
    assert night.watch is not None
    assert night.verdict is not None
    machine, is_disproved = night.watch.state.machine, night.verdict.lack_of_fit > DOUBTFUL
    parts = parts_in(machine)
    within = dict.fromkeys((*parts, KNOWN), A_PART) if is_disproved else {}
    if ALL_FLOWS in change.alike:
        within[OIL_GRADE] = ALL_FLOWS

    def shown(names: Iterable[str]) -> frozenset[str]:
        return frozenset(within.get(name, name) for name in names)

    alike, cause, probability = shown(change.alike), change.cause, change.probability
    if is_disproved and ALL_FLOWS in (cause, *alike):
        # A model that misses much tells no part from all flows.
        alike = alike | {ALL_FLOWS, A_PART}
    is_prior = not alike.isdisjoint(shown(parts)) and len(alike) > 1
    is_class = is_prior or cause == NOT_IDENTIFIED or is_disproved
    # A name that the nights tell from its like stands alone.
    alike = alike if is_class else frozenset()
    of_class = ONE_OF.join(sorted(alike))
    candidates: dict[str, float] = {}
    for name, share in change.candidates.items():
        of_name = shown(parts_of(name, machine.gaps))
        label = of_class if of_name <= alike else A_PART if of_name == {A_PART} else name
        candidates[label] = candidates.get(label, 0.0) + share
    if change.cause == TANK:
        rest = (1.0 - change.probability) / max(sum(candidates.values()), 1.0)
        candidates = {TANK: change.probability} | {a: rest * b for a, b in candidates.items()}
    candidates = {name: p for name, p in candidates.items() if p > LEAST_PROBABILITY}
    candidates = dict(sorted(candidates.items(), key=lambda candidate: -candidate[1]))
    if cause not in NOT_OF_SHAPE and is_class:
        likeliest, share = next(iter(candidates.items()), (NOT_IDENTIFIED, 0.0))
        if share >= NAMED and likeliest not in (SEVERAL, TEMPERATURE_EFFECT):
            cause, probability = likeliest, share
        elif is_prior or A_PART in shown(parts_of(cause, machine.gaps)):
            cause, probability = NOT_IDENTIFIED, share
    has_growth = cause == change.cause and not is_disproved
    growth = change.path_growth if has_growth else None
    grade = None if cause in NOT_OF_SHAPE else change.grade
    return replace(
        change,
        cause=cause,
        probability=probability,
        candidates=candidates,
        path_growth=growth,
        grade=grade,
    )


def _state(night: NightState) -> tuple[str, str]:
    """Return state but for silence, and the way into it."""
    change, verdict, limits = night.change, night.verdict, night.spec.motor_type.limits
    for state, limit in (("alarm", limits.alarm_l_per_min), ("warning", limits.warning_l_per_min)):
        leakage = night.reference
        if limit is not None and leakage is not None and leakage.probability_above(limit) >= SURE:
            return state, "limit"
    if verdict is None:
        return "insufficient", "baseline"
    if change is None or change.cause in (BACK, TEMPERATURE_EFFECT):
        if verdict.smallest is None or verdict.smallest > SHOWS_NOTHING:
            return "insufficient", "baseline"
        return "ok", "recovered"
    if change.cause == TANK:
        return "common_cause", "common_cause"
    level = night.spec.settings.alarms.alarm_percent / 100.0
    is_leakage = change.cause not in NO_LEAKAGE
    if is_leakage and verdict.present.probability_above(level) >= SURE:
        return "alarm", "level"
    return "warning", "change"
