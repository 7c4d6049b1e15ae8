r"""Bounded nonlinear least squares from many starting points at once.

The interior trust-region-reflective method of Branch, Coleman and Li [1]_ (MATLAB's ``lsqnonlin``,
SciPy's ``least_squares(method="trf")``), carried out for all starting points in one array
operation a step: a search over a small triangular factor then costs microseconds, not the
overhead of a thousand calls.

With the distance v of each variable to the bound that its gradient points to, steps are found in
the variables :math:`\hat p = D^{-1} p`, :math:`D = \operatorname{diag}(\sqrt{v})`, in which the
model of the criterion is

.. math:: m(\hat p) = \hat g^T \hat p + \tfrac12 \hat p^T (D J^T J D + C)\,\hat p ,\quad
          \lVert \hat p \rVert \le \Delta ,

C the diagonal that the change of v adds. A step that leaves the box is either shortened, reflected
at the first bound that it meets, or replaced by one along the gradient: whichever lowers m most.

References
----------
.. [1] M. A. Branch, T. F. Coleman and Y. Li, "A subspace, interior, and conjugate gradient method
   for large-scale bound-constrained minimization problems", *SIAM Journal on Scientific
   Computing*, 21(1), 1999.
.. [2] J. J. Moré, "The Levenberg–Marquardt algorithm: implementation and theory", *Numerical
   Analysis*, Lecture Notes in Mathematics 630, 1977.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ITERATION_LIMIT, GRADIENT, FUNCTION, STEP, FUNCTION_AND_STEP, FAILED = 0, 1, 2, 3, 4, -2
_GOING = -1

# A step stays this far inside of the bounds, and closer to them as the gradient vanishes.
INTERIOR = 0.995
# A starting point on a bound is moved inside by this share of the box.
INWARDS = 1e-10
SECULAR_ROUNDS = 10


@dataclass(frozen=True, slots=True)
class Tolerances:
    """Stopping tolerances of a search; names as in MATLAB.

    Attributes
    ----------
    step, function
        Relative step, and relative change of the criterion.
    gradient
        Largest component of the gradient, each scaled by the distance to its bound.
    evaluations
        Greatest number of evaluations of the residuals per start.
    """

    step: float
    function: float
    gradient: float
    evaluations: int


@dataclass(frozen=True, slots=True)
class Ends:
    """End points of the searches.

    Attributes
    ----------
    x
        Variables, shape (w, k).
    status
        Reason for the end of each, shape (w,): one of this module's constants.
    evaluations
        Number of evaluations of each, shape (w,).
    """

    x: Array
    status: NDArray[np.int64]
    evaluations: NDArray[np.int64]


@dataclass(slots=True)
class _Searches:
    """The state of searches that go on, a row each."""

    place: NDArray[np.int64]
    x: Array
    residual: Array
    jacobian: Array
    cost: Array
    radius: Array
    inverse_scale: Array

    def only(self, rows: Mask) -> _Searches:
        return _Searches(*(getattr(self, one.name)[rows] for one in fields(self)))


@dataclass(frozen=True, slots=True)
class _Model:
    """The quadratic model about each search's point, in scaled variables."""

    d: Array
    gradient: Array
    jacobian: Array
    curvature: Array
    interior: Array

    def value(self, step: Array) -> Array:
        """m of a step, shape (w,)."""
        a, b = self.along(step, np.zeros_like(step))
        return a + b

    def along(self, direction: Array, start: Array) -> tuple[Array, Array]:
        """Coefficients a, b of m(start + t direction) = a t² + b t + constant, shape (w,) each."""
        flow = np.einsum("wrk,wk->wr", self.jacobian, direction)
        base = np.einsum("wrk,wk->wr", self.jacobian, start)
        a = np.einsum("wr,wr->w", flow, flow) + np.sum(self.curvature * direction**2, axis=1)
        b = (
            np.sum(self.gradient * direction, axis=1)
            + np.einsum("wr,wr->w", flow, base)
            + np.sum(self.curvature * direction * start, axis=1)
        )
        return a / 2, b


# What is not finite fails a start, or loses a comparison; it never needs a warning.
@np.errstate(all="ignore")
def minimise(
    residual: Callable[[Array], Array],
    jacobian: Callable[[Array], Array],
    starts: Array,
    lower: Array,
    upper: Array,
    tolerances: Tolerances,
) -> Ends:
    """Minimise ½‖f(x)‖² within a box, from each starting point.

    Parameters
    ----------
    residual
        f of points of shape (m, k), as shape (m, r).
    jacobian
        ∂f/∂x of the same points, as shape (m, r, k).
    starts
        Starting points within the bounds, shape (w, k).
    lower, upper
        Finite bounds, each lower one below its upper one, shape (k,).
    tolerances
        When to end.

    Returns
    -------
    Ends
        A search whose residuals are not finite at its start has the status ``FAILED``.

    Examples
    --------
    >>> f = lambda x: np.column_stack([x[:, 0] ** 2 - 2.0])
    >>> j = lambda x: 2.0 * x[:, :, None]
    >>> stop = Tolerances(1e-12, 1e-12, 1e-14, 100)
    >>> ends = minimise(f, j, np.array([[3.0], [0.5]]), np.array([0.0]), np.array([9.0]), stop)
    >>> ends.x.round(6).ravel()
    array([1.414214, 1.414214])
    """
    x = np.clip(starts, lower + INWARDS * (upper - lower), upper - INWARDS * (upper - lower))
    ends = Ends(x.copy(), np.full(len(x), FAILED), np.ones(len(x), dtype=np.int64))
    values, slopes = residual(x), jacobian(x)
    sound = np.isfinite(values).all(axis=1) & np.isfinite(slopes).all(axis=(1, 2))
    norms = np.linalg.norm(slopes, axis=1)
    going = _Searches(
        place=np.arange(len(x)),
        x=x,
        residual=values,
        jacobian=slopes,
        cost=np.einsum("wr,wr->w", values, values) / 2,
        radius=np.zeros(len(x)),
        inverse_scale=np.where(norms > 0, norms, 1.0),
    ).only(np.asarray(sound))
    while len(going.place):
        model, optimality = _model(going, lower, upper)
        done = optimality < tolerances.gradient
        exhausted = ~done & (ends.evaluations[going.place] >= tolerances.evaluations)
        ends.status[going.place[done]] = GRADIENT
        ends.status[going.place[exhausted]] = ITERATION_LIMIT
        ends.x[going.place] = going.x
        rest = ~(done | exhausted)
        if not rest.all():
            going = going.only(rest)
            continue
        status = _advance(going, model, residual, jacobian, (lower, upper), tolerances, ends)
        ends.x[going.place] = going.x
        ends.status[going.place] = status
        going = going.only(np.asarray(status == _GOING))
    return ends


def _model(going: _Searches, lower: Array, upper: Array) -> tuple[_Model, Array]:
    """The model about each point, and the size of the gradient where it can still act."""
    gradient = np.einsum("wrk,wr->wk", going.jacobian, going.residual)
    to_upper = gradient < 0
    distance = np.where(to_upper, upper - going.x, going.x - lower)
    distance = np.where(gradient == 0.0, 1.0, distance)
    scale = 1.0 / going.inverse_scale
    d = np.sqrt(distance * going.inverse_scale) * scale
    curvature = np.abs(gradient) * scale
    optimality = np.max(np.abs(gradient) * distance, axis=1)
    size = np.linalg.norm(going.x / d, axis=1)
    first = np.where(size > 0, size, 1.0)
    going.radius = np.where(going.radius == 0.0, first, going.radius)
    model = _Model(
        d=d,
        gradient=d * gradient,
        jacobian=going.jacobian * d[:, None, :],
        curvature=curvature,
        interior=np.maximum(INTERIOR, 1.0 - optimality),
    )
    return model, optimality


def _advance(
    going: _Searches,
    model: _Model,
    residual: Callable[[Array], Array],
    jacobian: Callable[[Array], Array],
    box: tuple[Array, Array],
    tolerances: Tolerances,
    ends: Ends,
) -> NDArray[np.int64]:
    """Try one step of every search, in place; says of each why it ended, or that it goes on."""
    full = _trust_region_step(model, going.residual, going.radius)
    scaled, predicted = _step_in_box(going, model, full, box)
    inside = np.nextafter(*box), np.nextafter(*box[::-1])
    target = np.clip(going.x + model.d * scaled, *inside)
    ends.evaluations[going.place] += 1
    values = residual(target)
    cost = np.einsum("wr,wr->w", values, values) / 2
    cost[~np.isfinite(cost)] = np.inf
    reduction = going.cost - cost
    length = np.linalg.norm(scaled, axis=1)
    ratio = np.where(predicted > 0, reduction / predicted, 0.0)
    step = np.linalg.norm(target - going.x, axis=1)
    status = _ended(going, reduction, ratio, step, tolerances)
    at_edge = length > 0.95 * going.radius
    shrink, grow = (ratio < 0.25) | ~np.isfinite(cost), (ratio > 0.75) & at_edge
    sizes = [0.25 * length, 2.0 * going.radius]
    going.radius = np.select([shrink, grow], sizes, going.radius)
    better = reduction > 0
    going.x[better], going.residual[better] = target[better], values[better]
    going.cost[better] = cost[better]
    moved = better & (status == _GOING)
    if moved.any():
        going.jacobian[moved] = jacobian(going.x[moved])
        norms = np.linalg.norm(going.jacobian[moved], axis=1)
        going.inverse_scale[moved] = np.maximum(going.inverse_scale[moved], norms)
    return status


def _ended(
    going: _Searches, reduction: Array, ratio: Array, step: Array, tolerances: Tolerances
) -> NDArray[np.int64]:
    by_function = (reduction < tolerances.function * going.cost) & (ratio > 0.25)
    size = np.linalg.norm(going.x, axis=1)
    by_step = step < tolerances.step * (tolerances.step + size)
    return np.select(
        [by_function & by_step, by_function, by_step],
        [FUNCTION_AND_STEP, FUNCTION, STEP],
        default=_GOING,
    )


def _trust_region_step(model: _Model, residual: Array, radius: Array) -> Array:
    """Minimum of the model within the radius, by Moré's iteration on its multiplier [2]_."""
    w, _, k = model.jacobian.shape
    diagonal = np.zeros((w, k, k))
    diagonal[:, np.arange(k), np.arange(k)] = np.sqrt(model.curvature)
    stacked = np.concatenate([model.jacobian, diagonal], axis=1)
    u, s, vt = np.linalg.svd(stacked, full_matrices=False)
    against = np.einsum("wrk,wr->wk", u[:, : residual.shape[1]], residual)
    weighted = s * against
    threshold = np.finfo(np.float64).eps * stacked.shape[1] * s[:, :1]
    whole = s[:, -1] > threshold[:, 0]
    newton = np.where(s > threshold, against / s, 0.0)
    inside = whole & (np.linalg.norm(newton, axis=1) <= radius)
    high = np.linalg.norm(weighted, axis=1) / radius
    excess, slope = _secular(weighted, s, np.zeros(w), radius)
    low = np.where(whole, -excess / slope, 0.0)
    low = np.where(np.isfinite(low) & (low > 0.0), low, 0.0)
    alpha = np.maximum(0.001 * high, np.sqrt(low * high))
    for _ in range(SECULAR_ROUNDS):
        outside = (alpha < low) | (alpha > high)
        alpha = np.where(outside, np.maximum(0.001 * high, np.sqrt(low * high)), alpha)
        excess, slope = _secular(weighted, s, alpha, radius)
        high = np.where(excess < 0, alpha, high)
        correction = excess / slope
        low = np.maximum(low, alpha - correction)
        settled = np.abs(excess) < 0.01 * radius
        alpha = np.where(settled, alpha, alpha - (excess + radius) * correction / radius)
        if (settled | inside).all():
            break
    alpha = np.maximum(alpha, 0.0)
    bounded = weighted / np.maximum(s**2 + alpha[:, None], np.finfo(np.float64).tiny)
    length = np.linalg.norm(bounded, axis=1)
    bounded *= (radius / np.where(length > 0, length, 1.0))[:, None]
    coordinates = np.where(inside[:, None], newton, bounded)
    step: Array = -np.einsum("wkj,wk->wj", vt, coordinates)
    return step


def _secular(weighted: Array, s: Array, alpha: Array, radius: Array) -> tuple[Array, Array]:
    """‖p(α)‖ − Δ and its derivative."""
    denominator = np.maximum(s**2 + alpha[:, None], np.finfo(np.float64).tiny)
    length = np.linalg.norm(weighted / denominator, axis=1)
    safe = np.where(length > 0, length, 1.0)
    return length - radius, -np.sum(weighted**2 / denominator**3, axis=1) / safe


def _step_in_box(
    going: _Searches, model: _Model, full: Array, box: tuple[Array, Array]
) -> tuple[Array, Array]:
    """The best of the shortened, the reflected and the gradient step; and what it promises."""
    room, hit = _to_bound(going.x, model.d * full, *box)
    fits = room > 1.0
    shortened = full * np.where(fits, 1.0, room)[:, None]
    reflected = _reflected(going, model, shortened, np.where(hit, -full, full), room, box)
    cut = shortened * np.where(fits, 1.0, model.interior)[:, None]
    candidates = np.stack([cut, reflected, _downhill(going, model, box)])
    values = np.stack([model.value(step) for step in candidates])
    values = np.where(np.isfinite(values), values, np.inf)
    values[1:, fits] = np.inf
    best = np.argmin(values, axis=0), np.arange(len(full))
    return candidates[best], -values[best]


def _to_bound(x: Array, step: Array, lower: Array, upper: Array) -> tuple[Array, Mask]:
    """Multiple of a step at which it meets a bound, and the bounds that it then meets."""
    times = np.maximum((lower - x) / step, (upper - x) / step)
    times = np.where(step == 0.0, np.inf, times)
    room = times.min(axis=1)
    return room, times == room[:, None]


def _reflected(
    going: _Searches,
    model: _Model,
    shortened: Array,
    mirrored: Array,
    room: Array,
    box: tuple[Array, Array],
) -> Array:
    """From the bound that the full step meets, on along the step mirrored there."""
    to_edge = _to_edge(shortened, mirrored, going.radius)
    on_bound = going.x + model.d * shortened
    to_next, _ = _to_bound(on_bound, model.d * mirrored, *box)
    longest = np.where(to_next < to_edge, model.interior * to_next, to_edge)
    reach = np.minimum(to_next, to_edge)
    shortest = np.where(reach > 0, (1.0 - model.interior) * room / reach, 0.0)
    a, b = model.along(mirrored, shortened)
    stride = _lowest(a, b, shortest, longest)
    available = (reach > 0) & (shortest <= longest)
    step: Array = np.where(available[:, None], shortened + stride[:, None] * mirrored, np.nan)
    return step


def _downhill(going: _Searches, model: _Model, box: tuple[Array, Array]) -> Array:
    """Along the negative gradient, to the lowest point within radius and box."""
    direction = -model.gradient
    length = np.linalg.norm(direction, axis=1)
    to_edge = going.radius / np.where(length > 0, length, 1.0)
    to_bound, _ = _to_bound(going.x, model.d * direction, *box)
    longest = np.where(to_bound < to_edge, model.interior * to_bound, to_edge)
    a, b = model.along(direction, np.zeros_like(direction))
    step: Array = _lowest(a, b, np.zeros_like(longest), longest)[:, None] * direction
    return step


def _to_edge(start: Array, direction: Array, radius: Array) -> Array:
    """Positive stride at which start + t direction leaves the trust region."""
    a = np.einsum("wk,wk->w", direction, direction)
    b = np.einsum("wk,wk->w", start, direction)
    c = np.minimum(np.einsum("wk,wk->w", start, start) - radius**2, 0.0)
    root = np.sqrt(b * b - a * c)
    result: Array = np.where(
        b > 0, -c / np.maximum(b + root, 1e-300), (root - b) / np.maximum(a, 1e-300)
    )
    return result


def _lowest(a: Array, b: Array, least: Array, most: Array) -> Array:
    """Point between two limits at which a t² + b t is lowest."""
    inner = np.clip(-b / (2 * a), least, most)
    ends = np.stack([least, most, np.where((a > 0) & np.isfinite(inner), inner, least)])
    values = a * ends**2 + b * ends
    result: Array = ends[np.argmin(values, axis=0), np.arange(len(a))]
    return result
