"""What first nights fix: expected flow, effect of temperature, discrepancy surface, errors.

A block's residual is r = (y − ŷ) / s with ŷ = θ₀'x and s = max(ŷ, 20 % of the mean flow). The
unknowns z are the change of each path, in units of its own flow; the effect of temperature in 10 K,
straight and bent, and on each path alone; a discrepancy surface over pressure and speed, which is
what a model may miss; and the flow meter's zero, in mean flows. The first effect of temperature and
the surface scale with the expected flow, the zero does not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leakage.arrays import Array
from leakage.watch import choices
from leakage.watch.nights import FLUSHING, TWO_SIDED_95, Machine, NightBlocks
from leakage.watch.within_night import (
    START,
    BlockErrors,
    estimate_errors,
    night_information,
    unexplained_share,
    variance_factors,
)

# Columns of the effect of temperature.
N_TEMPERATURE = 2


@dataclass(frozen=True, slots=True)
class Columns:
    """Units and knots of a motor's unknowns, by its first nights.

    `sign` turns drives that count backwards, shape (p,); `theta` are the coefficients, shape (p,);
    `unit` what a change of 1 of each path is; `least_scale` [l/min]. An estimated flushing is one
    with the meter's zero. `further` are usual pressure [bar] and speed [rpm] of flows that do not
    follow the oil's viscosity and stand behind the model's paths, shape (2,); empty without them.
    """

    sign: Array
    theta: Array
    unit: Array
    least_scale: float
    temperature_c: float
    pressure_knots: Array
    speed_knots: Array
    has_zero: bool
    further: Array

    @property
    def n_paths(self) -> int:
        return len(self.theta)

    @property
    def n_driven(self) -> int:
        """Number of the model's own paths."""
        n_further = 2 + self.has_zero if len(self.further) else 0
        return self.n_paths - n_further

    def all_drives(self, drives: Array, conditions: Array) -> Array:
        """Return drives of some blocks with those of further flows, shape (b, p)."""
        return all_drives(drives, conditions, self.further, has_constant=self.has_zero)

    @property
    def n_surface(self) -> int:
        """Knots of the surface; none at a single pressure and speed."""
        n = len(self.pressure_knots) * len(self.speed_knots)
        return n if n > 1 else 0

    @property
    def n(self) -> int:
        """Number q of unknowns."""
        return self.surface_from + self.n_surface + self.has_zero

    @property
    def surface_from(self) -> int:
        """Place of the surface's first knot: behind the paths and the effects of temperature."""
        return 2 * self.n_paths + N_TEMPERATURE

    def expected(self, drives: Array) -> Array:
        """Return expected flow ŷ of drives of shape (b, p), shape (b,), [l/min]."""
        flow: Array = (drives * self.sign) @ self.theta
        return flow

    def scale(self, expected: Array) -> Array:
        """Return what residuals are divided by, [l/min]."""
        return np.maximum(expected, self.least_scale)

    def design(self, drives: Array, conditions: Array, scale: Array) -> Array:
        """Return what a unit of each unknown does to the residuals of some blocks, shape (b, q)."""
        of_scale = self.expected(drives) / scale
        paths = drives * self.sign * self.unit / scale[:, None]
        warmer = (conditions[:, 0] - self.temperature_c) / 10.0
        by_warmth = np.column_stack([of_scale * warmer, of_scale * warmer**2])
        parts = [paths, by_warmth, paths * warmer[:, None]]
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
        """Return design, shape (b, q), and residuals, shape (b,), of a night's blocks."""
        drives = self.all_drives(night.drives, night.conditions)
        expected = self.expected(drives)
        scale = self.scale(expected)
        design = self.design(drives, night.conditions, scale)
        return design, (night.flow - expected) / scale

    def operating_point(self, night: NightBlocks) -> Array:
        """Return each model path's share in their flow, mean pressure and speed, shape (p + 2,).

        Further flows do not follow the temperature, which would pass for other conditions.
        """
        own = slice(self.n_driven)
        flows = night.drives * self.sign[own] * self.theta[own]
        shares = (flows / self.scale(flows.sum(axis=1))[:, None]).mean(axis=0)
        return np.concatenate([shares, night.conditions[:, 1:].mean(axis=0)])

    def prior(self) -> Array:
        """Return information that the unknowns have before any night, shape (q, q)."""
        sd = np.full(self.n, choices.SURFACE_PRIOR)
        sd[: self.n_driven] = choices.PATH_PRIOR
        sd[self.n_driven : self.n_paths] = choices.FURTHER_PRIOR
        sd[self.n_paths : self.n_paths + N_TEMPERATURE] = choices.TEMPERATURE_PRIOR
        sd[self.n_paths + N_TEMPERATURE : self.surface_from] = choices.PATH_TEMPERATURE_PRIOR
        if self.has_zero:
            sd[-1] = choices.ZERO_PRIOR
        return np.diag(sd**-2)


def all_drives(drives: Array, conditions: Array, further: Array, *, has_constant: bool) -> Array:
    """Return drives with those of further flows, if a usual pressure and speed is given for them.

    Of an orifice, which is turbulent; of what the speed drags along; of a constant, where no
    flushing is estimated.
    """
    if not len(further):
        return drives
    bar, rpm = (np.abs(conditions[:, 1:]) / further).T
    return np.column_stack([drives, np.sqrt(bar), rpm, np.ones((len(bar), int(has_constant)))])


def hat_functions(values: Array, knots: Array) -> Array:
    """Return piecewise linear functions that are 1 at a knot and 0 at the others, shape (b, k).

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
    """Return knots at quantiles of values, without those nearer than a share of the largest."""
    least = apart * max(float(values.max()), 1e-9)
    knots_apart: list[float] = []
    for knot in np.quantile(values, quantiles).tolist():
        if not knots_apart or knot - knots_apart[-1] > least:
            knots_apart.append(knot)
    return np.array(knots_apart)


# Tolerances of the errors' logarithms, of fits of coefficients and errors in turn: a fourth changes
# nothing that counts.
PASSES = (0.1, 0.1, 0.01)
# Share of the flow that a unit of a path has at least, where it is divided by.
LEAST_SHARE = 0.01
# Usual pressure [bar] and speed [rpm] that further flows are held against, at least.
LEAST_USUAL = (1.0, 0.01)


@dataclass(frozen=True, slots=True)
class Baseline:
    """A motor as its first nights show it."""

    columns: Columns  # Units of the unknowns z, and θ₀.
    unknowns: Array  # z of the baseline, shape (q,): 0 for the paths, whose share is in θ₀.
    errors: BlockErrors  # Errors within a night.
    # operating_mean, operating_sd: Of the nights' operating conditions, shape (p + 2,) each.
    operating_mean: Array
    operating_sd: Array
    # What a unit of each unknown is of the flow at the motor's own conditions, shape (q,).
    own_row: Array
    path_sd: Array  # Standard errors of the paths, in their units, shape (p,).
    # Root mean square of what temperature and surface explain, which the flows do not; model_error:
    # which the model's own paths do not, without further flows.
    lack_of_fit: float
    model_error: float
    # identifies_gaps, identifies_speed: Whether pressures, and speeds, vary by enough to
    # distinguish paths by them, and the model misses little of how the flow goes with pressure.
    identifies_gaps: bool
    identifies_speed: bool
    flushing: int | None = None  # Place of an estimated flushing among the paths, if any.

    @property
    def n_paths(self) -> int:
        return self.columns.n_paths

    @property
    def leakage_share(self) -> float:
        """Share of the leakage in the drain flow at the motor's own conditions (model.md, 7c.3)."""
        if self.flushing is None:
            return 1.0
        flushed = float(self.own_row[self.flushing] * self.all_paths[self.flushing])
        return max(1.0 - flushed, LEAST_SHARE)

    @property
    def split_error(self) -> float:
        """Relative standard error of that share: of the flushing's estimate, and of the model.

        A drain flow that misses by the lack of fit over its range moves its constant part by as
        much. A leakage of another power of pressure and speed looks like the model's and a
        constant, over any range: where the model misses something, its power is not sure.
        """
        if self.flushing is None:
            return 0.0
        of_flow = float(self.own_row[self.flushing] * self.path_sd[self.flushing])
        is_missed = min(self.model_error / choices.WRONG_SHAPE, 1.0)
        return math.hypot(
            math.hypot(of_flow, self.lack_of_fit) / self.leakage_share,
            choices.LEAKAGE_BY_SHAPE * is_missed,
        )

    @property
    def leakage_share_error(self) -> float:
        """The same for a change of the leakage.

        A share is at most 1, so that a leakage changes by no less than the drain flow: no error of
        the flushing takes a change away, which is left half of its size at least.
        """
        most = max(1.0 - self.leakage_share, choices.MOSTLY) / TWO_SIDED_95
        return min(self.split_error, most)

    @property
    def leakage_row(self) -> Array:
        """What a unit of each unknown is of the leakage at the motor's own conditions, (q,)."""
        row = self.own_row.copy()
        if self.flushing is not None:
            row[self.flushing] = 0.0
        return row / self.leakage_share

    @property
    def leakage_flows(self) -> Array:
        """All flows but the flushing by the same factor, shape (q,)."""
        direction = self.all_flows
        if self.flushing is not None:
            direction[self.flushing] = 0.0
        return direction

    @property
    def share(self) -> Array:
        """What a unit of each path is of the flow, at least a hundredth, shape (p,)."""
        share: Array = np.maximum(self.own_row[: self.n_paths], LEAST_SHARE)
        return share

    @property
    def all_paths(self) -> Array:
        """All paths by the same factor, shape (q,)."""
        direction = np.zeros(self.columns.n)
        direction[: self.n_paths] = self.columns.theta / self.columns.unit
        return direction

    @property
    def all_flows(self) -> Array:
        """The same with what the model misses, which scales too, shape (q,)."""
        return self.all_paths + self.unknowns

    @property
    def operating_error(self) -> Array:
        """Error of each path's unit a standard deviation of the operating conditions, (p,)."""
        error = choices.OPERATING_ERROR
        if self.identifies_gaps and self.identifies_speed:
            by_lack = choices.OPERATING_BY_LACK * self.lack_of_fit
            error = min(error, max(by_lack, choices.OPERATING_LEAST_ERROR))
        errors: Array = error / self.share
        errors[self.columns.n_driven :] = 0.0
        return errors

    def information(self, night: NightBlocks) -> tuple[Array, Array]:
        """Return information about z − z₀, shape (q, q), and score, shape (q,), of a night."""
        design, residuals = self.columns.of_night(night)
        residuals = residuals - design @ self.unknowns
        return night_information(design, residuals, night.middle_s, self.errors, self.n_paths)

    def misfit(self, night: NightBlocks) -> float:
        """Return the share of a night's flow that its conditions do not explain; nan: too short.

        Of half of the usual flow at least, as a meter's noise is fixed.
        """
        columns = self.columns
        expected = columns.expected(columns.all_drives(night.drives, night.conditions))
        usual = columns.least_scale / choices.LEAST_SCALE
        return unexplained_share(night.flow, expected, night.conditions, choices.MOSTLY * usual)

    def usual_misfit(self, nights: Sequence[NightBlocks]) -> float:
        """Return the most of a baseline's nights; inf where most of them are too short to tell."""
        misfits = [self.misfit(night) for night in nights]
        known = [misfit for misfit in misfits if math.isfinite(misfit)]
        return max(known) if 2 * len(known) >= len(nights) else math.inf

    def distance(self, night: NightBlocks) -> float:
        """Return the largest distance of a night's conditions from the baseline's, in their sd."""
        apart = (
            np.abs(self.columns.operating_point(night) - self.operating_mean) / self.operating_sd
        )
        return float(apart.max())


def baseline_of(
    machine: Machine, nights: Sequence[NightBlocks], *, has_further: bool | None = None
) -> Baseline:
    """Return the baseline of some nights, with further flows where the model alone misses much.

    Verdict and names are those of the model alone, whose parts are looked at (model.md, 7c.10).
    `has_further` says whether there are any, in place of the nights.
    """
    plain = _baseline_of(machine, nights, further=np.empty(0))
    if has_further is None:
        has_further = plain.lack_of_fit > choices.LACK_TO_ADD
    if not has_further:
        return plain
    usual = np.concatenate([night.conditions[:, 1:] for night in nights]).mean(axis=0)
    wider = _baseline_of(machine, nights, further=np.maximum(np.abs(usual), LEAST_USUAL))
    return replace(
        wider,
        model_error=plain.lack_of_fit,
        identifies_gaps=plain.identifies_gaps,
        identifies_speed=plain.identifies_speed,
    )


def _baseline_of(machine: Machine, nights: Sequence[NightBlocks], *, further: Array) -> Baseline:
    """Return the baseline with further flows, or without any; they are as in `Columns`.

    θ₀ ≥ 0, effect of temperature and surface are fitted together, by generalised least squares;
    clipping θ₀ afterwards would put the expected flow off.
    """
    flow = np.concatenate([night.flow for night in nights])
    conditions = np.concatenate([night.conditions for night in nights])
    has_zero = FLUSHING not in machine.paths
    drives = np.concatenate([night.drives for night in nights])
    drives = all_drives(drives, conditions, further, has_constant=has_zero)
    sign = np.where(drives.mean(axis=0) < 0.0, -1.0, 1.0)
    mean_flow = max(float(flow.mean()), 1e-9)
    drives = drives * sign
    least_unit = choices.LEAST_UNIT * mean_flow / np.maximum(np.abs(drives).mean(axis=0), 1e-12)
    theta = _first_guess(drives, flow)
    pressures, speeds = conditions[:, 1], conditions[:, 2]
    columns = Columns(
        sign,
        theta,
        np.maximum(theta, least_unit),
        choices.LEAST_SCALE * mean_flow,
        float(conditions[:, 0].mean()),
        knots_at(pressures, choices.PRESSURE_KNOTS, choices.PRESSURE_APART),
        knots_at(speeds, choices.SPEED_KNOTS, choices.SPEED_APART),
        has_zero,
        further,
    )
    errors = BlockErrors.of(START)
    unknowns = np.zeros(columns.n)
    for number, tolerance in enumerate(PASSES):
        # Before the first pass it is not known which blocks the others contradict.
        known = unknowns if number else None
        theta, unknowns, errors, path_sd = _fit(columns, nights, errors, known, tolerance)
        if not np.any(theta > 0.0):
            theta = _first_guess(drives, np.full(len(flow), mean_flow))
        columns = replace(columns, theta=theta, unit=np.maximum(theta, least_unit))
    least_spread = np.full(columns.n_driven + 2, choices.OPERATING_LEAST_SHARE)
    least_spread[-2:] = choices.OPERATING_LEAST_BAR, choices.OPERATING_LEAST_RPM
    lack_of_shape = _missed_share(columns, unknowns, nights, columns.surface_from)
    lack_of_fit = _missed_share(columns, unknowns, nights, columns.n_paths)
    operating_points = np.array([columns.operating_point(night) for night in nights])
    return Baseline(
        columns,
        unknowns,
        errors,
        operating_points.mean(axis=0),
        operating_points.std(axis=0, ddof=1) + least_spread,
        _own_row(columns, nights),
        path_sd,
        lack_of_fit,
        lack_of_fit,
        lack_of_shape <= choices.LACK_TO_NAME and varies(pressures),
        varies(speeds),
        machine.paths.index(FLUSHING) if FLUSHING in machine.paths else None,
    )


def varies(values: Array) -> bool:
    """Return whether a quantity leaves ± 20 % of its middle.

    Examples
    --------
    >>> varies(np.array([180.0, 181.0, 182.0])), varies(np.array([60.0, 120.0, 240.0]))
    (False, True)
    """
    low, high = np.quantile(values, (0.05, 0.95))
    return bool(high - low > choices.ONE_POINT * (high + low))


def _first_guess(drives: Array, flow: Array) -> Array:
    """Return θ ≥ 0 by weighted least squares, leaning a little to equal shares, shape (p,)."""
    from scipy.optimize import nnls  # half a second, of the nights that begin a baseline alone

    p, mean = drives.shape[1], float(flow.mean())
    usual = np.maximum(np.abs(drives).mean(axis=0), 1e-12) / mean
    weights = 1.0 / np.maximum(flow, choices.LEAST_UNIT * mean)
    lean = 1e-3 * math.sqrt(len(flow)) * np.eye(p) / mean
    rows = np.vstack([drives / usual * weights[:, None], lean])
    wanted = np.concatenate([flow * weights, lean @ np.full(p, mean / p)])
    theta: Array = nnls(rows, wanted)[0] / usual
    return theta


def _fit(
    columns: Columns,
    nights: Sequence[NightBlocks],
    errors: BlockErrors,
    known: Array | None,
    tolerance: float,
) -> tuple[Array, Array, BlockErrors, Array]:
    """Return θ ≥ 0, the other unknowns, the errors of the rest, the paths' standard errors.

    Blocks that contradict the others of their night by the unknowns so far count less, as they do
    in every later night: air in the drain line would stand in the baseline alone.
    """
    from scipy.optimize import lsq_linear

    p, designs = columns.n_paths, [columns.of_night(night) for night in nights]
    information, score = columns.prior(), np.zeros(columns.n)
    for night, (design, residuals) in zip(nights, designs, strict=True):
        wider = None
        if known is not None:
            left = residuals - design @ known
            wider = variance_factors(design[:, :p], left, night.middle_s, errors)
        covariance = errors.covariance(night.middle_s, wider, with_night=True)
        weighted = np.linalg.solve(covariance, np.column_stack([design, residuals]))
        information = information + design.T @ weighted[:, :-1]
        score = score + design.T @ weighted[:, -1]
    if columns.has_zero:
        # A zero is a change alone: what does not scale with the flow from the first is a flushing.
        information[-1] = information[:, -1] = 0.0
        information[-1, -1], score[-1] = 1.0, 0.0
    before = np.zeros(columns.n)
    before[:p] = columns.theta / columns.unit
    root = np.linalg.cholesky(information).T
    least = np.where(np.arange(columns.n) < p, 0.0, -np.inf)
    wanted = np.linalg.solve(root.T, score) + root @ before
    fitted = lsq_linear(root, wanted, (least, np.inf), method="bvls").x
    rest = [
        (night.middle_s, residuals - design @ (fitted - before))
        for night, (design, residuals) in zip(nights, designs, strict=True)
    ]
    unknowns = np.where(np.arange(columns.n) < p, 0.0, fitted)
    theta = np.maximum(columns.unit * fitted[:p], 0.0)
    path_sd = np.sqrt(np.diag(np.linalg.inv(information))[:p])
    return theta, unknowns, estimate_errors(rest, errors, tolerance), path_sd


def _own_row(columns: Columns, nights: Sequence[NightBlocks]) -> Array:
    """Return the mean effect of each unknown over the baseline's blocks, over their mean flow."""
    drives = [columns.all_drives(night.drives, night.conditions) for night in nights]
    expected = [columns.expected(of_night) for of_night in drives]
    effects = [
        columns.design(of_night, night.conditions, columns.scale(flow)).T @ columns.scale(flow)
        for night, of_night, flow in zip(nights, drives, expected, strict=True)
    ]
    total: Array = np.sum(effects, axis=0) / max(float(np.concatenate(expected).sum()), 1e-12)
    return total


def _missed_share(
    columns: Columns, unknowns: Array, nights: Sequence[NightBlocks], first: int
) -> float:
    """Return root mean square share of the flow that the unknowns from a place on explain."""
    missed = [columns.of_night(night)[0][:, first:] @ unknowns[first:] for night in nights]
    return float(np.sqrt(np.mean(np.concatenate(missed) ** 2)))
