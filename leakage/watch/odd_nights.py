"""Odd nights, which are no change if single, and nights whose channels lie apart."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from leakage.arrays import Array
from leakage.watch import choices
from leakage.watch.causes import CHANNELS, ODD_NIGHTS
from leakage.watch.evidence import STEP, Evidence, Places, Sums, Window
from leakage.watch.nights import NOW_AND_THEN, STEPS, Change, Estimate
from leakage.watch.state import NOTHING, UNCHANGED, ChangeInForce, WatchState, on_first_baseline


def of_odd_night(evidence: Evidence, window: Window, starts: Places, by_start: Array) -> Array:
    """Return what an odd night since each start accounts for, shape (k,) (model.md, 7c.1).

    A single odd night is no change. What the oddest says alone is what all nights say less what
    they say without it, where odd nights do not come again and again. At other operating conditions
    nights share an error, so that each says nearly as much as all: there it is the night whose
    absence costs most.
    """
    oddest = np.array([start + int(window.odd[start:].argmax()) for start in starts])
    odd: Array = window.odd[oddest].copy()
    # To starts at usual operating conditions the newest night may say more than it does by itself.
    last = np.array([len(window) - 1])
    newest = evidence.of_starts(last, by_operation=False).log_ratio[STEP, 0]
    own = np.where(oddest == last, np.maximum(odd, _odd(np.logaddexp.reduce(newest))), odd)
    otherwise = evidence.operates_otherwise(starts)
    usual = np.flatnonzero(~otherwise & (starts < len(window) - 1))
    if len(usual) and not len(odd_places(window)):
        alone = by_start[usual] - _without(evidence, starts[usual], oddest[usual])
        odd[usual] = np.minimum(own[usual], _odd(alone))
    ages = len(window) - starts
    doubtful = otherwise & (by_start > choices.LEFT_OUT_FROM) & (ages <= choices.DENSE_STARTS)
    for place in np.flatnonzero(doubtful).tolist():
        nights = np.arange(starts[place], len(window))
        rest = _without(evidence, np.full(len(nights), starts[place]), nights)
        odd[place] = _odd(by_start[place] - rest.min())
    return odd


def _without(evidence: Evidence, starts: Places, nights: Places) -> Array:
    """Return ln of the likelihood ratios of starts that leave out a night each, shape (k,)."""
    log_ratio = evidence.of_starts(starts, without=nights).log_ratio
    rest: Array = np.logaddexp.reduce(log_ratio, axis=(0, 2))
    return rest


def _odd(alone: Array) -> Array:
    """Return ln of how much likelier a night is as an odd night, by itself; at least 0."""
    odd = np.logaddexp(math.log(1.0 - choices.ODD), math.log(choices.ODD) + alone)
    return np.maximum(odd, 0.0)


def odd_places(window: Window) -> Places:
    """Return the places of odd nights, if there are enough of them and not too many.

    Three within 60 nights, at most half of the nights since the first (model.md, 7c.1).
    """
    odd = np.flatnonzero(window.odd > 1.0)
    odd = odd[odd > len(window) - 1 - choices.ODD_WITHIN]
    if len(odd) < choices.LEAST_ODD:
        return odd[:0]
    return odd if len(odd) <= choices.MOST_ODD * (len(window) - odd[0]) else odd[:0]


def odd_nights_are_single(state: WatchState) -> bool:
    """Return whether odd nights come again and again, and those between are ordinary ones."""
    places = odd_places(state.window)
    if not len(places):
        return False
    level = state.level_along(state.baseline.leakage_flows).value[places[0] :]
    between = np.delete(level, places - places[0])
    odd = abs(float(level[places - places[0]].mean()))
    return abs(float(np.median(between))) < choices.MOSTLY * odd


def with_odd_nights(state: WatchState) -> WatchState:
    """Return the state with odd nights detected, unless another change is in force."""
    if state.in_force is not None and state.in_force.change.cause != ODD_NIGHTS:
        return replace(state, often=NOTHING)
    places, again = odd_places(state.window), state.in_force is not None
    level = state.level_along(state.baseline.leakage_flows)
    value = level.value[places]
    size = Estimate(float(value.mean()), float(value.std() / math.sqrt(len(value))))
    first = int(state.window.days[places[0]])
    change = Change(
        ODD_NIGHTS,
        1.0,
        {ODD_NIGHTS: 1.0},
        (),
        size.value > 0.0,
        NOW_AND_THEN,
        first,
        first,
        first,
        state.day,
        size,
        continues=again,
    )
    in_force = ChangeInForce(change, state.baseline.leakage_flows, 1.0, UNCHANGED)
    return replace(state, in_force=in_force, often=NOTHING)


def with_misfit(state: WatchState, day: int, misfit: float) -> WatchState:
    """Return the state with how much of a night's flow its conditions leave unexplained.

    Two nights in a row beyond the limit begin that the channels lie apart, and two within end it.
    """
    limit = max(choices.LEAST_MISFIT, choices.MISFIT_RATIO * state.usual_misfit)
    misfits = (*state.misfits, misfit)[-choices.MISFIT_NIGHTS :]
    beyond = [last > limit for last in misfits]
    apart = state.apart
    if not any(beyond):
        apart = ()
    elif not apart and len(beyond) == choices.MISFIT_NIGHTS and all(beyond):
        apart = (state.day if len(state.window) else day, day)
    return replace(state, misfits=misfits, apart=apart)


def without_apart(state: WatchState, since: int, n_last: int) -> WatchState:
    """Return the state without the nights from a day on whose channels lay apart, but so many."""
    window = state.window
    stays = (window.days < since) | (np.arange(len(window)) >= len(window) - n_last)
    window = window.only(stays)
    dropped = int(np.count_nonzero(~stays))
    sums = Sums.of(window, state.wander, state.causes.basis)
    return replace(state, window=window, sums=sums, n_nights=state.n_nights - dropped)


def channels_apart(state: WatchState) -> Change:
    """Return as a change that the flow follows the other channels no more."""
    since, detected_on = state.apart
    size = on_first_baseline(state, slice(-1, None))
    dates, sole = (since, since, since), {CHANNELS: 1.0}
    return Change(CHANNELS, 1.0, sole, (), size.value > 0.0, STEPS, *dates, detected_on, size)
