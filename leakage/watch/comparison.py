"""Before and after a date that somebody names: what changed, by how much, and how sure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from leakage.errors import EstimationError
from leakage.watch import choices
from leakage.watch.adoption import with_evidence
from leakage.watch.attribution import name_of
from leakage.watch.evidence import Evidence, Window
from leakage.watch.nights import Estimate, Machine, NightBlocks, WatchSettings
from leakage.watch.periods import begin
from leakage.watch.state import WatchState
from leakage.watch.watch import with_night

TINY = 1e-300


@dataclass(frozen=True, slots=True)
class Comparison:
    """Nights from a day on against those before."""

    change: Estimate  # Relative change of the flow at the same conditions, all causes.
    # That something has changed, where before the nights were seen both were as likely.
    probability: float
    # cause, cause_probability, candidates: As of `Change`: what it would be, if something has
    # changed.
    cause: str
    cause_probability: float
    candidates: Mapping[str, float]
    lack_of_fit: float  # Root mean square share of the flow before that the model misses.
    # True if the nights after have other operating conditions: the interval is wider by the model's
    # error.
    operates_otherwise: bool


def compare(
    machine: Machine,
    before: Sequence[NightBlocks],
    after: Sequence[NightBlocks],
    settings: WatchSettings,
) -> Comparison:
    """Return what changed between some nights and those after them, by the watch's own statistic.

    The date is given, so its start is asked in place of all, and no rate of false alarms is needed:
    the likelihood ratio of a step or a ramp of any cause, with even odds before. A single odd night
    is no change.

    `machine`: Paths and oil.
    `before, after`: Nights in order.
    `settings`: The least number of nights before.

    Raises EstimationError if there are too few nights before, or none after.
    """
    if len(before) < settings.baseline_nights or not after:
        raise EstimationError(
            "watch_baseline",
            f"{len(before)} nights before and {len(after)} after; a comparison needs "
            f"{settings.baseline_nights} before and one after",
        )
    state = begin(machine, before, settings)
    start = len(before)
    for night in after:
        state = with_night(state, night)
        state = with_evidence(state, state.evidence_now(), start)
    evidence, starts = state.evidence_now(), np.array([start])
    log_ratio = _with_odd_nights(evidence, state.window, start)
    change = _change(state, start)
    name = name_of(evidence, machine, state.baseline, int(state.window.days[start]), change.value)
    return Comparison(
        change,
        float(expit(log_ratio)),
        name.cause,
        name.probability,
        name.candidates,
        state.baseline.model_error,
        bool(evidence.operating_beyond(starts) > 0.0),
    )


def _with_odd_nights(evidence: Evidence, window: Window, start: int) -> float:
    """Return ln of the likelihood ratio of a change at a start, where any later night may be odd.

    With or without a change, all nights are ordinary, or a single night is odd and says nothing: a
    step, which every night shows, loses next to nothing by that, and what a single night made all.
    """
    nights = np.arange(start, len(window))
    whole = np.logaddexp.reduce(evidence.of_starts(nights[:1]).log_ratio, axis=None)
    # As `odd` has it of each night: ln(1 − ε + ε LR) of the night alone; here ln(ε LR).
    odd = window.odd[start:]
    odd = odd + np.log(np.maximum(-np.expm1(math.log(1.0 - choices.ODD) - odd), TINY))
    rest = np.zeros(1)
    if len(nights) > 1:
        others = evidence.of_starts(np.full(len(nights), start), without=nights)
        rest = np.logaddexp.reduce(others.log_ratio, axis=(0, 2))
    changed = np.logaddexp(whole, np.logaddexp.reduce(odd + rest))
    return float(changed - np.logaddexp(0.0, np.logaddexp.reduce(odd)))


def _change(state: WatchState, start: int) -> Estimate:
    """Return relative change of all flows from a place of the window on."""
    # The nights after say nothing of the surroundings: their change would pass for an effect.
    level = state.level_along(state.baseline.all_flows, end=start)
    before, after = level.mean(slice(None, start)), level.mean(slice(start, None))
    sd = math.hypot(after.sd, before.sd) / (1.0 + before.value)
    return Estimate((1.0 + after.value) / (1.0 + before.value) - 1.0, sd)
