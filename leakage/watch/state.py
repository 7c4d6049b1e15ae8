"""State of a motor's watch after a night, and its figures: levels, leakages, smallest change.

Along a direction d, λ = d'(u − Aẑ) / d'Ad of a night, ẑ what all nights say of the unknowns, but
for what moves the flow at the motor's own conditions, which is d's: a baseline of few nights knows
the unknowns badly, and a season would be taken for a change.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from leakage.arrays import Array
from leakage.watch import choices
from leakage.watch.attribution import Attribution
from leakage.watch.baseline import Baseline
from leakage.watch.causes import (
    BACK,
    NOT_IDENTIFIED,
    ODD_NIGHTS,
    TEMPERATURE_EFFECT,
    UNSIZED,
    Cause,
    causes_of,
)
from leakage.watch.circuit import CircuitChange
from leakage.watch.evidence import Causes, Evidence, Parts, Sums, Window
from leakage.watch.nights import (
    FLUSHING,
    KNOWN,
    RAMPS,
    Change,
    Estimate,
    Machine,
    WatchSettings,
    grown_as,
)
from leakage.watch.wander import Wander


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What nights say of the unknowns beside the level at the motor's own conditions.

    Mean, shape (q,), and covariance, shape (q, q).
    """

    mean: Array
    covariance: Array


def surroundings(
    window: Window, sums: Sums, own_row: Array, direction: Array, end: int
) -> Surroundings:
    """Return what nights before a place say, beside a straight line in time along a direction.

    What rises evenly is wear, or none: it is not taken for an effect of a season.
    """
    q, along = len(direction), sums.basis.T @ direction
    before, score = (part[0] for part in sums.before(np.array([end]), window))
    day = float(window.days[max(end - 1, 0)] - window.days[0])
    so_far, tens = Parts.of_rows(sums.rows[end][1], sums.basis), choices.RAMP_DAYS
    level, rise = so_far.information @ direction, so_far.linear @ along
    linear = (rise - day * level) / tens
    square = along @ so_far.square @ along - day * direction @ (2.0 * rise - day * level)
    whole = np.block([[before, linear[:, None]], [linear[None], np.array([[square / tens**2]])]])
    whole[q, q] += choices.RAMP_SIZE**-2
    line = float(so_far.linear_score @ along - day * so_far.score @ direction) / tens
    covariance = np.linalg.inv(whole)
    mean = (covariance @ np.append(score, line))[:q]
    levelled = np.eye(q) - np.outer(direction, own_row) / float(own_row @ direction)
    return Surroundings(levelled @ mean, levelled @ covariance[:q, :q] @ levelled.T)


EVERY = slice(None)


@dataclass(frozen=True, slots=True)
class Level:
    """λ of some nights, and what their errors are made from.

    Of shape (n,): `value`; the variances `noise` of the errors within each night, with those of the
    model in it, and `shift` of its own shift of the paths; `beyond`, how far its operating
    conditions are from usual ones. `gain` is what an error of each unknown does to it, of the paths
    first, shape (n, q).
    """

    value: Array
    noise: Array
    shift: Array
    gain: Array
    beyond: Array
    around: Surroundings
    wander: Wander
    operating_error: Array

    def mean(self, nights: slice = EVERY) -> Estimate:
        """Return the mean of nights: they share serial correlation and the errors of the model."""
        return self._weighed(*self._weights(nights))

    def difference(self, after: slice, before: slice) -> Estimate:
        """Return the mean of some nights less that of others: errors common to both cancel."""
        (later, noise), (earlier, noise_before) = self._weights(after), self._weights(before)
        return self._weighed(later - earlier, noise + noise_before)

    def _weights(self, nights: slice) -> tuple[Array, float]:
        """Return the weight of each night in the mean of some, (n,), and its own variance.

        Nights weigh by 1 / (noise + shift + error of their operating conditions²): a night of
        another duty says less (model.md, 7c.2).
        """
        noise, shift = self.noise[nights], self.shift[nights]
        of_paths = self.gain[nights, : len(self.operating_error)]
        by_operation = of_paths * self.beyond[nights][:, None] * self.operating_error
        own = 1.0 / (noise + shift + np.sum(by_operation**2, axis=1))
        own = own / own.sum()
        length = float(self.wander.inflation(np.array([len(own)], dtype=float))[0])
        weights = np.zeros(len(self.value))
        weights[nights] = own
        return weights, float(own**2 @ (noise + length * shift))

    def _weighed(self, weights: Array, variance: float) -> Estimate:
        of_others, p = weights @ self.gain, len(self.operating_error)
        by_operation = (weights * self.beyond) @ self.gain[:, :p] * self.operating_error
        variance += float(of_others @ self.around.covariance @ of_others)
        variance += float(np.sum(by_operation**2))
        return Estimate(float(weights @ self.value), math.sqrt(variance))


def all_causes(machine: Machine, baseline: Baseline, undone: Cause | None) -> Causes:
    """Return causes of a motor, and that of undoing what was adopted, if anything was."""
    return Causes.of([*causes_of(machine, baseline), *([undone] if undone else [])])


NOTHING = -math.inf
UNCHANGED = Estimate(0.0, 0.0)


@dataclass(frozen=True, slots=True)
class ChangeInForce:
    """The change in force: as it is detected, and the direction that its size is taken along.

    `along` has shape (q,) and `of_leakage` is what a unit of it is of the leakage; `before` is the
    change of the leakage before it, against the first baseline. While it is not adopted,
    `attribution` is that by the nights so far and `prior` what was in force before. `circuit` is
    the change beside those of the circuit's other motors, as it settled; None without two of them.
    `settled` is the change of the leakage as it was adopted.
    """

    change: Change
    along: Array
    of_leakage: float
    before: Estimate
    attribution: Attribution | None = None
    prior: ChangeInForce | None = None
    circuit: CircuitChange | None = None
    settled: Estimate | None = None

    @property
    def is_beside(self) -> bool:
        """What is detected is a notice beside a change that stands as it was."""
        prior, change = self.prior, self.change
        return prior is not None and prior.change.dates == change.dates and not change.continues


@dataclass(frozen=True, slots=True)
class Crossing:
    """An event behind which the motor is the same, until its step is known (7c.6).

    The spread of the step that it may make, and the change just before.
    """

    spread: float
    before: Estimate


@dataclass(frozen=True)  # without slots: what a night's figures share is worked out once
class WatchState:
    """What is kept of a motor."""

    machine: Machine
    settings: WatchSettings
    # baseline, window, sums, wander: What the first nights fix, the nights, their sums, and what
    # they do by themselves.
    baseline: Baseline
    window: Window
    sums: Sums
    wander: Wander
    causes: Causes  # Causes of a change, with those that undo what was adopted.
    usual_misfit: float  # The most of the first baseline's nights; those since may be no measure.
    # first_step, first_ramp: Day of the first candidate start of each shape.
    first_step: int
    first_ramp: int
    # n_baseline, n_nights: Nights of the baseline, and all of the baseline period.
    n_baseline: int
    n_nights: int
    due: int  # Number of nights with which the wander is estimated anew; 0: never.
    often: float = NOTHING  # Evidence that odd nights have become frequent.
    evidence: float = NOTHING  # ln R of the newest night.
    # period_from: Day from which a baseline period of its own is to begin; None: none is.
    period_from: int | None = None
    # Change of the flow at the baseline period's beginning against the first baseline, less what
    # events have moved since.
    carried: Estimate = UNCHANGED
    in_force: ChangeInForce | None = None  # The change in force; None: none is detected.
    crossing: Crossing | None = None  # The event with which the window begins, if any.
    undone: Cause | None = None  # The cause that undoes what was adopted, if anything was.
    misfits: tuple[float, ...] = ()  # Of the last nights.
    # Since when the flow follows the other channels no more, and the day on which that was clear.
    apart: tuple[int, ...] = ()

    @property
    def day(self) -> int:
        """The newest night."""
        return int(self.window.days[-1])

    @property
    def is_settling(self) -> bool:
        """A change has been detected, and is not adopted yet."""
        return self.in_force is not None and self.in_force.attribution is not None

    def place(self, day: int) -> int:
        """Return place of the first night from a day on."""
        return int(np.searchsorted(self.window.days, day))

    @property
    def along(self) -> Array:
        """What the level is taken along, shape (q,)."""
        return self.baseline.leakage_flows if self.in_force is None else self.in_force.along

    @property
    def of_leakage(self) -> float:
        """What a unit of it is of the leakage."""
        return 1.0 if self.in_force is None else self.in_force.of_leakage

    @cached_property
    def level(self) -> Level:
        """λ of all nights along that direction."""
        return self.level_along(self.along)

    def level_along(self, direction: Array, end: int | None = None) -> Level:
        """Return λ of all nights along a direction of shape (q,).

        Beside the surroundings before a place: where none is given, that of a change in force.
        """
        window, baseline, wander = self.window, self.baseline, self.wander
        if end is None:
            settling = self.in_force.attribution if self.in_force is not None else None
            end = len(window) if settling is None else self.place(settling.start)
        around = surroundings(window, self.sums, baseline.own_row, direction, end)
        along = window.information @ direction
        weight = np.maximum(along @ direction, 1e-12)
        gain = along / weight[:, None]
        of_paths = gain[:, : baseline.n_paths]
        return Level(
            window.score @ direction / weight - gain @ around.mean,
            1.0 / weight + (choices.LEVEL_BY_LACK * baseline.lack_of_fit) ** 2,
            np.einsum("ni,ij,nj->n", of_paths, wander.spread, of_paths),
            gain,
            np.clip(window.distance - choices.OPERATING_FREE, 0.0, choices.OPERATING_MOST),
            around,
            wander,
            baseline.operating_error,
        )

    @cached_property
    def smallest(self) -> float | None:
        """The smallest change of all flows, begun ten nights ago, that would be detected now.

        Where fewer nights may hold a change, of a change begun in the first of them; None where
        none may.
        """
        evidence = self.evidence_now()
        start = max(evidence.first_step, len(self.window) - choices.PRESENT_NIGHTS)
        if start == len(self.window):
            return None
        second = evidence.second_of(self.baseline.leakage_flows, start)
        spread, n_since = choices.STEP_SIZE, np.array([len(self.window) - start], dtype=float)
        freedom = float(self.wander.degrees_of_freedom(self.n_nights, n_since)[0])
        sd = 1.0 / math.sqrt(second + spread**-2)
        fixed = math.log(2.0 * sd / spread) - math.log(2.0 * len(evidence.causes))
        gain = freedom * math.expm1(2.0 * (self.settings.limit - fixed) / (freedom + 1.0))
        return math.sqrt(gain) * sd

    @cached_property
    def event_step(self) -> Estimate:
        """What the event behind which the nights lie has moved (model.md, 7c.6).

        Of the step s between the levels before and after, the likely share: δ = s σ² / (σ² + τ²).
        The nights of a change that settles are none of those after.
        """
        crossing = self.crossing
        if crossing is None or not len(self.window):
            return UNCHANGED
        settling = self.in_force.attribution if self.in_force is not None else None
        after = EVERY if settling is None else slice(max(1, self.place(settling.start)))
        level = self.level_along(self.baseline.leakage_flows).mean(after)
        grown = (1.0 + self.carried.value) * (1.0 + level.value)
        step = grown / (1.0 + crossing.before.value) - 1.0
        own = choices.OWN_STEP**2 + level.sd**2 + crossing.before.sd**2
        share = crossing.spread**2 / (crossing.spread**2 + own)
        return Estimate(share * step, crossing.spread * math.sqrt(1.0 - share))

    def growth_of(self, cause: str, flow: Estimate) -> Estimate | None:
        """Return relative change of a named path's own flow, from that of all.

        None where its share of all is too small. The share is as uncertain as the path's
        coefficient in the baseline.
        """
        if cause not in self.machine.paths or cause in (FLUSHING, KNOWN):
            return None
        place = self.machine.paths.index(cause)
        own = float(self.baseline.all_paths[place])
        share = own * float(self.baseline.share[place]) / self.baseline.leakage_share
        if share < choices.LEAST_SHARE_TO_SHOW:
            return None
        growth, sd = flow.value / share, float(self.baseline.path_sd[place]) / own
        return Estimate(growth, math.hypot(flow.sd / share, growth * sd))

    def evidence_now(self) -> Evidence:
        """Return all that the evidence of the newest night is made from."""
        return Evidence(
            self.window,
            self.sums,
            self.wander,
            self.causes,
            self.baseline.operating_error,
            self.n_nights,
            self.place(self.first_step),
        )


def _n_present(state: WatchState) -> int:
    """Return nights behind the present change: those since it, ten at most."""
    if state.in_force is None:
        return choices.PRESENT_NIGHTS
    change = state.in_force.change
    is_ramp = change.shape == RAMPS or change.continues
    most = choices.PRESENT_OF_RAMP if is_ramp else choices.PRESENT_NIGHTS
    return max(1, min(most, len(state.window) - state.place(change.since)))


def on_first_baseline(state: WatchState, nights: slice) -> Estimate:
    """Return the change of the leakage over some nights, against the first baseline (7c.3)."""
    change, step = _as_measured(state, nights), state.event_step
    ratio = (1.0 + change.value) / (1.0 + step.value)
    return Estimate(ratio - 1.0, math.hypot(change.sd, ratio * step.sd) / (1.0 + step.value))


def _as_measured(state: WatchState, nights: slice) -> Estimate:
    """Return the same, with what an event has moved."""
    level = state.level.mean(nights).scaled(state.of_leakage)
    grown = 1.0 + state.carried.value
    # The flushing that is not known scales a change of the leakage.
    own_sd = math.hypot(level.sd, level.value * state.baseline.leakage_share_error)
    sd = math.hypot(grown * own_sd, (1.0 + level.value) * state.carried.sd)
    return Estimate(grown * (1.0 + level.value) - 1.0, sd)


def with_model_error(state: WatchState, change: Estimate) -> Estimate:
    """Return a change with what the model misses, which is common to all nights since the baseline.

    A change is as uncertain, too, as the model's own shape. Between two levels it cancels.
    """
    by_model = state.baseline.model_error * math.hypot(choices.LEVEL_BY_MODEL, change.value)
    return Estimate(change.value, math.hypot(change.sd, by_model))


def present(state: WatchState) -> Estimate:
    """Return change of the flow against the first baseline, of the last nights."""
    return on_first_baseline(state, slice(-_n_present(state), None))


def settle_event(state: WatchState) -> WatchState:
    """Return the state in which the step of an event is as its nights have shown it."""
    step = state.event_step
    ratio = (1.0 + state.carried.value) / (1.0 + step.value)
    sd = math.hypot(state.carried.sd, ratio * step.sd) / (1.0 + step.value)
    return replace(state, carried=Estimate(ratio - 1.0, sd), crossing=None)


def nights_beyond(state: WatchState) -> int:
    """Return how many newest nights are wholly beyond the detection limit, on the same side (7c.8).

    Two at most; none while a change is in force.
    """
    limit = state.smallest
    if limit is None or state.in_force is not None:
        return 0
    last = len(state.window)
    sides = []
    for place in range(last - 1, max(last - 3, -1), -1):
        night = with_model_error(state, on_first_baseline(state, slice(place, place + 1)))
        sides.append(1 if night.lower > limit else -1 if night.upper < -limit else 0)
    if not sides[0]:
        return 0
    return 2 if sides[0] == sides[-1] and len(sides) == 2 else 1


def mean_change(state: WatchState) -> Estimate:
    """Return the change that a state rests on: the present, or where that may be 0 a change.

    Of a first change that settles, its nights against those just before: what the model misses at
    their operating conditions is common to both. Of an adopted change, as it settled, until the
    present change is known well enough to contradict it.
    """
    now, in_force = with_model_error(state, present(state)), state.in_force
    if in_force is None or in_force.prior is not None or not now.holds_zero:
        return now
    change = in_force.settled
    if in_force.attribution is not None and in_force.change.cause != TEMPERATURE_EFFECT:
        change = since_before(state, in_force.attribution.start)
        if now.value * change.value <= 0.0 or state.evidence < state.settings.limit:
            return now
    if change is None or change.holds_zero or not now.lower <= change.value <= now.upper:
        return now
    return change


def since_before(state: WatchState, start: int) -> Estimate:
    """Return the change of the leakage from a day on, against ten nights before at most."""
    place, most = state.place(start), choices.PRESENT_NIGHTS
    after, before = slice(max(place, len(state.window) - most), None), max(0, place - most)
    change = state.level.difference(after, slice(before, place)).scaled(state.of_leakage)
    return Estimate(
        change.value, math.hypot(change.sd, change.value * state.baseline.leakage_share_error)
    )


def is_contradicted(state: WatchState) -> bool:
    """Return whether the change in force is none by its own interval (model.md, 7c.2).

    A first change that settles is none, either, where its nights say the opposite.
    """
    in_force = state.in_force
    if in_force is None or in_force.change.cause in UNSIZED:
        return False
    mean = mean_change(state)
    is_first = in_force.attribution is not None and in_force.prior is None
    is_opposite = (mean.value > 0.0) != in_force.change.is_rise
    return mean.holds_zero or (is_first and is_opposite)


def probability_back(state: WatchState) -> float:
    """Return how probably a change has undone that before it; 0 where it has not.

    What is left could not be detected, and is little beside what was: without this rule the rest
    of a repair is a warning on some nights and none on others.
    """
    in_force = state.in_force
    if in_force is None or in_force.change.cause == ODD_NIGHTS:
        return 0.0
    now, before = present(state), in_force.before.value
    if before * (now.value - before) >= 0.0 or abs(now.value) >= abs(before):
        return 0.0
    little = 2.0 * choices.BACK_SPREAD * abs(before)
    limit = min(state.smallest or 0.0, little)
    return now.probability_above(-limit) - now.probability_above(limit)


def reported_change(state: WatchState) -> Change | None:
    """Return the change that is reported, None where there is none or its interval holds 0."""
    change = change_in_force(state)
    probability = probability_back(state)
    if change is not None and probability > choices.MOSTLY:
        candidates = {BACK: probability}
        return replace(change, cause=BACK, probability=probability, candidates=candidates, alike=())
    if change is not None and change.cause == BACK and not mean_change(state).holds_zero:
        # What is undone is another effect: the leakage is not back.
        return replace(change, cause=NOT_IDENTIFIED, probability=0.0, candidates={}, alike=())
    return None if is_contradicted(state) else change


def change_in_force(state: WatchState) -> Change | None:
    """Return the change in force; of all but a first that settles, sized now against before."""
    in_force = state.in_force
    if in_force is None or in_force.change.cause == ODD_NIGHTS:
        return None if in_force is None else in_force.change
    change = in_force.change
    if in_force.prior is not None and in_force.is_beside:
        change = in_force.prior.change
    # The size of a single cause is none of several.
    if in_force.attribution is not None and in_force.prior is None and not change.is_several:
        return change
    now, before = present(state), in_force.before
    ratio = (1.0 + now.value) / (1.0 + before.value)
    sd = math.hypot(now.sd, ratio * before.sd) / (1.0 + before.value)
    size = Estimate(ratio - 1.0, sd)
    growth = grown_as(change, size)
    return replace(change, size=size, is_rise=size.value > 0.0, path_growth=growth)
