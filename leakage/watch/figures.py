"""Figures of the newest nights: levels, leakages, and what would have been told."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from leakage.watch import choices
from leakage.watch.causes import ALL_FLOWS, ODD_NIGHTS
from leakage.watch.evidence import STEP
from leakage.watch.nights import Array, Estimate
from leakage.watch.state import State
from leakage.watch.verdict import RAMPS, Change, grown_as


def direction(state: State) -> tuple[Array, float]:
    """What the level is taken along, and what a unit of it is of the flow."""
    if state.standing is None:
        return state.baseline.all_flows, 1.0
    return state.standing.along, state.standing.of_flow


def _n_present(state: State) -> int:
    """Nights behind the present change: those since it, ten at most."""
    if state.standing is None:
        return choices.PRESENT_NIGHTS
    change = state.standing.change
    most = choices.PRESENT_OF_RAMP if change.shape == RAMPS else choices.PRESENT_NIGHTS
    return max(1, min(most, len(state.window) - state.place(change.since)))


def on_first_baseline(state: State, nights: slice) -> Estimate:
    """Change of the flow over some nights, against the first baseline."""
    along, of_flow = direction(state)
    level = state.level_along(along).mean(nights).scaled(of_flow)
    grown = 1.0 + state.carried.value
    sd = math.hypot(grown * level.sd, (1.0 + level.value) * state.carried.sd)
    return Estimate(grown * (1.0 + level.value) - 1.0, sd)


def present(state: State) -> Estimate:
    """Change of the flow against the first baseline, of the last nights."""
    return on_first_baseline(state, slice(-_n_present(state), None))


def change_in_force(state: State) -> Change | None:
    """The change in force; adopted, or going on, its size is that of now against before it."""
    standing = state.standing
    if standing is None or standing.change.cause == ODD_NIGHTS:
        return None if standing is None else standing.change
    change = standing.change
    if standing.found is not None and not change.goes_on:
        return change
    now, before = present(state), standing.before
    ratio = (1.0 + now.value) / (1.0 + before.value)
    sd = math.hypot(now.sd, ratio * before.sd) / (1.0 + before.value)
    size = Estimate(ratio - 1.0, sd)
    growth = grown_as(change, size)
    return replace(change, size=size, is_rise=size.value > 0.0, path_growth=growth)


def smallest_change(state: State) -> float:
    """Smallest change of all flows, begun ten nights ago, that would be told tonight."""
    evidence = state.evidence_now()
    start = max(0, len(state.window) - choices.PRESENT_NIGHTS)
    told = evidence.of_starts(np.array([start]))
    names = [one.name for one in evidence.causes.every]
    second = float(told.second[STEP, 0, names.index(ALL_FLOWS)])
    spread, freedom = choices.STEP_SIZE, state.wander.degrees_of_freedom(state.n_nights)
    sd = 1.0 / math.sqrt(second + spread**-2)
    fixed = math.log(2.0 * sd / spread) - math.log(2.0 * len(names))
    gain = freedom * math.expm1(2.0 * (state.settings.limit - fixed) / (freedom + 1.0))
    return math.sqrt(gain) * sd


def change_since(state: State, day: int) -> Estimate | None:
    """Change of all flows from a day on against before; None without nights on both sides.

    An adopted change is in no window any more: where it may have begun since, it is the change.
    """
    standing = state.standing
    if standing is not None and standing.found is None and standing.change.cause != ODD_NIGHTS:
        told = change_in_force(state)
        if told is not None and told.since_upper >= day:
            return told.size
    place = int(np.searchsorted(state.window.days, day))
    if not 0 < place < len(state.window):
        return None
    level = state.level_along(state.baseline.all_flows)
    after, before = level.mean(slice(place, None)), level.mean(slice(None, place))
    return Estimate(after.value - before.value, math.hypot(after.sd, before.sd))


def leakage_at(state: State, drives: Array, conditions: Array) -> Estimate:
    """Flow at some conditions, by the level of the newest night, [l/min].

    `drives` are the flows a unit of each path's coefficient there, shape (p,), 0 for what is left
    out; `conditions` are temperature [°C], pressure [bar] and speed [rpm], shape (3,).
    """
    row, flow = _row_at(state, drives, conditions)
    along, _ = direction(state)
    levels = state.level_along(along)
    level, of_cause = levels.mean(slice(-1, None)), float(row @ along)
    as_first = 1.0 + float(row @ (state.baseline.unknowns + levels.around.mean))
    before, _ = state.sums.before(np.array([len(state.window)]), state.window)
    uncertain = float(row @ np.linalg.solve(before[0], row))
    variance = (of_cause * level.sd) ** 2 + uncertain
    return Estimate(flow * (as_first + level.value * of_cause), flow * math.sqrt(variance))


def frozen_leakage_at(state: State, drives: Array, conditions: Array) -> float:
    """Flow at some conditions by the baseline alone, [l/min]; arguments as of `leakage_at`."""
    row, flow = _row_at(state, drives, conditions)
    return flow * (1.0 + float(row @ state.baseline.unknowns))


def _row_at(state: State, drives: Array, conditions: Array) -> tuple[Array, float]:
    """What a unit of each unknown is of the flow at some conditions, and that flow by theta."""
    columns = state.baseline.columns
    expected = columns.expected(drives[None])
    row: Array = columns.design(drives[None], conditions[None], np.maximum(expected, 1e-12))[0]
    if columns.has_zero:
        row[-1] = 0.0
    return row, float(expected[0])
