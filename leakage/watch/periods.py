"""Baseline periods: how one begins, learns what its nights do, and gives way to another."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from leakage.watch import choices
from leakage.watch.baseline import Baseline, baseline_of
from leakage.watch.causes import back_as_before
from leakage.watch.evidence import Sums, Window
from leakage.watch.nights import Machine, NightBlocks, WatchSettings
from leakage.watch.odd_nights import odd_places
from leakage.watch.state import WatchState, all_causes, on_first_baseline
from leakage.watch.wander import Wander, WanderPrior, estimate_wander

Earlier = Callable[[int], Sequence[NightBlocks]]


def begin(
    machine: Machine,
    nights: Sequence[NightBlocks],
    settings: WatchSettings,
    prior: WanderPrior | None = None,
    *,
    has_further: bool | None = None,
) -> WatchState:
    """Return the state after the nights of a baseline, of the form that is given, if any."""
    baseline = baseline_of(machine, nights, has_further=has_further)
    information, score = map(np.array, zip(*map(baseline.information, nights), strict=True))
    window = Window(
        np.array([night.day for night in nights]),
        information,
        score,
        np.array([baseline.distance(night) for night in nights]),
        np.zeros(len(nights)),
        baseline.columns.prior(),
        np.zeros(baseline.columns.n),
    )
    wander = wander_of(baseline, window, prior or WanderPrior())
    causes = all_causes(machine, baseline, None)
    return WatchState(
        machine,
        settings,
        baseline,
        window,
        Sums.of(window, wander, causes.basis),
        wander,
        causes,
        first_step=nights[-1].day + 1,
        first_ramp=nights[0].day,
        usual_misfit=baseline.usual_misfit(nights),
        n_baseline=len(nights),
        n_nights=len(nights),
        due=math.ceil(len(nights) * choices.ANEW_FACTOR),
    )


def with_new_wander(state: WatchState) -> WatchState:
    """Return the state with Q and φ of more nights, where it is time and nothing is near."""
    so_far = state.n_nights - 1
    if state.is_settling or not state.due or so_far < state.due:
        return state
    if state.evidence >= choices.ANEW_BELOW:
        return state
    taken = max(state.n_baseline, so_far - choices.ANEW_DELAY)
    dropped = state.n_nights - len(state.window)
    # Odd nights are no wander: as such, those that follow would be none.
    usual = np.arange(len(state.window)) < taken - dropped
    usual[odd_places(state.window)] = False
    wander = wander_of(state.baseline, state.window.only(usual), WanderPrior())
    due = math.ceil(so_far * choices.ANEW_FACTOR)
    sums = Sums.of(state.window, wander, state.causes.basis)
    return replace(state, wander=wander, sums=sums, due=due)


def new_period(state: WatchState, earlier: Earlier) -> WatchState:
    """Return the watch by a baseline of the nights since a large change: it is another machine."""
    assert state.period_from is not None
    if len(state.window) - state.place(state.period_from) < choices.PERIOD_NIGHTS:
        return state
    nights = earlier(state.period_from)
    if len(nights) < choices.PERIOD_NIGHTS:
        return state
    all_paths, p = state.baseline.all_paths, state.baseline.n_paths
    spread = float(all_paths[:p] @ state.wander.spread @ all_paths[:p])
    size = math.sqrt(spread) / float(all_paths @ all_paths)
    period = begin(
        state.machine,
        nights,
        state.settings,
        WanderPrior(size, state.wander.memory),
        has_further=len(state.baseline.columns.further) > 0,
    )
    columns, old = period.baseline.columns, state.baseline.columns
    changed = np.zeros(columns.n)
    changed[:p] = (columns.theta - old.theta) / columns.unit
    undone = back_as_before(changed)
    causes = all_causes(state.machine, period.baseline, undone)
    in_force = state.in_force
    if in_force is not None:
        in_force = replace(in_force, along=period.baseline.leakage_flows, of_leakage=1.0)
    return replace(
        period,
        sums=Sums.of(period.window, period.wander, causes.basis),
        causes=causes,
        undone=undone,
        carried=on_first_baseline(state, slice(-len(nights), None)),
        evidence=state.evidence,
        in_force=in_force,
        usual_misfit=state.usual_misfit,
        misfits=state.misfits,
    )


def wander_of(baseline: Baseline, window: Window, prior: WanderPrior) -> Wander:
    """Return wander of a window's nights."""
    return estimate_wander(
        window.information,
        window.score,
        window.days,
        baseline.all_paths[: baseline.n_paths],
        baseline.columns.prior(),
        prior,
    )
