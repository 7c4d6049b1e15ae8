"""A block in numbers: how far its flow is off, and what each unknown would do to it.

A block's residual is r = (y − ŷ) / s with ŷ = θ₀'x and s = max(ŷ, 20 % of the mean flow). The
unknowns z are the change of each path, in units of its own flow; the effect of temperature in 10 K,
straight and bent; a discrepancy surface over pressure and speed, which is what a model may miss;
and the flow meter's zero, in mean flows. Temperature and surface scale with the expected flow, the
zero does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leakage.watch import choices
from leakage.watch.nights import Array, NightBlocks

# Columns of the effect of temperature.
N_TEMPERATURE = 2


@dataclass(frozen=True, slots=True)
class Columns:
    """Units and knots of a motor's unknowns, by its first nights.

    `sign` turns drives that count backwards, shape (p,); `theta` are the coefficients, shape (p,);
    `unit` what a change of 1 of each path is; `least_scale` [l/min]. An estimated flushing is one
    with the meter's zero.
    """

    sign: Array
    theta: Array
    unit: Array
    least_scale: float
    temperature_c: float
    pressure_knots: Array
    speed_knots: Array
    has_zero: bool

    @property
    def n_paths(self) -> int:
        return len(self.theta)

    @property
    def n_surface(self) -> int:
        """Knots of the surface; none at one pressure and one speed."""
        n = len(self.pressure_knots) * len(self.speed_knots)
        return n if n > 1 else 0

    @property
    def n(self) -> int:
        """Number q of unknowns."""
        return self.n_paths + N_TEMPERATURE + self.n_surface + self.has_zero

    def expected(self, drives: Array) -> Array:
        """Expected flow ŷ of drives of shape (b, p), shape (b,), [l/min]."""
        flow: Array = (drives * self.sign) @ self.theta
        return flow

    def scale(self, expected: Array) -> Array:
        """What residuals are divided by, [l/min]."""
        return np.maximum(expected, self.least_scale)

    def design(self, drives: Array, conditions: Array, scale: Array) -> Array:
        """What a unit of each unknown does to the residuals of some blocks, shape (b, q)."""
        of_scale = self.expected(drives) / scale
        paths = drives * self.sign * self.unit / scale[:, None]
        warmer = (conditions[:, 0] - self.temperature_c) / 10.0
        parts = [paths, np.column_stack([of_scale * warmer, of_scale * warmer**2])]
        if self.n_surface:
            by_pressure = hat_functions(conditions[:, 1], self.pressure_knots)
            by_speed = hat_functions(conditions[:, 2], self.speed_knots)
            surface = (by_pressure[:, :, None] * by_speed[:, None, :]).reshape(len(scale), -1)
            parts.append(of_scale[:, None] * surface)
        if self.has_zero:
            mean_flow = self.least_scale / choices.LEAST_SCALE
            parts.append((mean_flow / scale)[:, None])
        return np.concatenate(parts, axis=1)

    def of_night(self, night: NightBlocks) -> tuple[Array, Array]:
        """Design, shape (b, q), and residuals, shape (b,), of a night's blocks."""
        expected = self.expected(night.drives)
        scale = self.scale(expected)
        design = self.design(night.drives, night.conditions, scale)
        return design, (night.flow - expected) / scale

    def duty(self, night: NightBlocks) -> Array:
        """Share of each path in a night's flow, mean pressure and mean speed, shape (p + 2,)."""
        flows = night.drives * self.sign * self.theta
        shares = (flows / self.scale(flows.sum(axis=1))[:, None]).mean(axis=0)
        return np.concatenate([shares, night.conditions[:, 1:].mean(axis=0)])

    def prior(self) -> Array:
        """Information that the unknowns have before any night, shape (q, q)."""
        sd = np.full(self.n, choices.SURFACE_PRIOR)
        sd[: self.n_paths] = choices.PATH_PRIOR
        sd[self.n_paths : self.n_paths + N_TEMPERATURE] = choices.TEMPERATURE_PRIOR
        if self.has_zero:
            sd[-1] = choices.ZERO_PRIOR
        return np.diag(sd**-2)


def hat_functions(values: Array, knots: Array) -> Array:
    """Piecewise linear functions that are 1 at one knot and 0 at the others, shape (b, k).

    Constant beyond the first and the last knot.

    Examples
    --------
    >>> hat_functions(np.array([0.0, 15.0, 40.0]), np.array([10.0, 20.0])).tolist()
    [[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]]
    """
    if len(knots) < 2:
        return np.ones((len(values), 1))
    return np.stack([np.interp(values, knots, row) for row in np.eye(len(knots))], axis=-1)


def knots_at(values: Array, quantiles: Sequence[float], apart: float) -> Array:
    """Knots at quantiles of some values, without those nearer than a share of the largest."""
    least = apart * max(float(values.max()), 1e-9)
    kept: list[float] = []
    for knot in np.quantile(values, quantiles).tolist():
        if not kept or knot - kept[-1] > least:
            kept.append(knot)
    return np.array(kept)
