"""A change detected by a night's evidence, what it leaves, and events that are no border."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from leakage.arrays import Array
from leakage.watch import choices
from leakage.watch.attribution import (
    Attribution,
    Name,
    attribute,
    name_of,
    share_of_flow,
    share_of_leakage,
)
from leakage.watch.baseline import N_TEMPERATURE
from leakage.watch.causes import (
    BACK,
    NOT_IDENTIFIED,
    ODD_NIGHTS,
    TANK,
    TEMPERATURE_EFFECT,
    UNSIZED,
    Cause,
    back_as_before,
)
from leakage.watch.circuit import CircuitChange
from leakage.watch.evidence import STEP, Causes, Evidence, Places, Sums, starts_of
from leakage.watch.nights import (
    RAMPS,
    SEVERAL,
    Change,
    Estimate,
    Machine,
    grown_as,
)
from leakage.watch.odd_nights import odd_nights_are_single, of_odd_night, with_odd_nights
from leakage.watch.state import (
    NOTHING,
    UNCHANGED,
    ChangeInForce,
    Crossing,
    WatchState,
    all_causes,
    change_in_force,
    is_contradicted,
    mean_change,
    nights_beyond,
    on_first_baseline,
    present,
    probability_back,
    settle_event,
    since_before,
    with_model_error,
)


def detect_change(state: WatchState) -> WatchState:
    """Return the state with the newest night's evidence, and a change where it is enough."""
    if state.first_step > state.day:
        return replace(state, evidence=NOTHING)
    evidence = state.evidence_now()
    weighed = with_evidence(state, evidence, state.place(state.first_ramp))
    frequent = weighed.often - math.log(2 * len(evidence.causes))
    if frequent >= max(state.settings.limit, weighed.evidence) and odd_nights_are_single(weighed):
        return with_odd_nights(weighed)
    is_detected = weighed.evidence >= state.settings.limit or nights_beyond(weighed) > 1
    return _detect(weighed) if is_detected else weighed


def with_evidence(state: WatchState, evidence: Evidence, first: int) -> WatchState:
    """Return the state with what its nights say of starts from a place on."""
    starts, weights = starts_of(first, len(state.window) - 1)
    log_ratio = evidence.of_starts(starts).log_ratio
    newest_night = float(np.logaddexp.reduce(log_ratio[STEP, -1]))
    odd = float(np.logaddexp(math.log(1 - choices.ODD), math.log(choices.ODD) + newest_night))
    often = np.logaddexp(0.0, state.often) - odd
    often += np.logaddexp(math.log(1 - choices.OFTEN), math.log(choices.OFTEN) + newest_night)
    window = replace(state.window, odd=np.append(state.window.odd[:-1], odd))
    by_start = np.logaddexp.reduce(log_ratio, axis=(0, 2))
    certain = by_start - of_odd_night(evidence, window, starts, by_start)
    total = float(np.logaddexp.reduce(certain + weights))
    return replace(state, window=window, evidence=total, often=float(often))


def _detect(state: WatchState) -> WatchState:
    """Return a change detected in the newest night, unless the flow has hardly changed."""
    evidence = state.evidence_now()
    attribution = attribute(evidence, state.baseline, _starts_until(state, state.day))
    if abs(attribution.leakage.value) < choices.LEAST_CHANGE:
        return state
    detected = replace(
        state, in_force=in_force_of(state, evidence, attribution, detected_on=state.day)
    )
    return state if state.in_force is None and is_contradicted(detected) else detected


def settling_change(state: WatchState) -> WatchState:
    """Return a change that settles as the nights up to now show it (model.md, 7c.1).

    What reverses it is a change of its own at once. It is withdrawn where the interval of what it
    rests on holds 0, the evidence has fallen below the limit and nothing stood before.
    """
    if (reversal := _reversal(state)) is not None:
        return reversal
    state = with_evidence(state, state.evidence_now(), state.place(state.first_ramp))
    assert state.in_force is not None
    now = settle(state)
    assert now.in_force is not None
    # What seems to fall where it rose is about to be reversed: it settles as it was.
    if now.in_force.change.is_rise == state.in_force.change.is_rise:
        state = now
    assert state.in_force is not None
    is_withdrawn = state.in_force.prior is None and state.evidence < state.settings.limit
    return replace(state, in_force=None) if is_withdrawn and is_contradicted(state) else state


def _reversal(state: WatchState) -> WatchState | None:
    """Return the change that settles, adopted as it was, with a reversal; None if none settles.

    A first change that is undone needs none: it is withdrawn, or at rest once it has settled. The
    level since then shows what is a reversal, too.
    """
    behind = detect_change(_take_for_granted(state))
    before, now = state.in_force, behind.in_force
    assert before is not None
    assert now is not None
    if now.attribution is None or now.change.is_rise == before.change.is_rise:
        return None
    level = since_before(behind, now.attribution.start)
    if level.holds_zero or (level.value > 0.0) != now.change.is_rise:
        return None
    return None if before.prior is None and present(behind).holds_zero else behind


def settle(state: WatchState) -> WatchState:
    """Return the state with the change that was detected as the nights up to now show it."""
    assert state.in_force is not None
    assert state.in_force.attribution is not None
    evidence = state.evidence_now()
    detected_on = state.in_force.change.detected_on
    attribution = attribute(evidence, state.baseline, _starts_until(state, detected_on))
    # It came between the dates of all nights: what comes in few nights is neither step nor ramp,
    # and what grows ever faster seems to begin later and later.
    lower, since, upper = attribution.since
    before = state.in_force.attribution.since
    dates = min(lower, before[0]), min(since, before[1]), max(upper, before[2])
    attribution = replace(attribution, since=dates)
    circuit = state.in_force.circuit
    return replace(state, in_force=in_force_of(state, evidence, attribution, detected_on, circuit))


def _starts_until(state: WatchState, detected_on: int) -> Places:
    """Return starts that a change may have which is detected on a day."""
    return np.arange(state.place(state.first_ramp), state.place(detected_on) + 1)


def in_force_of(
    state: WatchState,
    evidence: Evidence,
    attribution: Attribution,
    detected_on: int,
    circuit: CircuitChange | None = None,
) -> ChangeInForce:
    """Return the change that is detected from a day on, with its name."""
    name, leakage = _name(state, evidence, attribution)
    prior = _before(state, detected_on)
    stands = prior is not None and prior.change.cause not in UNSIZED
    if prior is not None and stands and name.cause == TEMPERATURE_EFFECT:
        # It is no end of what stands.
        change = replace(prior.change, detected_on=detected_on)
        return replace(prior, change=change, attribution=attribution, prior=prior)
    is_rise = leakage.value > 0.0
    if circuit is not None and circuit.is_common:
        name = replace(name, cause=TANK, probability=circuit.probability, alike=())
    continues = prior is not None and _is_the_same(prior.change, name, is_rise=is_rise)
    cause, probability, alike = name.cause, name.probability, name.alike
    # What goes on began where it was detected first, and keeps its name.
    lower, since, upper = attribution.since
    if prior is not None and continues:
        since, lower, upper = prior.change.dates
        if cause == NOT_IDENTIFIED:
            cause, probability = prior.change.cause, prior.change.probability
            alike = alike or prior.change.alike
    growth = state.growth_of(cause, leakage)
    if prior is not None and continues and prior.change.cause == cause:
        growth = grown_as(prior.change, leakage)
    change = Change(
        cause,
        probability,
        name.candidates,
        alike,
        is_rise,
        attribution.shape,
        since,
        lower,
        upper,
        detected_on,
        leakage,
        growth,
        name.likeliest.grade,
        continues,
    )
    if prior is not None and continues:
        return replace(prior, change=change, attribution=attribution, prior=prior, circuit=circuit)
    along, of_leakage, before = state.baseline.leakage_flows, 1.0, UNCHANGED
    if prior is not None:
        start = state.place(attribution.start)
        before = on_first_baseline(state, slice(max(0, start - choices.PRESENT_NIGHTS), start))
    elif name.cause == name.likeliest.name and name.cause not in (BACK, TEMPERATURE_EFFECT):
        along = name.likeliest.direction
        of_leakage = share_of_leakage(name.likeliest, state.baseline)
    return ChangeInForce(change, along, of_leakage, before, attribution, prior, circuit)


def _name(state: WatchState, evidence: Evidence, attribution: Attribution) -> tuple[Name, Estimate]:
    """Return a change's name and size; its cause is open until the evidence reaches the limit."""
    name = name_of(evidence, state.machine, state.baseline, attribution.start, attribution.drain)
    before, limit = state.in_force, state.settings.limit
    is_open = before is None or before.attribution is None or not before.change.candidates
    if is_open and state.evidence < limit:
        name = name.opened()
    likeliest = evidence.causes.every[attribution.likeliest]
    if TEMPERATURE_EFFECT not in (name.likeliest.name, likeliest.name):
        return name, attribution.leakage
    # Its size is none of the leakage. Where that has changed at the motor's usual operating point,
    # beside the effect that all nights tell together, no effect of temperature explains it: with
    # evidence of its own, or, where the effect is the name, if the last nights' mean shows it, too.
    beside = replace(state, in_force=None)
    level, mean = since_before(beside, attribution.start), present(beside)
    mean = with_model_error(state, mean)
    is_shown = not (level.holds_zero or mean.holds_zero) and level.value * mean.value > 0.0
    is_named = name.cause == TEMPERATURE_EFFECT
    if (is_named and is_shown) or 0.5 * (level.value / level.sd) ** 2 >= limit:
        return name.opened(), level
    return name, attribution.leakage


def _is_the_same(before: Change, name: Name, *, is_rise: bool) -> bool:
    """Return whether a change goes on, by sign and cause; a ramp, by what may be its cause."""
    if before.is_rise != is_rise or ODD_NIGHTS in (before.cause, name.cause):
        return False
    if NOT_IDENTIFIED not in (before.cause, name.cause):
        return before.cause == name.cause
    if name.candidates.get(SEVERAL, 0.0) >= choices.MOSTLY:
        return False
    alike = (before.candidates.keys() & name.candidates.keys()) - {SEVERAL}
    return before.shape == RAMPS and bool(alike)


def _before(state: WatchState, detected_on: int) -> ChangeInForce | None:
    """Return what was in force before the change that is detected from a day on."""
    in_force = state.in_force
    if in_force is None or in_force.change.detected_on == detected_on:
        return None if in_force is None else in_force.prior
    return replace(in_force, prior=None)


def adopt(state: WatchState) -> WatchState:
    """Return the state behind a change that was detected ten nights ago: it is taken as known."""
    in_force = state.in_force
    if in_force is None or in_force.attribution is None:
        return state
    if len(state.window) - 1 - state.place(in_force.change.detected_on) < choices.SETTLE:
        return state
    return _take_for_granted(settle(state))


def _take_for_granted(final: WatchState) -> WatchState:
    """Return the watch behind a change, of which its attribution and what errs in it is known."""
    state, now = settle_event(final), final.in_force
    assert now is not None
    assert now.attribution is not None
    attribution = now.attribution
    causes = final.evidence_now().causes
    likeliest, size = causes.every[attribution.likeliest], attribution.size.value
    along, of_flow = likeliest.direction, share_of_flow(likeliest, state.baseline)
    several = 0.0 if now.is_beside else now.change.several
    if not now.is_beside and (now.change.is_several or not now.change.candidates):
        # What several causes have done, or an unknown one, is what the level of all flows says.
        level = change_in_force(final)
        assert level is not None
        along, of_flow = state.baseline.leakage_flows, state.baseline.leakage_share
        size = level.size.value
    flow = abs(size * of_flow)
    # Where several changed at once, each may have, a sign by half of it.
    weights = (1.0 - several) * attribution.weights + several / 2.0 * causes.is_half[STEP]
    # What rises on is of no baseline period yet: its own begins where it was detected.
    detected_on = now.change.detected_on
    period_from = (
        max(attribution.start, detected_on) if attribution.shape == RAMPS else attribution.start
    )
    behind = _free(
        state,
        state.place(attribution.start),
        _left_free(state, causes, weights, size, flow),
        back_as_before(along, size),
        detected_on,
    )
    stands = now.prior if now.prior is not None and now.is_beside else now
    return replace(
        behind,
        period_from=period_from if flow > choices.OWN_PERIOD else None,
        in_force=replace(stands, attribution=None, prior=None, settled=mean_change(final)),
    )


def _free(state: WatchState, place: int, free: Array, undone: Cause | None, day: int) -> WatchState:
    """Return the state of nights from a place on, before which all may have moved by a covariance.

    No start of a change lies before the night that follows a day.
    """
    causes = all_causes(state.machine, state.baseline, undone)
    before, score = (part[0] for part in state.sums.before(np.array([place]), state.window))
    freed = np.eye(len(score)) + before @ free
    window = state.window.from_night(
        place, np.linalg.solve(freed, before), np.linalg.solve(freed, score)
    )
    return replace(
        state,
        window=window,
        sums=Sums.of(window, state.wander, causes.basis),
        causes=causes,
        first_step=day + 1,
        first_ramp=day + 1,
        undone=undone,
        due=0,
        often=NOTHING,
    )


def across_event(state: WatchState, machine: Machine, day: int, spread: float) -> WatchState:
    """Return the state of nights from a day on, behind an event that may move the flow by a spread.

    A dated event behind which a motor is the same, as other oil, another meter or sensor, is no
    border: what is known of the motor goes on, and the step in its night is the event's as far as
    that is likely (model.md, 7c.6). No start of a change lies across it. The baseline stays:
    that of the few nights since showed +8 % later or not at all on four machines of four.
    """
    state = settle_event(state)
    in_force = state.in_force
    if in_force is not None:
        # What stood stands until nights contradict it: the event's own step is no sign of its end.
        known = in_force.settled if in_force.attribution is None else mean_change(state)
        in_force = replace(in_force, attribution=None, prior=None, settled=known)
    state = replace(state, in_force=in_force)
    now, state = present(state), replace(state, machine=machine)
    p, flows = state.baseline.n_paths, state.baseline.leakage_flows
    sd = np.full(len(flows), choices.LEFT_OF_SURFACE * spread)
    sd[:p] = choices.LEFT_OF_PATHS * spread / state.baseline.share
    sd[p : p + N_TEMPERATURE] = spread
    free = spread**2 * np.outer(flows, flows) + np.diag(sd**2)
    behind = _free(state, len(state.window), free, None, day)
    return replace(behind, evidence=NOTHING, period_from=None, crossing=Crossing(spread, now))


def _left_free(
    state: WatchState, causes: Causes, weights: Array, size: float, flow: float
) -> Array:
    """Return covariance of what an adopted change may be beside its attribution, shape (q, q)."""
    variance = choices.STEP_SIZE**2 + size**2
    directions = causes.directions
    left = (directions * (weights * variance)) @ directions.T
    p, q = state.baseline.n_paths, state.baseline.columns.n
    sd = np.full(q, choices.LEFT_OF_SURFACE * flow)
    sd[:p] = choices.LEFT + choices.LEFT_OF_PATHS * flow / state.baseline.share
    sd[p : p + N_TEMPERATURE] = choices.LEFT + choices.LEFT_OF_PATHS * flow
    if state.baseline.columns.has_zero:
        sd[-1] = choices.ZERO_PRIOR
    return left + np.diag(sd**2)


def at_rest(state: WatchState) -> WatchState:
    """Return the state without a change in force where the flow is back where it was."""
    in_force = state.in_force
    if in_force is None or in_force.attribution is not None:
        return state
    if in_force.change.cause == ODD_NIGHTS:
        odd = state.window.days[state.window.odd > 1.0]
        is_over = not len(odd) or len(state.window) - state.place(odd[-1]) > choices.ODD_ARE_OVER
    else:
        is_over = mean_change(state).holds_zero or probability_back(state) > choices.MOSTLY
    return replace(state, in_force=None) if is_over else state


def shorten(state: WatchState) -> WatchState:
    """Return the state without its oldest nights, where they are many: they are summed up."""
    if len(state.window) < choices.WINDOW + choices.WINDOW_SLACK:
        return state
    first = len(state.window) - choices.WINDOW
    before, score = (part[0] for part in state.sums.before(np.array([first]), state.window))
    window = replace(state.window.from_night(first, before, score), odd=state.window.odd[first:])
    sums = Sums.of(window, state.wander, state.causes.basis)
    return replace(state, window=window, sums=sums)
