"""The state of a motor in a night: what the watch says of it, as a word that people act upon."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from leakage.watch import Change, Estimate, Machine
from leakage.watch.attribution import LEAST_PROBABILITY, parts_of
from leakage.watch.causes import (
    ALL_FLOWS,
    ALL_GAPS,
    AND,
    BACK,
    CANNOT_BE_TOLD,
    NO_LEAKAGE,
    ODD_NIGHTS,
    TANK,
    TEMPERATURE_EFFECT,
)
from leakage.watch.choices import MOSTLY, NAMED
from leakage.watch.circuit import CircuitChange
from leakage.watch.nights import SEVERAL
from pipeline.config import MotorSpec
from pipeline.schema.fits import DOUBTFUL, ModelVerdict, model_verdict
from pipeline.trends.nights.layout import FLUSHING, KNOWN
from pipeline.trends.states.course import WatchedNight

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
NOT_OF_SHAPE = (BACK, ODD_NIGHTS, TANK)


@dataclass(frozen=True, slots=True)
class JudgedNight:
    """A night of a motor, with its state and the way into it.

    `change` is what stands told; `why_no_blocks` is empty where the night has some. `fitted` is
    the reference leakage of the night's own fit, until there is a watch.
    """

    spec: MotorSpec
    watched: WatchedNight
    state: str
    way: str
    change: Change | None
    why_no_blocks: str
    fitted: Estimate | None = None

    @property
    def model_verdict(self) -> ModelVerdict | None:
        """Verdict on the model by its lack of fit; None before there is a watch."""
        verdict = self.watched.verdict
        return None if verdict is None else model_verdict(verdict.lack_of_fit)

    @property
    def reference(self) -> Estimate | None:
        """Leakage at the reference conditions; None where there is none."""
        found = self.watched.reference
        return self.fitted if isinstance(found, str) else found

    @property
    def circuit(self) -> CircuitChange | None:
        """The change in force beside those of the circuit's other motors; None without them."""
        watch = self.watched.watch
        in_force = None if watch is None or self.change is None else watch.state.in_force
        return None if in_force is None else in_force.circuit

    @property
    def gap_growth(self) -> Estimate | None:
        """Relative change of the gap that the cause names; None where it names none."""
        watch, change = self.watched.watch, self.change
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
        wears = {*self.wearing_parts, *MAY_BE_WEAR}
        share = sum(
            probability
            for label, probability in change.candidates.items()
            if not wears.isdisjoint(label.split(ONE_OF)) or AND in label
        )
        return change.is_rise and (share >= MOSTLY or not change.candidates)

    @property
    def wearing_parts(self) -> frozenset[str]:
        """Names of the motor's parts."""
        watch = self.watched.watch
        return frozenset() if watch is None else parts_in(watch.state.machine)

    @property
    def needed(self) -> int:
        """Nights of a baseline."""
        return self.spec.settings.trend.baseline_nights


def parts_in(machine: Machine) -> frozenset[str]:
    """Names of the paths that are parts."""
    return frozenset(machine.paths) - {FLUSHING, KNOWN}


def judged(
    spec: MotorSpec, night: WatchedNight, fitted: Estimate | None, why_no_blocks: str
) -> JudgedNight:
    """The state of a night."""
    verdict = night.verdict
    change = None if verdict is None else verdict.change
    if change is not None:
        change = _as_shown(change, night)
    found = JudgedNight(spec, night, "", "", change, why_no_blocks, fitted)
    state, way = _state(found)
    return replace(found, state=state, way=way)


def _as_shown(change: Change, night: WatchedNight) -> Change:
    """A change as people see it: causes that the nights cannot tell apart are one (model.md, 7c.4).

    A motor that the model does not describe names no part.
    """
    assert night.watch is not None
    assert night.verdict is not None
    machine, is_disproved = night.watch.state.machine, night.verdict.lack_of_fit > DOUBTFUL
    parts = parts_in(machine)

    def shown(names: Iterable[str]) -> frozenset[str]:
        return frozenset(A_PART if is_disproved and name in parts else name for name in names)

    alike, cause, probability = shown(change.alike), change.cause, change.probability
    is_prior = not alike.isdisjoint(shown(parts)) and len(alike) > 1
    is_class = is_prior or cause == CANNOT_BE_TOLD or is_disproved
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
        likeliest, share = next(iter(candidates.items()), (CANNOT_BE_TOLD, 0.0))
        if share >= NAMED and likeliest != SEVERAL:
            cause, probability = likeliest, share
        elif is_prior or A_PART in shown(parts_of(cause, machine.gaps)):
            cause, probability = CANNOT_BE_TOLD, share
    has_growth = cause == change.cause and not is_disproved
    growth = change.path_growth if has_growth else None
    return replace(
        change, cause=cause, probability=probability, candidates=candidates, path_growth=growth
    )


def _state(night: JudgedNight) -> tuple[str, str]:
    """State, and the way into it."""
    spec, watched, change = night.spec, night.watched, night.change
    alarms, limits = spec.settings.alarms, spec.motor_type.limits
    if watched.silent > alarms.stale_after_nights:
        return "stale", "stale"
    for state, limit in (("alarm", limits.alarm_l_per_min), ("warning", limits.warning_l_per_min)):
        found = night.reference
        if limit is not None and found is not None and found.probability_above(limit) >= SURE:
            return state, "limit"
    if watched.verdict is None:
        return "insufficient", "baseline"
    if change is None or change.cause in (BACK, TEMPERATURE_EFFECT):
        smallest = watched.verdict.smallest
        if smallest is None or smallest > SHOWS_NOTHING:
            return "insufficient", "baseline"
        return "ok", "recovered"
    if change.cause == TANK:
        return "common_cause", "common_cause"
    level = alarms.alarm_percent / 100.0
    is_leakage = change.cause not in NO_LEAKAGE
    if is_leakage and watched.verdict.present.probability_above(level) >= SURE:
        return "alarm", "level"
    return "warning", "change"
