r"""The global minimum of the criterion, computed with a proof, and the thesis's search beside it.

In the loss factors K and the flushing C_f the model is linear and the bounds are a box, so

.. math:: \min_{l \le \theta \le u} \lVert A\theta - b \rVert^2

is convex: its minimum is global. The Karush–Kuhn–Tucker conditions prove it: the gradient is 0 in
every coefficient off its bounds and points outwards at a bound. The largest violation is reported
as the dual residual. This minimum is what is published.

The thesis searches in gap heights and eccentricities (3.4, 3.5), by SciPy's trust-region-reflective
method from several starting points. h and e of a path enter only as K ∝ h³(1 + 1.5e²): runs from
different points end at the same minimum of the criterion with different (h, e). The starts show
that this search agrees, and how far the thesis's parameters spread at the minimum: an audit.
The optimiser sees µm and l/min, never metres: its step test is on an unscaled norm.

References
----------
.. [1] P. B. Stark and R. L. Parker, "Bounded-variable least-squares: an algorithm and
   applications", *Computational Statistics* 10, 129-141, 1995.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leakage.arrays import Array, Mask
from leakage.errors import EstimationError
from leakage.estimation.blocks import criterion, sample_count
from leakage.physics.motor import Motor
from leakage.physics.paths import Parameter

# A column counts as dependent below this share of the largest singular value: rounding, not noise.
RANK_TOLERANCE = 1e-11
# Share of the flow's mean square that rounding alone leaves in the criterion.
ROUNDING_SHARE = 1e-24
# Share of the column-scaled box within which a coefficient counts as lying on its bound.
BOUND_TOLERANCE = 1e-12
# A gradient into the box below this share of the flow's norm is rounding.
PULL_TOLERANCE = 1e-14
# Exchanges with the bounds before the search gives up; it takes one or two for each coefficient.
MOST_EXCHANGES = 200


@dataclass(frozen=True, slots=True)
class ProvenMinimum:
    """The minimum of a box-bounded linear least squares problem, with its proof."""

    # θ: loss factors in the order of the columns, then the constant flow; shape (p + 1,).
    coefficients: Array
    # θ without its bounds, of least norm where columns depend on each other; shape (p + 1,).
    # A leakage is computed from it: what a bound takes from a coefficient it gives to the others,
    # which is right for their gaps and wrong for the sum.
    unbounded: Array
    cost: float  # V(θ) [(l/min)²]
    # Largest violation of the Karush–Kuhn–Tucker conditions, relative to ‖A_j‖ ‖b‖.
    dual_residual: float
    # at_lower, at_upper: coefficients that lie on a bound and are not fixed; shape (p + 1,).
    at_lower: Mask
    at_upper: Mask
    fixed: Mask  # coefficients whose bounds are equal; shape (p + 1,)
    rank: int  # rank of the free, column-scaled regressors
    singular_values: Array  # of the free regressors, each column scaled to norm 1; largest first
    # Rank of the regressors whose coefficients are off their bounds: d of FPE and AIC.
    n_estimated: int
    rounding: float  # criterion below which nothing but rounding is left [(l/min)²]

    @property
    def condition_number(self) -> float:
        """Largest over smallest singular value; infinite for dependent columns, nan without any."""
        values = self.singular_values
        if not len(values):
            return float("nan")
        return float(values[0] / values[-1]) if values[-1] > 0 else float("inf")

    @property
    def off_bounds(self) -> Mask:
        """Coefficients that are estimated and off their bounds; shape (p + 1,)."""
        off: Mask = ~(self.fixed | self.at_lower | self.at_upper)
        return off


def certify(r: Array, lower: Array, upper: Array) -> ProvenMinimum:
    """Return global minimum of the criterion over a box of coefficients; equal bounds fix one.

    Where the minimum is a set (dependent columns), its element of least norm in scaled columns if
    that lies in the box, else where the bounded solver ends: both deterministic.

    Raises EstimationError if the factor holds fewer samples than there are free coefficients.
    """
    lower, upper = np.asarray(lower, float), np.asarray(upper, float)
    _require_well_posed(r, lower, upper)
    fixed = lower == upper
    free = ~fixed
    matrix, target = r[:, :-2], r[:, -1] - r[:, -2]
    remaining = target - matrix[:, fixed] @ lower[fixed]
    norms = np.linalg.norm(matrix, axis=0)
    scale = np.where(norms > 0, norms, 1.0)
    scaled = matrix / scale
    singular_values = _singular_values(scaled[:, free])
    solution, unbounded = lower.copy(), lower.copy()
    box = (lower * scale)[free], (upper * scale)[free]
    without = _least_norm(scaled[:, free], remaining)
    unbounded[free] = without / scale[free]
    bounded = _bounded_minimum(scaled[:, free], remaining, *box, without)
    # A bound that was scaled and scaled back is off by rounding: take the bound itself.
    sides = [bounded <= box[0], bounded >= box[1]]
    solution[free] = np.select(sides, [lower[free], upper[free]], bounded / scale[free])
    solution = np.clip(solution, lower, upper)
    width = np.where(fixed, 1.0, upper - lower)
    at_lower = free & (solution - lower <= BOUND_TOLERANCE * width)
    at_upper = free & (upper - solution <= BOUND_TOLERANCE * width)
    gradient = scaled.T @ (scaled @ (solution * scale) - target)
    violation = np.where(at_lower, -gradient, np.where(at_upper, gradient, np.abs(gradient)))
    size = float(np.linalg.norm(target)) or 1.0
    return ProvenMinimum(
        coefficients=solution,
        unbounded=unbounded,
        cost=criterion(r, solution),
        dual_residual=float(max(0.0, violation[free].max(initial=0.0)) / size),
        at_lower=at_lower,
        at_upper=at_upper,
        fixed=fixed,
        rank=_rank(singular_values),
        singular_values=singular_values,
        n_estimated=_rank(_singular_values(scaled[:, free & ~at_lower & ~at_upper])),
        rounding=ROUNDING_SHARE * size**2 / max(float(r[:, -3] @ r[:, -3]), 1.0),
    )


def _require_well_posed(r: Array, lower: Array, upper: Array) -> None:
    """Refuse a factor that cannot determine a minimum."""
    n, n_free = sample_count(r), int((lower < upper).sum())
    if n < max(n_free, 1):
        raise EstimationError(
            "too_few_samples", f"{n} samples are too few for {n_free} free coefficients"
        )


def _singular_values(matrix: Array) -> Array:
    return np.linalg.svd(matrix, compute_uv=False).astype(np.float64)


def _rank(singular_values: Array) -> int:
    return int((singular_values > RANK_TOLERANCE * singular_values.max(initial=0.0)).sum())


def _bounded_minimum(
    matrix: Array, target: Array, lower: Array, upper: Array, unbounded: Array
) -> Array:
    """Return minimum over the box: without bounds where that fits, else by active sets [1]_.

    SciPy's bounded solver stops on a small change of cost, so a coefficient whose box is tiny can
    end it far above the minimum. This search stops on nothing but the proof.
    """
    if not matrix.shape[1]:
        return np.empty(0)
    x = np.clip(unbounded, lower, upper)
    inside = (lower < unbounded) & (unbounded < upper)
    for _ in range(MOST_EXCHANGES):
        x, inside = _minimum_of_face(matrix, target, (lower, upper), x, inside)
        gradient = matrix.T @ (matrix @ x - target)
        pull = np.where(inside, 0.0, np.where(x == lower, -gradient, gradient))
        if pull.max() <= PULL_TOLERANCE * max(np.linalg.norm(target), np.abs(x).max()):
            break
        inside[np.argmax(pull)] = True
    return x


def _minimum_of_face(
    matrix: Array, target: Array, box: tuple[Array, Array], x: Array, inside: Mask
) -> tuple[Array, Mask]:
    """Go from x to the minimum over the coefficients inside, putting on its bound what meets it.

    By the least step, not to the least solution: with dependent columns only the step is sure to
    lead down, and so away from the bound that a coefficient was just let go from.
    """
    lower, upper = box
    x, inside = x.copy(), inside.copy()
    while inside.any():
        step = np.zeros_like(x)
        step[inside] = _least_norm(matrix[:, inside], target - matrix @ x)
        room = np.where(step < 0, lower - x, upper - x)
        beyond = inside & (np.abs(step) > np.abs(room))
        if not beyond.any():
            return np.clip(x + step, lower, upper), inside
        shares = np.full(len(x), np.inf)
        shares[beyond] = room[beyond] / step[beyond]
        first = int(np.argmin(shares))
        x = np.clip(x + shares[first] * step, lower, upper)
        x[first] = lower[first] if step[first] < 0 else upper[first]
        inside[first] = False
    return x, inside


def _least_norm(matrix: Array, target: Array) -> Array:
    return np.linalg.lstsq(matrix, target, rcond=RANK_TOLERANCE)[0].astype(np.float64)


@dataclass(frozen=True, slots=True)
class Fit:
    """A fitted motor."""

    motor: Motor  # the motor as declared
    proven_minimum: ProvenMinimum  # global minimum of the criterion: the published estimate

    @property
    def coefficients(self) -> Array:
        """θ: loss factors in the order of the columns, then the constant flow; shape (p + 1,)."""
        return self.proven_minimum.coefficients

    @property
    def unbounded(self) -> Array:
        """θ without its bounds, from which leakages are computed; shape (p + 1,)."""
        return self.proven_minimum.unbounded

    @property
    def coefficients_by_path(self) -> dict[str, float]:
        """Coefficient of each free path, and of the constant [unit of the path's coefficient]."""
        paths, values = self.motor.coefficient_paths, self.coefficients.tolist()
        return {path.name: value for path, value in zip(paths, values, strict=True) if path}


def fit(r: Array, motor: Motor) -> Fit:
    """Fit a motor's loss factors to the factor of its training samples, shape (c, c).

    Raises EstimationError if there are fewer samples than free coefficients.
    """
    return Fit(motor, certify(r, *motor.coefficient_bounds()))


# A start is at the minimum when its criterion is within this share of the proven minimum's.
AT_MINIMUM = 1e-4
# At e = 0 the derivative by e vanishes: a search that starts there never leaves.
ECCENTRICITY_NUDGE = 1e-3
# No more than rounding: without it the search divides 0 by 0 where the gradient vanishes exactly.
GRADIENT_TOLERANCE = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, slots=True)
class Start:
    """Outcome of a starting point."""

    cost: float  # V at the end [(l/min)²]
    # initial, final: values of the free parameters [µm, 1, m³ or l/min as the parameter's unit].
    initial: Array
    final: Array


@dataclass(frozen=True, slots=True)
class Search:
    """Ends of all starting points beside the proven minimum; no start where nothing is free."""

    proven_minimum: ProvenMinimum
    starts: tuple[Start, ...]

    @property
    def at_minimum(self) -> tuple[Start, ...]:
        """Starts whose criterion is within 1e-4 of the proven minimum's."""
        most = max(self.proven_minimum.cost * (1 + AT_MINIMUM), self.proven_minimum.rounding)
        return tuple(start for start in self.starts if start.cost <= most)

    @property
    def gap(self) -> float | None:
        """(V of the best start − V*) / V*; None without starts, or where V* is rounding."""
        if not self.starts or self.proven_minimum.cost <= self.proven_minimum.rounding:
            return None
        return min(start.cost for start in self.starts) / self.proven_minimum.cost - 1.0


def free_parameters(motor: Motor) -> tuple[Parameter, ...]:
    """Return the parameters that are estimated, in the order of the columns."""
    paths = (path for path in motor.coefficient_paths if path)
    return tuple(parameter for path in paths for parameter in path.parameters if parameter.is_free)


def coefficients_at(motor: Motor, free: Array) -> Array:
    """Return θ, shape (…, p + 1), at free parameters of shape (…, k)."""
    theta = np.zeros((*free.shape[:-1], len(motor.coefficient_paths)))
    taken = 0
    for row, path in enumerate(motor.coefficient_paths):
        if path is None:
            continue
        unknown = [parameter.is_free for parameter in path.parameters]
        own = slice(taken, taken + sum(unknown))
        values = np.empty((*free.shape[:-1], len(unknown)))
        values[...] = [parameter.value for parameter in path.parameters]
        values[..., unknown] = free[..., own]
        theta[..., row] = path.coefficient(values)
        taken = own.stop
    return theta


def points_of(parameters: Sequence[Parameter], count: int, generator: np.random.Generator) -> Array:
    """Return the configured point, then a Latin hypercube within the bounds, (W, parameters)."""
    lower = np.array([parameter.minimum for parameter in parameters])
    upper = np.array([parameter.maximum for parameter in parameters])
    configured = np.array([parameter.value for parameter in parameters])
    strata = np.tile(np.arange(count - 1), (len(parameters), 1))
    drawn = (
        generator.permuted(strata, axis=1).T + generator.random((count - 1, len(parameters)))
    ) / max(count - 1, 1)
    points = np.vstack([configured, lower + drawn * (upper - lower)])
    eccentric = np.array([parameter.name.startswith("e_") for parameter in parameters], dtype=bool)
    nudged: Array = np.where(eccentric & (points == 0.0), ECCENTRICITY_NUDGE, points)
    return np.clip(nudged, lower, upper)


def search(
    r: Array,
    motor: Motor,
    generator: np.random.Generator,
    *,
    starting_points: int = 10,
    step_tolerance: float = 1e-10,
    function_tolerance: float = 1e-10,
    maximum_iterations: int = 200,
) -> Search:
    """Minimise the criterion from each starting point, the configured first.

    `r` is the factor of the training samples, shape (c, c), columns as ``motor.columns``. MATLAB's
    own tolerances, 1e-6 and 1e-5, leave half of the starts short.
    """
    proven_minimum, free = certify(r, *motor.coefficient_bounds()), free_parameters(motor)
    if not free or not starting_points:
        return Search(proven_minimum, ())
    scale = np.sqrt(max(sample_count(r), 1))
    matrix, target = r[:, :-2] / scale, (r[:, -1] - r[:, -2]) / scale

    def residual(values: Array) -> Array:
        error: Array = matrix @ coefficients_at(motor, values) - target
        return error

    # Imported where it is needed: scipy.optimize is a tenth of what a worker loads.
    from scipy.optimize import least_squares

    starts = []
    for point in points_of(free, starting_points, generator):
        end = least_squares(
            residual,
            point,
            jac="3-point",
            bounds=(
                [parameter.minimum for parameter in free],
                [parameter.maximum for parameter in free],
            ),
            method="trf",
            x_scale="jac",
            xtol=step_tolerance,
            ftol=function_tolerance,
            gtol=GRADIENT_TOLERANCE,
            max_nfev=maximum_iterations,
        )
        starts.append(Start(criterion(r, coefficients_at(motor, end.x)), point, end.x))
    return Search(proven_minimum, tuple(starts))
