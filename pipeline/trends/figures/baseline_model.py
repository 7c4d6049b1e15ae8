"""The model of some nights together, from their statistics."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from leakage import LeakageError
from leakage.estimation.block_statistics import merge
from leakage.estimation.certificate import certify
from leakage.estimation.multi_start import Parametrisation
from pipeline.trends.nights.history import History

Array = NDArray[np.float64]


def bounds_of(history: History, places: NDArray[np.intp]) -> tuple[Array, Array]:
    """Lower and upper bound of θ as configured in the last of some nights."""
    motor = history.spec.motor(history.nights[int(places[-1])], history.spec.file.flushing.mode)
    return Parametrisation.of(motor).coefficient_bounds()


def baseline_model(history: History, places: NDArray[np.intp]) -> Array | None:
    """θ fitted to some nights together, from their statistics; shape (p + 1,).

    None where none has statistics, or they do not determine a minimum.
    """
    factors = history.factors(places)
    factors = factors[np.isfinite(factors).all(axis=(1, 2))]
    if not len(factors):
        return None
    try:
        theta: Array = certify(merge(factors), *bounds_of(history, places)).coefficients
    except LeakageError:
        return None
    return theta
