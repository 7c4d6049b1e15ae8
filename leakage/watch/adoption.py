"""Eras and what a change leaves behind: adoption, wander anew, an era of its own, rest."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from leakage.watch import choices
from leakage.watch.attribution import Attribution, share_of_flow
from leakage.watch.baseline import Baseline, baseline_of
from leakage.watch.causes import BACK, ODD_NIGHTS, Cause, back_as_before
from leakage.watch.columns import N_TEMPERATURE
from leakage.watch.evidence import Causes
from leakage.watch.figures import on_first_baseline, present
from leakage.watch.nights import Array, Machine, NightBlocks, WatchSettings
from leakage.watch.state import NOTHING, State
from leakage.watch.telling import settled
from leakage.watch.verdict import RAMPS
from leakage.watch.wander import Wander, WanderPrior, estimate_wander
from leakage.watch.window import Sums, Window

Earlier = Callable[[int], Sequence[NightBlocks]]
# Nights without an odd one after which odd nights are over.
QUIET_NIGHTS = 30


def begin(
    machine: Machine,
    nights: Sequence[NightBlocks],
    settings: WatchSettings,
    prior: WanderPrior | None = None,
) -> State:
    """The state after the nights of a baseline."""
    baseline = baseline_of(machine, nights)
    told = [baseline.information(night) for night in nights]
    window = Window(
        np.array([night.day for night in nights]),
        np.array([information for information, _ in told]),
        np.array([score for _, score in told]),
        np.array([baseline.distance(night) for night in nights]),
        np.zeros(len(nights)),
        baseline.columns.prior(),
        np.zeros(baseline.columns.n),
    )
    wander = wander_of(baseline, window, prior or WanderPrior())
    return State(
        machine,
        settings,
        baseline,
        window,
        Sums.of(window, wander),
        wander,
        undone=(),
        first_start=nights[-1].day + 1,
        n_baseline=len(nights),
        n_nights=len(nights),
        due=math.ceil(len(nights) * choices.ANEW_FACTOR),
    )


def adopted(state: State) -> State:
    """Ten nights after it was told a change is taken for granted, and the watch goes on."""
    standing = state.standing
    if standing is None or standing.found is None:
        return state
    if len(state.window) - 1 - state.place(standing.change.told_on) < choices.SETTLE:
        return state
    told = settled(state)
    now = told.standing
    assert now is not None
    assert now.found is not None
    found = now.found
    causes = told.evidence_now().causes
    size = abs(found.size.value)
    likeliest = causes.every[found.likeliest]
    flow = size * abs(share_of_flow(likeliest, state.baseline))
    start = state.place(found.start)
    before, score = (one[0] for one in state.sums.before(np.array([start]), state.window))
    freed = np.eye(len(score)) + before @ _left_free(state, causes, found, size, flow)
    window = state.window.from_night(
        start, np.linalg.solve(freed, before), np.linalg.solve(freed, score)
    )
    # What rises on is of no era yet: its own begins where it was told.
    told_on = now.change.told_on
    era_from = max(found.start, told_on) if found.shape == RAMPS else found.start
    return replace(
        told,
        window=window,
        sums=Sums.of(window, state.wander),
        undone=(back_as_before(likeliest.direction, found.size.value),),
        first_start=told_on + 1,
        due=0,
        often=NOTHING,
        era_from=era_from if flow > choices.OWN_ERA else None,
        standing=replace(now, found=None, prior=None, tank=None),
    )


def _left_free(state: State, causes: Causes, found: Attribution, size: float, flow: float) -> Array:
    """Covariance of what an adopted change may be beside its attribution, shape (q, q)."""
    variance = choices.STEP_SIZE**2 + size**2
    directions = causes.directions
    left = (directions * (found.weights * variance)) @ directions.T
    p, q = state.baseline.n_paths, state.baseline.columns.n
    sd = np.full(q, choices.LEFT_OF_SURFACE * flow)
    sd[:p] = choices.LEFT + choices.LEFT_OF_PATHS * flow / state.baseline.share
    sd[p : p + N_TEMPERATURE] = choices.LEFT + choices.LEFT_OF_PATHS * flow
    if state.baseline.columns.has_zero:
        sd[-1] = choices.ZERO_PRIOR
    return left + np.diag(sd**2)


def with_new_wander(state: State) -> State:
    """With Q and φ of more nights, where it is time and nothing may be about to be told."""
    so_far = state.n_nights - 1
    if state.is_settling or not state.due or so_far < state.due:
        return state
    if state.evidence >= choices.ANEW_BELOW:
        return state
    taken = max(state.n_baseline, so_far - choices.ANEW_DELAY)
    dropped = state.n_nights - len(state.window)
    wander = wander_of(state.baseline, state.window, WanderPrior(), taken - dropped)
    due = math.ceil(so_far * choices.ANEW_FACTOR)
    return replace(state, wander=wander, sums=Sums.of(state.window, wander), due=due)


def new_era(state: State, earlier: Earlier) -> State:
    """The watch by a baseline of the nights since a large change: it is another machine."""
    assert state.era_from is not None
    if len(state.window) - state.place(state.era_from) < choices.ERA_NIGHTS:
        return state
    nights = earlier(state.era_from)
    if len(nights) < choices.ERA_NIGHTS:
        return state
    all_paths, p = state.baseline.all_paths, state.baseline.n_paths
    spread = float(all_paths[:p] @ state.wander.spread @ all_paths[:p])
    size = math.sqrt(spread) / float(all_paths @ all_paths)
    era = begin(state.machine, nights, state.settings, WanderPrior(size, state.wander.memory))
    columns, old = era.baseline.columns, state.baseline.columns
    back = np.zeros(columns.n)
    back[:p] = (old.theta - columns.theta) / columns.unit
    standing = state.standing
    if standing is not None:
        along = era.baseline.all_flows
        standing = replace(standing, along=along, of_flow=1.0)
    return replace(
        era,
        undone=(Cause(BACK, back, 1.0, choices.BACK_SPREAD),),
        carried=on_first_baseline(state, slice(-len(nights), None)),
        evidence=state.evidence,
        standing=standing,
    )


def at_rest(state: State) -> State:
    """Without a change in force where the flow is back where it was."""
    standing = state.standing
    if standing is None or standing.found is not None:
        return state
    if standing.change.cause == ODD_NIGHTS:
        odd = state.window.days[state.window.odd > 1.0]
        is_over = not len(odd) or len(state.window) - state.place(odd[-1]) > QUIET_NIGHTS
    else:
        is_over = present(state).holds_zero
    return replace(state, standing=None) if is_over else state


def shortened(state: State) -> State:
    window = state.window.shortened(state.sums)
    if window is state.window:
        return state
    return replace(state, window=window, sums=Sums.of(window, state.wander))


def wander_of(
    baseline: Baseline, window: Window, prior: WanderPrior, n_nights: int | None = None
) -> Wander:
    """Wander of a window's first nights; of all of them where no number is given."""
    return estimate_wander(
        window.information[:n_nights],
        window.score[:n_nights],
        window.days[:n_nights],
        baseline.all_paths[: baseline.n_paths],
        baseline.columns.prior(),
        prior,
    )
