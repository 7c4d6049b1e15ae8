"""Evidence of every start, shape and cause of a change, as ln of a likelihood ratio.

With A₋ what is known before a start k and A₊, u₊ the information and the scores from it on:
w = u₊ − A₊(A₋ + A₊)⁻¹(u₋ + u₊), W = A₊ − A₊(A₋ + A₊)⁻¹A₊; of a cause d, T₁ = d'w and T₂ = d'Wd. Its
size has a prior, half-normal or normal, which is integrated out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from leakage.arrays import Array, Mask
from leakage.watch import choices
from leakage.watch.causes import Cause
from leakage.watch.nights import RAMPS, STEPS
from leakage.watch.wander import Wander, effective

Places = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Window:
    """Nights in order, and what all before them say together."""

    days: NDArray[np.int64]  # Of the nights, shape (n,).
    # information, score: Of each night, shapes (n, q, q) and (n, q).
    information: Array
    score: Array
    distance: Array  # Of each night's operating conditions from the baseline's, shape (n,).
    # ln of how much likelier each night was as an odd night, shape (n,); 0 in the baseline.
    odd: Array
    # before, score_before: Prior, and what the nights before the window say, shapes (q, q) and
    # (q,).
    before: Array
    score_before: Array

    def __len__(self) -> int:
        return len(self.days)

    def with_night(self, day: int, information: Array, score: Array, distance: float) -> Window:
        """Return the window with a night more."""
        return replace(
            self,
            days=np.append(self.days, day),
            information=np.concatenate([self.information, information[None]]),
            score=np.concatenate([self.score, score[None]]),
            distance=np.append(self.distance, distance),
            odd=np.append(self.odd, 0.0),
        )

    def only(self, stays: Mask) -> Window:
        """Return the window with some of its nights alone."""
        of_nights = ("days", "information", "score", "distance", "odd")
        return replace(self, **{name: getattr(self, name)[stays] for name in of_nights})

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


class Parts(NamedTuple):
    """Sums over nights: information, (…, q, q), scores, (…, q), and the same weighted by the day.

    With t the day, counted from the window's first, and B a basis of the causes' directions: Σ tAB,
    (…, q, r), Σ tB'u, (…, r), and Σ t²B'AB, (…, r, r).
    """

    information: Array
    score: Array
    linear: Array
    linear_score: Array
    square: Array

    @classmethod
    def of_rows(cls, rows: Array, basis: Array) -> Parts:
        """Return the parts of rows that hold them end to end, shape (…, m)."""
        q, r = basis.shape
        shapes = (q, q), (q,), (q, r), (r,), (r, r)
        ends = np.cumsum([math.prod(shape) for shape in shapes])
        parts = np.split(rows, ends[:-1], axis=-1)
        return cls(
            *(
                part.reshape(*rows.shape[:-1], *shape)
                for part, shape in zip(parts, shapes, strict=True)
            )
        )


@dataclass(frozen=True, slots=True)
class Sums:
    """Sums over a window's first nights, each with its own shift of the paths, by their number.

    `rows` hold the `Parts` of the first 0, 1, 2 … nights, shape (2, m) each: with the shifts'
    covariance Q as it is, then times the inflation of a long record. Sums of correlated nights lie
    between. `distance` has shape (n + 1,).
    """

    rows: tuple[Array, ...]
    distance: Array
    basis: Array

    @classmethod
    def of(cls, window: Window, wander: Wander, basis: Array) -> Sums:
        """Return the sums over all nights of a window, for directions of a basis, (q, r)."""
        q, r = basis.shape
        nothing = np.zeros((2, q * (q + 1) + r * (q + 1 + r)))
        return cls((nothing,), np.zeros(1), basis).extend(window, wander, 0)

    def extend(self, window: Window, wander: Wander, first: int) -> Sums:
        """Return the sums with the nights of a window from a place on."""
        day = (window.days[first:] - window.days[:1]).astype(float)[:, None]
        rows = np.empty((len(day) + 1, *self.rows[-1].shape))
        rows[0] = self.rows[-1]
        for kind, spread in enumerate((wander.spread, wander.long_spread)):
            nights = effective(window.information[first:], window.score[first:], spread)
            along = nights[..., :-1] @ self.basis
            parts = Parts.of_rows(rows[1:, kind], self.basis)
            parts.information[:], parts.score[:] = nights[..., :-1], nights[..., -1]
            np.multiply(day[..., None], along, out=parts.linear)
            parts.linear_score[:] = day * (nights[..., None, :, -1] @ self.basis)[:, 0]
            np.multiply(day[..., None] ** 2, self.basis.T @ along, out=parts.square)
        # Night by night: five times as quick as a cumulative sum across the rows.
        for before, row in pairwise(rows):
            row += before
        return Sums(
            (*self.rows, *rows[1:]),
            np.append(self.distance, self.distance[-1] + window.distance[first:].cumsum()),
            self.basis,
        )

    def before(self, starts: Places, window: Window) -> tuple[Array, Array]:
        """Return what all nights before some starts say, shapes (k, q, q) and (k, q)."""
        q = len(self.basis)
        sums = np.stack([self.rows[start][1, : q * (q + 1)] for start in starts])
        information = sums[:, : q * q].reshape(-1, q, q)
        return window.before + information, window.score_before + sums[:, q * q :]

    def since(self, starts: Places, weights: Array, without: Places | None) -> Parts:
        """Return the sums from starts to the newest night, (k, …).

        `weights` are those of the sums with Q as it is and of those with Q of a long record, shape
        (k, 2); `without` is a night that each start leaves out.
        """
        since = self.rows[-1] - np.stack([self.rows[start] for start in starts])
        if without is not None:
            since -= np.stack([self.rows[night + 1] - self.rows[night] for night in without])
        return Parts.of_rows((weights[:, None] @ since)[:, 0], self.basis)


STEP, RAMP = 0, 1
SHAPES = (STEPS, RAMPS)
# Share of the largest direction below which another is a combination of others.
RANK_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class Causes:
    """Causes as arrays: directions, (q, d), an orthonormal basis of them, (q, r), and their sizes.

    Means, spreads and kinds of the sizes' priors have shape (2, d): of steps, and of a ramp's rise
    in ten days.
    """

    every: tuple[Cause, ...]
    directions: Array
    basis: Array
    mean: Array
    spread: Array
    is_half: Mask

    @classmethod
    def of(cls, every: Sequence[Cause]) -> Causes:
        directions = np.array([cause.direction for cause in every]).T
        left, size, _ = np.linalg.svd(directions, full_matrices=False)
        mean, spread, is_half = (
            np.array(values)
            for values in zip(
                *((cause.mean, cause.spread, cause.is_half) for cause in every), strict=True
            )
        )
        return cls(
            tuple(every),
            directions,
            left[:, size > RANK_TOLERANCE * size[0]],
            np.stack([mean, np.zeros_like(mean)]),
            np.stack([spread, spread * (choices.RAMP_SIZE / choices.STEP_SIZE)]),
            np.stack([is_half, np.ones_like(is_half)]),
        )

    def __len__(self) -> int:
        return len(self.every)


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

        With `by_operation` the model may err where the operating conditions are not the
        baseline's; `without` is a night that each start leaves out.
        """
        first, second = self._along_basis(starts, without, by_operation=by_operation)
        along = self.sums.basis.T @ self.causes.directions
        second = np.maximum((along * (second @ along)).sum(axis=2), 1e-12)
        return self._weighed(first @ along, second, starts)

    def second_of(self, direction: Array, start: int) -> float:
        """Return T₂ of a step of a direction in the causes' span, shape (q,), at a start."""
        _, second = self._along_basis(np.array([start]))
        along = self.sums.basis.T @ direction
        return max(float(along @ second[STEP, 0] @ along), 1e-12)

    def _along_basis(
        self, starts: Places, without: Places | None = None, *, by_operation: bool = True
    ) -> tuple[Array, Array]:
        """Return B'w, (2, k, r), and B'WB, (2, k, r, r), of steps and of ramps, B the basis.

        An error of the paths since each start is left free: E at other operating conditions.
        """
        basis, since = self.sums.basis, self.since(starts, without, by_operation=by_operation)
        information, score = since.information, since.score
        error = self._operating_error(starts, information, is_free=by_operation)
        p = error.shape[1]
        across, of_paths = information[:, :, :p], score[:, :p, None]
        before, score_before = self.sums.before(starts, self.window)
        total = before + information - across @ (error @ information[:, :p])
        whole = score_before + score - (across @ (error @ of_paths))[:, :, 0]
        # On its first night a ramp has risen by a day.
        origin = (self.window.days[starts] - self.window.days[0] - 1.0)[:, None, None]
        tens, step = choices.RAMP_DAYS, information @ basis
        along = np.stack([step, (since.linear - origin * step) / tens])
        square = since.square - 2.0 * origin * (basis.T @ since.linear)
        square += origin**2 * (basis.T @ step)
        squares = np.stack([basis.T @ step, square / tens**2])
        level = score @ basis
        scores = np.stack([level, (since.linear_score - origin[:, 0] * level) / tens])
        lost = error @ along[:, :, :p]
        left = along - across @ lost
        solved = np.linalg.solve(total, np.concatenate([*left, whole[:, :, None]], axis=2))
        *rises, mean = np.split(solved, [len(basis[0]), 2 * len(basis[0])], axis=2)
        first = scores - (lost * of_paths).sum(axis=2) - (left * mean).sum(axis=2)
        second = squares - along[:, :, :p].swapaxes(2, 3) @ lost
        second -= left.swapaxes(2, 3) @ np.stack(rises)
        return first, second

    def since(
        self, starts: Places, without: Places | None = None, *, by_operation: bool = True
    ) -> Parts:
        """Return the sums from some starts on, of correlated nights, shapes (k, …)."""
        n_nights = (len(self.window) - starts).astype(float)
        share = self.wander.share_of_short(n_nights)
        # At other operating conditions the model's error is that of all nights alike, those within
        # nights too.
        is_other = self.operates_otherwise(starts) & by_operation
        inflated = 1.0 / self.wander.inflation(n_nights)
        weights = np.where(is_other, inflated, share), np.where(is_other, 0.0, 1.0 - share)
        return self.sums.since(starts, np.stack(weights, axis=1), without)

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
        causes = self.causes
        mean, spread, is_half = (
            values[:, None] for values in (causes.mean, causes.spread, causes.is_half)
        )
        sd = 1.0 / np.sqrt(second + spread**-2)
        size = sd**2 * (first + mean / spread**2)
        gain = (size / sd) ** 2 - (mean / spread) ** 2
        one_sided = np.where(is_half, math.log(2.0) + log_ndtr(size / sd), 0.0)
        log_ratio = 0.5 * self.temper(gain, starts) + np.log(sd / spread) + one_sided
        log_ratio -= math.log(len(causes) * len(SHAPES))
        is_early = starts < self.first_step
        log_ratio[STEP, is_early] = -np.inf
        if self.n_nights == len(self.window):
            log_ratio[RAMP, is_early & (starts == 0)] += math.log(choices.STARTS_BEFORE)
        return StartEvidence(log_ratio, size, sd, first, second)

    def temper(self, gain: Array, starts: Places) -> Array:
        """Return twice a gain of ln likelihood, (…, k, d), by Student's t: wander is estimated."""
        n_since = (len(self.window) - starts).astype(float)
        freedom = self.wander.degrees_of_freedom(self.n_nights, n_since)[:, None]
        most = float(np.max(gain))
        rest: Array = np.log((freedom + most) / (freedom + most - gain))
        return (freedom + 1.0) * rest


def starts_of(first: int, last: int) -> tuple[Places, Array]:
    """Return candidate starts from a place to the newest, and ln of how many each stands for.

    The last 40 nights singly, older starts 2, 4, 8 … nights apart at multiples of that.
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
