"""Evidence of every start, shape and cause of a change, as ln of a likelihood ratio.

With A₋ what is known before a start k and A₊, u₊ the information and the scores from it on:
w = u₊ − A₊(A₋ + A₊)⁻¹(u₋ + u₊), W = A₊ − A₊(A₋ + A₊)⁻¹A₊; of a cause d, T₁ = d'w and T₂ = d'Wd. Its
size has a prior, half-normal or normal, which is integrated out.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from leakage.arrays import Array, Mask
from leakage.watch import choices
from leakage.watch.causes import Cause
from leakage.watch.nights import RAMPS, STEPS
from leakage.watch.wander import Wander, effective

Places = NDArray[np.intp]
POWERS = np.arange(3)  # Of the day, by which nights are weighted for ramps.


@dataclass(frozen=True, slots=True)
class Window:
    """Nights in order, and what all before them say together."""

    days: NDArray[np.int64]  # Of the nights, shape (n,).
    # information, score: Of each night, shapes (n, q, q) and (n, q).
    information: Array
    score: Array
    distance: Array  # Of each night's operating conditions from the baseline's, shape (n,).
    # ln of how much likelier each night was as an odd one, shape (n,); 0 in the baseline.
    odd: Array
    # before, score_before: Prior, and what the nights before the window say, shapes (q, q) and
    # (q,).
    before: Array
    score_before: Array

    def __len__(self) -> int:
        return len(self.days)

    def with_night(self, day: int, information: Array, score: Array, distance: float) -> Window:
        """Return the window with one more night."""
        return replace(
            self,
            days=np.append(self.days, day),
            information=np.concatenate([self.information, information[None]]),
            score=np.concatenate([self.score, score[None]]),
            distance=np.append(self.distance, distance),
            odd=np.append(self.odd, 0.0),
        )

    def from_night(self, first: int, before: Array, score_before: Array) -> Window:
        """Return the nights from a place on, behind other figures; none was odd so far."""
        return Window(
            self.days[first:],
            self.information[first:],
            self.score[first:],
            self.distance[first:],
            np.zeros(len(self) - first),
            before,
            score_before,
        )


@dataclass(frozen=True, slots=True)
class Sums:
    """Sums over a window's nights, each with its own shift of the paths, as far as asked for.

    `nights` has what each says: information, with the score as its last column, shape
    (2, q, q + 1). First with the shifts' covariance Q as it is, then times the inflation of a long
    record: sums of correlated nights lie between. `weights` are 1, day and day², shape (n, 3);
    `distance` has shape (n + 1,). `known` are sums of the first nights by their number, shape
    (2, 3, q, q + 1): all of them of a year would be ten megabytes, and few are asked for.
    """

    nights: tuple[Array, ...]
    weights: Array
    distance: Array
    known: dict[int, Array]

    @classmethod
    def of(cls, window: Window, wander: Wander) -> Sums:
        """Return the sums over all nights of a window."""
        q = window.score.shape[1]
        nothing = np.zeros((2, len(POWERS), q, q + 1))
        start = cls((), np.zeros((0, len(POWERS))), np.zeros(1), {0: nothing})
        return start.extended(window, wander, 0)

    def extended(self, window: Window, wander: Wander, first: int) -> Sums:
        """Return the sums with the nights of a window from a place on."""
        of_nights = np.stack(
            [
                effective(window.information[first:], window.score[first:], spread)
                for spread in (wander.spread, wander.long_spread)
            ],
            axis=1,
        )
        return Sums(
            (*self.nights, *of_nights),
            window.days[:, None].astype(float) ** POWERS,
            np.append(self.distance, self.distance[-1] + window.distance[first:].cumsum()),
            self.known.copy(),
        )

    def of_first(self, numbers: Iterable[int]) -> Array:
        """Return the sums of some numbers of first nights, shape (k, 2, 3, q, q + 1)."""
        numbers = [int(number) for number in numbers]
        for number in sorted(set(numbers).difference(self.known)):
            begin = max(known for known in self.known if known < number)
            total = self.known[begin].copy()
            for place in range(begin, number):
                total += self.nights[place][:, None] * self.weights[place][:, None, None]
            self.known[number] = total
        return np.stack([self.known[number] for number in numbers])

    def before(self, starts: Places, window: Window) -> tuple[Array, Array]:
        """Return what all nights before some starts say, shapes (k, q, q) and (k, q)."""
        sums = self.of_first(starts)[:, 1, 0]
        return window.before + sums[..., :-1], window.score_before + sums[..., -1]

    def since(self, starts: Places, weights: Array, without: Places | None) -> Array:
        """Return the sums from starts to the newest night, shape (3, k, q, q + 1).

        `weights` are those of the sums with Q as it is and of those with Q of a long record, shape
        (k, 2); `without` is a night that each start leaves out.
        """
        since = self.of_first([len(self.nights)]) - self.of_first(starts)
        if without is not None:
            since -= self.of_first(without + 1) - self.of_first(without)
        mixed: Array = (weights[:, :, None, None, None] * since).sum(axis=1).swapaxes(0, 1)
        return mixed


STEP, RAMP = 0, 1
SHAPES = (STEPS, RAMPS)


@dataclass(frozen=True, slots=True)
class Causes:
    """Causes as arrays: directions, shape (q, d), means and spreads of their sizes, shape (d,).

    A rise and a fall have one axis, of `axes` of shape (q, a): its number and their signs, (d,).
    """

    every: tuple[Cause, ...]
    directions: Array
    axes: Array
    axis: Places
    sign: Array
    mean: Array
    spread: Array
    is_half: Mask

    @classmethod
    def of(cls, every: Sequence[Cause]) -> Causes:
        directions = np.array([cause.direction for cause in every]).T
        largest = np.abs(directions).argmax(axis=0)
        sign = np.sign(directions[largest, np.arange(len(every))])
        axes, axis = np.unique(directions * sign, axis=1, return_inverse=True)
        return cls(
            tuple(every),
            directions,
            axes,
            axis,
            sign,
            np.array([cause.mean for cause in every]),
            np.array([cause.spread for cause in every]),
            np.array([cause.is_half for cause in every]),
        )

    def __len__(self) -> int:
        return len(self.every)

    def prior(self, shape: int) -> tuple[Array, Array, Mask]:
        """Return mean, spread and kind of the size's prior; of a ramp, of its rise in ten days."""
        if shape == STEP:
            return self.mean, self.spread, self.is_half
        rise = choices.RAMP_SIZE / choices.STEP_SIZE
        return np.zeros(len(self)), self.spread * rise, np.ones(len(self), dtype=np.bool_)


@dataclass(frozen=True, slots=True)
class StartEvidence:
    """What starts, shapes and causes say, shape (2, k, d) each.

    `log_ratio` holds the prior of shape and cause; `size` and `sd` are of the size's posterior,
    `first` and `second` are T₁ and T₂.
    """

    log_ratio: Array
    size: Array
    sd: Array
    first: Array
    second: Array


def _along(
    axes: Array,
    error: Array,
    before: tuple[Array, Array],
    linear: Array,
    square: Array,
    score: Array,
) -> tuple[Array, Array]:
    """Return T₁ and T₂ of all axes, shape (s, k, a), from A₋ and u₋ and sums weighted by s shapes.

    Linear and square sums are those of A₊, scores those of u₊, of a step first. An error of the
    paths since each start is left free: `error` is (E⁻¹ + A₊)⁻¹ of the paths, shape (k, p, p).
    """
    p, n_shapes = error.shape[1], len(linear)
    across, of_paths = linear[0][:, :, :p], score[0][:, :p]
    total = before[0] + linear[0] - across @ (error @ linear[0][:, :p, :])
    taken = across @ (error @ of_paths[:, :, None])
    whole = before[1] + score[0] - taken[:, :, 0]
    along = linear @ axes
    lost = error @ along[:, :, :p]
    left = along - across @ lost
    *solved, level = np.split(
        np.linalg.solve(total, np.concatenate([*left, whole[:, :, None]], axis=2)),
        np.arange(1, n_shapes + 1) * axes.shape[1],
        axis=2,
    )
    first = score @ axes - (lost * of_paths[:, :, None]).sum(axis=2) - (left * level).sum(axis=2)
    second = (
        (axes * (square @ axes)).sum(axis=2)
        - (along[:, :, :p] * lost).sum(axis=2)
        - (left * np.stack(solved)).sum(axis=2)
    )
    return first, np.maximum(second, 1e-12)


@dataclass(frozen=True, slots=True)
class Evidence:
    """All that the evidence of a night is made from.

    `operating_error` is the error of each path a standard deviation of other operating conditions,
    shape (p,); `n_nights` all nights so far. Steps begin at the place `first_step` or later; before
    it, in the baseline, ramps may begin.
    """

    window: Window
    sums: Sums
    wander: Wander
    causes: Causes
    operating_error: Array
    n_nights: int
    first_step: int

    def of_starts(
        self, starts: Places, *, by_operation: bool = True, without: Places | None = None
    ) -> StartEvidence:
        """Return what some starts say, up to the newest night.

        With `by_operation` the paths may err where the operating conditions are not the baseline's;
        `without` is a night that each start leaves out.
        """
        (a0, a1, a2), (u0, u1) = self.since(starts, without)
        # On its first night a ramp has risen by a day.
        origin = (self.window.days[starts] - 1).astype(float)
        by_vector, by_matrix, tens = origin[:, None], origin[:, None, None], choices.RAMP_DAYS
        linear = (a1 - by_matrix * a0) / tens
        square = (a2 - 2.0 * by_matrix * a1 + by_matrix**2 * a0) / tens**2
        score = (u1 - by_vector * u0) / tens
        causes = self.causes
        first, second = _along(
            causes.axes,
            self._operating_error(starts, a0, is_free=by_operation),
            self.sums.before(starts, self.window),
            np.stack([a0, linear]),
            np.stack([a0, square]),
            np.stack([u0, score]),
        )
        first, second = causes.sign * first[..., causes.axis], second[..., causes.axis]
        return self._weighed(first, second, starts)

    def second_of(self, direction: Array, start: int) -> float:
        """Return T₂ of a step of a direction, shape (q,), at a start."""
        starts = np.array([start])
        (a0, *_), (u0, _) = self.since(starts)
        _, second = _along(
            direction[:, None],
            self._operating_error(starts, a0, is_free=True),
            self.sums.before(starts, self.window),
            a0[None],
            a0[None],
            u0[None],
        )
        return float(second[0, 0, 0])

    def since(self, starts: Places, without: Places | None = None) -> tuple[Array, Array]:
        """Return information, (3, k, q, q), and scores, (2, k, q), by powers of the day."""
        n_nights = (len(self.window) - starts).astype(float)
        share = self.wander.share_of_short(n_nights)
        # At other operating conditions the model's error is that of all nights alike, those within
        # nights too.
        is_other = self.operates_otherwise(starts)
        inflated = 1.0 / self.wander.inflation(n_nights)
        weights = np.where(is_other, inflated, share), np.where(is_other, 0.0, 1.0 - share)
        sums = self.sums.since(starts, np.stack(weights, axis=1), without)
        return sums[..., :-1], sums[:2, ..., -1]

    def operates_otherwise(self, starts: Places) -> Mask:
        """Return whether starts' nights have other conditions than the baseline's, (k,)."""
        return self.operating_beyond(starts) > choices.OPERATING_OTHER

    def operating_beyond(self, starts: Places) -> Array:
        """Return the mean distance of conditions since each start beyond the usual, shape (k,)."""
        n = len(self.window)
        apart = (self.sums.distance[n] - self.sums.distance[starts]) / (n - starts)
        beyond: Array = np.clip(apart - choices.OPERATING_FREE, 0.0, choices.OPERATING_MOST)
        return beyond

    def _operating_error(self, starts: Places, after: Array, *, is_free: bool) -> Array:
        """Return (E⁻¹ + A₊)⁻¹ of the paths, (k, p, p), E their error at other conditions."""
        p = len(self.operating_error)
        variance = np.zeros((len(starts), p, p))
        if is_free:
            size = self.operating_beyond(starts)[:, None] * self.operating_error
            variance[:, np.arange(p), np.arange(p)] = size**2
        inner = np.eye(p) + variance @ after[:, :p, :p]
        error: Array = np.linalg.solve(inner, variance).astype(np.float64)
        return error

    def risen(self, starts: Places) -> Array:
        """Return how far a ramp of each start is above its mean in the baseline, shape (k,)."""
        days = self.window.days
        since = (days - days[starts][:, None] + 1).clip(0)
        before = since[:, : self.first_step].sum(axis=1) / max(self.first_step, 1)
        risen: Array = (since[:, -1] - before) / choices.RAMP_DAYS
        return risen

    def _weighed(self, first: Array, second: Array, starts: Places) -> StartEvidence:
        """Return likelihood ratios of T₁ and T₂, the sizes integrated out."""
        priors = [self.causes.prior(shape) for shape in (STEP, RAMP)]
        mean = np.stack([prior[0] for prior in priors])[:, None, :]
        spread = np.stack([prior[1] for prior in priors])[:, None, :]
        is_half = np.stack([prior[2] for prior in priors])[:, None, :]
        sd = 1.0 / np.sqrt(second + spread**-2)
        size = sd**2 * (first + mean / spread**2)
        gain = (size / sd) ** 2 - (mean / spread) ** 2
        one_sided = np.where(is_half, math.log(2.0) + log_ndtr(size / sd), 0.0)
        log_ratio = 0.5 * self.tempered(gain, starts) + np.log(sd / spread) + one_sided
        log_ratio -= math.log(len(self.causes) * len(SHAPES))
        is_early = starts < self.first_step
        log_ratio[STEP, is_early] = -np.inf
        if self.n_nights == len(self.window):
            log_ratio[RAMP, is_early & (starts == 0)] += math.log(choices.STARTS_BEFORE)
        return StartEvidence(log_ratio, size, sd, first, second)

    def tempered(self, gain: Array, starts: Places) -> Array:
        """Return twice a gain of ln likelihood, (…, k, d), by Student's t: wander is estimated."""
        n_since = (len(self.window) - starts).astype(float)
        freedom = self.wander.degrees_of_freedom(self.n_nights, n_since)[:, None]
        most = float(np.max(gain))
        rest: Array = np.log((freedom + most) / (freedom + most - gain))
        return (freedom + 1.0) * rest


def starts_of(first: int, last: int) -> tuple[Places, Array]:
    """Return candidate starts from a place to the newest, and ln of how many each stands for.

    The last 40 nights one by one, older ones 2, 4, 8 … nights apart at multiples of that.
    """
    starts, weights = [], []
    place, step = last, 1
    while place >= first:
        starts.append(place)
        weights.append(step)
        age = last - place + 1
        step = 1
        if age >= choices.DENSE_STARTS:
            step = 2 ** (int(math.log2(age / choices.DENSE_STARTS)) + 1)
        after = place - step
        aligned = after - after % step
        place = aligned if aligned >= first else after
    return np.array(starts[::-1]), np.log(np.array(weights[::-1], dtype=float))
