"""The state of a motor in a night: what the watch says of it, as a word that people act upon."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from leakage.watch import Change, Estimate
from leakage.watch.causes import AND, BACK, CANNOT_BE_TOLD, TANK, TEMPERATURE_EFFECT
from pipeline.config import MotorSpec
from pipeline.schema.fits import DOUBTFUL, ModelVerdict, model_verdict
from pipeline.trends.nights.layout import FLUSHING, KNOWN
from pipeline.trends.states.course import WatchedNight

# Probability from which a level counts as exceeded.
SURE = 0.975
# Smallest change that would have been detected, beyond which nights show nothing that anybody asks.
SHOWS_NOTHING = 0.5
# What the candidates are together that are parts.
A_PART = "a_part"


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
    def needed(self) -> int:
        """Nights of a baseline."""
        return self.spec.settings.trend.baseline_nights


def judged(
    spec: MotorSpec, night: WatchedNight, fitted: Estimate | None, why_no_blocks: str
) -> JudgedNight:
    """The state of a night."""
    verdict = night.verdict
    change = None if verdict is None else verdict.change
    if change is not None and verdict is not None and verdict.lack_of_fit > DOUBTFUL:
        change = _unnamed(change, night)
    found = JudgedNight(spec, night, "", "", change, why_no_blocks, fitted)
    state, way = _state(found)
    return replace(found, state=state, way=way)


def _unnamed(change: Change, night: WatchedNight) -> Change:
    """A change of a motor that the model does not describe: it names no part."""
    assert night.watch is not None
    parts = {*night.watch.state.machine.paths, "all_gaps"} - {FLUSHING, KNOWN}

    def is_part(cause: str) -> bool:
        return not parts.isdisjoint(cause.split(AND))

    left = {name: p for name, p in change.candidates.items() if not is_part(name)}
    if share := sum(p for name, p in change.candidates.items() if is_part(name)):
        left[A_PART] = share
    change = replace(change, candidates=left)
    if is_part(change.cause):
        change = replace(change, cause=CANNOT_BE_TOLD, path_growth=None)
    return change


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
    if change.is_rise and watched.verdict.present.probability_above(level) >= SURE:
        return "alarm", "level"
    return "warning", "change"
