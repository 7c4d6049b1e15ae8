r"""The search of the thesis: bounded least squares in gap heights and eccentricities (3.4, 3.5).

SciPy's trust-region-reflective method runs from several starting points over the triangular factor
of the samples. h and e of one path enter only as K ∝ h³(1 + 1.5e²): runs from different points end
at one minimum of the criterion with different (h, e). The starts therefore show that the thesis's
search agrees with the certificate, and how far the thesis's parameters spread at the minimum: an
audit, on request.

The optimiser sees µm and l/min, never metres: its step test is on an unscaled norm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from leakage.estimation.block_statistics import criterion, sample_count
from leakage.physics.motor import Motor
from leakage.physics.paths import LeakagePath, Parameter

Array = NDArray[np.float64]

# A start is at the minimum when its criterion is within this share of the certificate's.
AT_MINIMUM = 1e-4
# At e = 0 the derivative by e vanishes: a search that starts there never leaves.
ECCENTRICITY_NUDGE = 1e-3
# No more than rounding: without one the search divides 0 by 0 where the gradient vanishes exactly.
GRADIENT_TOLERANCE = float(np.finfo(np.float64).eps)

FAILED = ("failed", "the residuals at the starting point are not finite")
# By SciPy's status.
ENDS = (
    ("iteration_limit", "the maximum number of iterations was used up"),
    ("gradient_tolerance", "the gradient vanishes"),
    ("function_tolerance", "the criterion changes by less than the tolerance"),
    ("step_tolerance", "the step is shorter than the tolerance"),
    (
        "function_and_step_tolerance",
        "criterion and step change by less than their tolerances",
    ),
)


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """Settings of the search under the names that MATLAB's lsqnonlin gives them.

    Attributes
    ----------
    starting_points
        W, the configured point first; 0 for no search.
    step_tolerance, function_tolerance
        Relative; 1e-10 (MATLAB's own 1e-6 and 1e-5 leave half of the starts short).
    maximum_iterations
        Evaluations of the criterion that a start may take.
    """

    starting_points: int = 10
    step_tolerance: float = 1e-10
    function_tolerance: float = 1e-10
    maximum_iterations: int = 200


@dataclass(frozen=True, slots=True)
class Start:
    """Outcome of one starting point; a failure is a row with its reason, not an exception."""

    number: int  # 0 for the configured point
    # status, reason: why the search stopped: one of `ENDS`, or ``failed``; and in words.
    status: str
    reason: str
    cost: float  # V at the end [(l/min)²]; nan where it failed
    iterations: int  # evaluations of the criterion
    # initial, final: values of the free parameters [µm, 1, m³ or l/min as the parameter's
    # unit].
    initial: Array
    final: Array


@dataclass(frozen=True, slots=True)
class Parametrisation:
    """The thesis's parameters, and how they make the coefficients of the columns."""

    # One for each coefficient: the column paths, then the constant (None: no constant flow).
    paths: tuple[LeakagePath | None, ...]

    @classmethod
    def of(cls, motor: Motor) -> Parametrisation:
        """The parametrisation of a motor, in the order of its columns."""
        return cls((*motor.column_paths, motor.constant))

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that are estimated, in the order of the columns."""
        return tuple(
            parameter
            for path in self.paths
            if path
            for parameter in path.parameters
            if parameter.is_free
        )

    def bounds(self) -> tuple[Array, Array]:
        """Bounds of the free parameters, each of shape (number of free parameters,)."""
        lower = np.array([parameter.minimum for parameter in self.free])
        return lower, np.array([parameter.maximum for parameter in self.free])

    def coefficient_bounds(self) -> tuple[Array, Array]:
        """Bounds of θ that those of the parameters imply, each of shape (p + 1,)."""
        limits = [path.coefficient_bounds() if path else (0.0, 0.0) for path in self.paths]
        lower, upper = zip(*limits, strict=True)
        return np.array(lower), np.array(upper)

    def coefficients(self, free: Array) -> Array:
        """θ, shape (…, p + 1), at free parameters of shape (…, k)."""
        theta = np.zeros((*free.shape[:-1], len(self.paths)))
        taken = 0
        for row, path in enumerate(self.paths):
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


def starting_points(
    parameters: Sequence[Parameter], count: int, generator: np.random.Generator
) -> Array:
    """The configured point, then a Latin hypercube within the bounds, shape (W, parameters).

    Examples
    --------
    >>> gap = Parameter("h", "um", 8.0, 1.0, 60.0)
    >>> points = starting_points([gap], 3, np.random.default_rng(1))
    >>> float(points[0, 0]), points.shape
    (8.0, (3, 1))
    """
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
    r: Array, motor: Motor, settings: SearchSettings, generator: np.random.Generator
) -> tuple[Start, ...]:
    """Minimise the criterion from each starting point; empty where nothing is free.

    `r` is the factor of the training samples, shape (c, c), columns as ``motor.columns``.
    """
    parametrisation = Parametrisation.of(motor)
    if not parametrisation.free or not settings.starting_points:
        return ()
    points = starting_points(parametrisation.free, settings.starting_points, generator)
    scale = np.sqrt(max(sample_count(r), 1))
    matrix, target = r[:, :-2] / scale, (r[:, -1] - r[:, -2]) / scale

    def residual(free: Array) -> Array:
        error: Array = matrix @ parametrisation.coefficients(free) - target
        return error

    return tuple(
        _start(
            number,
            point,
            lambda x: criterion(r, parametrisation.coefficients(x)),
            fun=residual,
            jac="3-point",
            bounds=parametrisation.bounds(),
            xtol=settings.step_tolerance,
            ftol=settings.function_tolerance,
            max_nfev=settings.maximum_iterations,
        )
        for number, point in enumerate(points)
    )


def _start(number: int, point: Array, cost_of: Callable[[Array], float], **problem: Any) -> Start:
    """One start as a row, whether it succeeds or not."""
    from scipy.optimize import least_squares

    if not np.isfinite(problem["fun"](point)).all():
        return Start(number, *FAILED, float("nan"), 1, point, point)
    found = least_squares(x0=point, method="trf", x_scale="jac", gtol=GRADIENT_TOLERANCE, **problem)
    return Start(number, *ENDS[found.status], cost_of(found.x), int(found.nfev), point, found.x)


def at_minimum(starts: Sequence[Start], minimum: float, rounding: float = 0.0) -> NDArray[np.bool_]:
    """Starts that ended at the minimum: V ≤ V*(1 + 1e-4), V* the certificate's."""
    costs = np.array([start.cost for start in starts])
    reached: NDArray[np.bool_] = costs <= max(minimum * (1 + AT_MINIMUM), rounding)
    return reached
