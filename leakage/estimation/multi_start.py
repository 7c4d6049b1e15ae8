r"""The search of the thesis: bounded least squares in gap heights and eccentricities (3.4, 3.5).

SciPy's trust-region-reflective method runs from several starting points over the triangular factor
of the samples. h and e of one path enter only as K ∝ h³(1 + 1.5e²): runs from different points end
at one minimum of the criterion with different (h, e). The starts therefore show that the thesis's
search agrees with the proven minimum, and how far the thesis's parameters spread at the minimum: an
audit, on request.

The optimiser sees µm and l/min, never metres: its step test is on an unscaled norm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leakage.arrays import Array
from leakage.estimation.block_statistics import criterion, sample_count
from leakage.estimation.proven_minimum import ProvenMinimum, certify
from leakage.physics.law import Parameter
from leakage.physics.motor import Motor

# A start is at the minimum when its criterion is within this share of the proven minimum's.
AT_MINIMUM = 1e-4
# At e = 0 the derivative by e vanishes: a search that starts there never leaves.
ECCENTRICITY_NUDGE = 1e-3
# No more than rounding: without one the search divides 0 by 0 where the gradient vanishes exactly.
GRADIENT_TOLERANCE = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, slots=True)
class Start:
    """Outcome of one starting point."""

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
        """(V of the best start − V*) / V*; None without one, or where V* is rounding."""
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
    """The configured point, then a Latin hypercube within the bounds, shape (W, parameters)."""
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
    """Minimise the criterion from each starting point, the configured one first.

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
        found = least_squares(
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
        starts.append(Start(criterion(r, coefficients_at(motor, found.x)), point, found.x))
    return Search(proven_minimum, tuple(starts))
