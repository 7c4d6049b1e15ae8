"""Fit a motor to the statistics of its samples: certificate, and the thesis's search if asked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leakage.estimation.certificate import Certificate, certify
from leakage.estimation.multi_start import (
    Parametrisation,
    SearchSettings,
    Start,
    at_minimum,
    search,
)
from leakage.physics.motor import Motor

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Fit:
    """A fitted motor."""

    motor: Motor  # the motor as declared
    certificate: Certificate  # global minimum of the criterion: the published estimate
    starts: tuple[Start, ...] = ()  # what came of each starting point of the search

    @property
    def coefficients(self) -> Array:
        """θ: loss factors in the order of the columns, then the constant flow; shape (p + 1,)."""
        return self.certificate.coefficients

    @property
    def unbounded(self) -> Array:
        """θ without its bounds, by which leakages are told; shape (p + 1,)."""
        return self.certificate.unbounded

    @property
    def coefficients_by_path(self) -> dict[str, float]:
        """Coefficient of each free path, and of the constant [unit of the path's coefficient]."""
        paths = Parametrisation.of(self.motor).paths
        values = self.coefficients.tolist()
        return {path.name: value for path, value in zip(paths, values, strict=True) if path}

    @property
    def starts_at_minimum(self) -> tuple[Start, ...]:
        """Starts whose criterion is within 1e-4 of the certificate's."""
        certificate = self.certificate
        reached = at_minimum(self.starts, certificate.cost, certificate.rounding)
        return tuple(start for start, there in zip(self.starts, reached, strict=True) if there)

    @property
    def certificate_gap(self) -> float | None:
        """(V of the best start − V*) / V*; None without one that ended, or where V* is rounding."""
        costs = [start.cost for start in self.starts if np.isfinite(start.cost)]
        if not costs or self.certificate.cost <= self.certificate.rounding:
            return None
        return min(costs) / self.certificate.cost - 1.0


def fit(
    r: Array,
    motor: Motor,
    settings: SearchSettings | None = None,
    generator: np.random.Generator | None = None,
) -> Fit:
    """Fit a motor's loss factors to the factor of its training samples, shape (c, c).

    Without settings of the search, and a source of its starting points, there is none.

    Raises
    ------
    EstimationError
        If there are fewer samples than free coefficients.
    """
    bounds = Parametrisation.of(motor).coefficient_bounds()
    certificate = certify(r, *bounds)
    if settings is None or generator is None:
        return Fit(motor, certificate)
    return Fit(motor, certificate, search(r, motor, settings, generator))
