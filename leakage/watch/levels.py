"""Level of the flow along a direction, night by night: what is trended and shown.

λ = d'(u − Aẑ) / d'Ad of a night, ẑ what all nights say of the unknowns, but for what moves the flow
at the motor's own conditions, which is d's: a baseline of few nights knows the unknowns badly, and
a season would be taken for a change.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from leakage.watch import choices
from leakage.watch.baseline import Baseline
from leakage.watch.nights import Array, Estimate
from leakage.watch.wander import Wander
from leakage.watch.window import Sums, Window


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
    """Of the nights before a place, beside a straight line in time along a direction.

    What rises evenly is wear, or none: it is not taken for an effect of a season.
    """
    q = len(direction)
    before, score = (one[0] for one in sums.before(np.array([end]), window))
    day = float(window.days[max(end - 1, 0)])
    (a0, a1, a2), (u0, u1) = (
        tuple(one[1, end] for one in kind) for kind in (sums.information, sums.score)
    )
    tens = choices.RAMP_DAYS
    linear = (a1 - day * a0) @ direction / tens
    square = float(direction @ (a2 - 2.0 * day * a1 + day**2 * a0) @ direction) / tens**2
    whole = np.block([[before, linear[:, None]], [linear[None], np.array([[square]])]])
    whole[q, q] += choices.RAMP_SIZE**-2
    line = float((u1 - day * u0) @ direction) / tens
    covariance = np.linalg.inv(whole)
    mean = (covariance @ np.append(score, line))[:q]
    levelled = np.eye(q) - np.outer(direction, own_row) / float(own_row @ direction)
    return Surroundings(levelled @ mean, levelled @ covariance[:q, :q] @ levelled.T)


@dataclass(frozen=True, slots=True)
class Level:
    """λ of some nights, and what their errors are made from.

    `value`, the variances `noise` of the errors within each night and `shift` of its own shift of
    the paths, and `beyond`, how far its duty is from a usual one, have shape (n,); `of_others` and
    `of_paths` are what an error of all unknowns, and of the paths, does to it, shapes (n, q) and
    (n, p).
    """

    value: Array
    noise: Array
    shift: Array
    of_others: Array
    of_paths: Array
    beyond: Array
    around: Surroundings
    wander: Wander
    duty_error: Array

    def mean(self, nights: slice) -> Estimate:
        """Mean of some nights: they share their serial correlation, and the errors of the model."""
        value, noise, shift = self.value[nights], self.noise[nights], self.shift[nights]
        weights = 1.0 / (noise + shift) / np.sum(1.0 / (noise + shift))
        length = float(self.wander.inflation(np.array([len(value)], dtype=float))[0])
        of_others = weights @ self.of_others[nights]
        by_duty = weights @ (self.of_paths[nights] * self.beyond[nights][:, None])
        variance = float(weights**2 @ (noise + length * shift))
        variance += float(of_others @ self.around.covariance @ of_others)
        variance += float(np.sum((by_duty * self.duty_error) ** 2))
        return Estimate(float(weights @ value), math.sqrt(variance))


def levels_along(
    window: Window, direction: Array, wander: Wander, baseline: Baseline, around: Surroundings
) -> Level:
    """λ of a window's nights along a direction of shape (q,)."""
    p = len(wander.spread)
    along = window.information @ direction
    weight = np.maximum(along @ direction, 1e-12)
    gain = along / weight[:, None]
    shift = np.einsum("ni,ij,nj->n", gain[:, :p], wander.spread, gain[:, :p])
    return Level(
        window.score @ direction / weight - gain @ around.mean,
        1.0 / weight,
        shift,
        gain,
        gain[:, :p],
        np.clip(window.distance - choices.DUTY_FREE, 0.0, choices.DUTY_MOST),
        around,
        wander,
        baseline.duty_error,
    )
