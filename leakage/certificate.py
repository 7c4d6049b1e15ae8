r"""The global minimum of the criterion, computed directly and with a proof.

In the loss factors K and the flushing C_f the model is linear and the bounds are a box, so

.. math:: \min_{l \le \theta \le u} \lVert A\theta - b \rVert^2

is convex: its minimum is global. The Karush–Kuhn–Tucker conditions prove it: the gradient is 0 in
every coefficient off its bounds and points outwards at a bound. The largest violation is reported
as the dual residual. This minimum is what is published; the multi-start search of the thesis
(3.5) then shows that it finds the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from leakage.block_statistics import criterion
from leakage.errors import EstimationError

Array = NDArray[np.float64]

# A column counts as dependent below this share of the largest singular value: rounding, not noise.
RANK_TOLERANCE = 1e-11
# Share of the column-scaled box within which a coefficient counts as lying on its bound.
BOUND_TOLERANCE = 1e-12


@dataclass(frozen=True, slots=True)
class Certificate:
    """The minimum of a box-bounded linear least squares problem, with its proof.

    Attributes
    ----------
    coefficients
        θ: loss factors in the order of the columns, then the constant flow; shape (p + 1,).
    cost
        V(θ) [(l/min)²].
    dual_residual
        Largest violation of the Karush–Kuhn–Tucker conditions, relative to ‖A_j‖ ‖b‖.
    at_lower, at_upper
        Coefficients that lie on a bound and are not fixed; shape (p + 1,).
    fixed
        Coefficients whose bounds are equal; shape (p + 1,).
    rank
        Rank of the free, column-scaled regressors.
    singular_values
        Of the free regressors, each column scaled to norm 1; largest first.
    """

    coefficients: Array
    cost: float
    dual_residual: float
    at_lower: NDArray[np.bool_]
    at_upper: NDArray[np.bool_]
    fixed: NDArray[np.bool_]
    rank: int
    singular_values: Array

    @property
    def condition_number(self) -> float:
        """Largest over smallest singular value; infinite for dependent columns, nan without any."""
        values = self.singular_values
        if not len(values):
            return float("nan")
        return float(values[0] / values[-1]) if values[-1] > 0 else float("inf")

    @property
    def n_free_off_bounds(self) -> int:
        """Number of coefficients that are estimated and off their bounds."""
        return int((~(self.fixed | self.at_lower | self.at_upper)).sum())


def certify(r: Array, lower: Array, upper: Array) -> Certificate:
    """Global minimum of the criterion over a box of coefficients.

    Parameters
    ----------
    r
        Factor of the training samples, shape (c, c), columns: paths, one, known, measured.
    lower, upper
        Bounds of θ, shape (c − 2,) [m³, l/min or 1 as the column]; equal bounds fix a coefficient.

    Returns
    -------
    Certificate
        Where the minimum is a set (dependent columns), its element of least norm in scaled
        columns if that lies in the box, else the one that the bounded solver ends at: both
        deterministic.

    Raises
    ------
    EstimationError
        If bounds are out of order or not finite, or the factor holds fewer samples than free
        coefficients.

    Examples
    --------
    A flow of exactly 2 per unit of the one regressor, with no constant flow:

    >>> z = np.array([[1.0, 1, 0, 2], [2, 1, 0, 4], [4, 1, 0, 8]])
    >>> from leakage.block_statistics import factor
    >>> certify(factor(z), np.array([0.0, 0.0]), np.array([9.0, 0.0])).coefficients.round(9)
    array([2., 0.])
    """
    lower, upper = np.asarray(lower, float), np.asarray(upper, float)
    if not (np.isfinite(lower).all() and np.isfinite(upper).all() and (lower <= upper).all()):
        raise EstimationError(
            "bounds", "bounds must be finite, each lower one at most its upper one"
        )
    fixed = lower == upper
    free = ~fixed
    if r[:, -3] @ r[:, -3] < max(int(free.sum()), 1) - 0.5:
        raise EstimationError("too_few_samples", "fewer samples than free coefficients")
    matrix, target = r[:, :-2], r[:, -1] - r[:, -2]
    remaining = target - matrix[:, fixed] @ lower[fixed]
    norms = np.linalg.norm(matrix, axis=0)
    scale = np.where(norms > 0, norms, 1.0)
    scaled = matrix / scale
    singular_values: Array = np.linalg.svd(scaled[:, free], compute_uv=False).astype(float)
    solution = lower.copy()
    box = (lower * scale)[free], (upper * scale)[free]
    solution[free] = _bounded_minimum(scaled[:, free], remaining, *box) / scale[free]
    solution = np.clip(solution, lower, upper)
    width = np.where(fixed, 1.0, upper - lower)
    at_lower = free & (solution - lower <= BOUND_TOLERANCE * width)
    at_upper = free & (upper - solution <= BOUND_TOLERANCE * width)
    gradient = scaled.T @ (scaled @ (solution * scale) - target)
    violation = np.where(at_lower, -gradient, np.where(at_upper, gradient, np.abs(gradient)))
    size = float(np.linalg.norm(target)) or 1.0
    return Certificate(
        coefficients=solution,
        cost=criterion(r, solution),
        dual_residual=float(max(0.0, violation[free].max(initial=0.0)) / size),
        at_lower=at_lower,
        at_upper=at_upper,
        fixed=fixed,
        rank=int((singular_values > RANK_TOLERANCE * singular_values.max(initial=0.0)).sum()),
        singular_values=singular_values,
    )


def _bounded_minimum(matrix: Array, target: Array, lower: Array, upper: Array) -> Array:
    """Minimum over the box: the unbounded one where it fits, else an active set, solved exactly."""
    if not matrix.shape[1]:
        return np.empty(0)
    unbounded = _least_norm(matrix, target)
    if ((lower <= unbounded) & (unbounded <= upper)).all():
        return unbounded
    bounded = lsq_linear(matrix, target, (lower, upper), method="bvls", tol=1e-15, max_iter=200)
    solution: Array = np.asarray(bounded.x, dtype=np.float64)
    inside = np.asarray(bounded.active_mask) == 0
    # The solver stops on a relative change of cost; given its active set, the rest is exact.
    exact = np.where(np.asarray(bounded.active_mask) > 0, upper, lower)
    exact[inside] = _least_norm(matrix[:, inside], target - matrix[:, ~inside] @ exact[~inside])
    fits = ((lower <= exact) & (exact <= upper)).all()
    return exact if fits else solution


def _least_norm(matrix: Array, target: Array) -> Array:
    return np.linalg.lstsq(matrix, target, rcond=RANK_TOLERANCE)[0].astype(np.float64)
