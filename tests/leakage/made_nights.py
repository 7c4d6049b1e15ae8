"""Nightly indicators made for tests, and baselines whose figures are given."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from leakage.course.baseline import Baseline

Array = NDArray[np.float64]


def autoregression(n: int, phi: float, generator: np.random.Generator) -> Array:
    """Stationary, of unit variance, by its own definition."""
    values = np.empty(n)
    values[0] = generator.standard_normal()
    for night in range(1, n):
        fresh = generator.standard_normal() * math.sqrt(1 - phi**2)
        values[night] = phi * values[night - 1] + fresh
    return values


def known_baseline(
    mean: float = 0.0, sd: float = 1.0, phi: float = 0.0, mean_error: float = 0.0, n: int = 60
) -> Baseline:
    """A baseline that ends with night −1."""
    return Baseline(
        status="frozen",
        first_night=-n,
        last_night=-1,
        n=n,
        mean=mean,
        sd=sd,
        phi=phi,
        floored_sd=sd,
        floored_phi=phi,
        mean_error=mean_error,
        floored_mean_error=mean_error,
        sloped=False,
        reason="",
    )
