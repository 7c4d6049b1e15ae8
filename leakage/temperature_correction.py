r"""Loss factors that change with the measured temperature: the sensor is not at the gap.

Where the temperature sensor sits away from the gaps, or the oil's curve is not the stated one, all
loss factors of the fit seem to change with temperature. To first order, with one b for all paths,

.. math:: y = \text{known} + C_f + \bigl(1 + b\,(T - T_0)\bigr) \sum_i K_i \varphi_i .

Of a block of samples only its factor and its mean temperature are kept, so T is the block's mean,
and b is the coefficient of one more column, :math:`(T_b - T_0) \sum K_i \varphi_i`, with the K of
the last pass. Its interval is cluster-robust (:mod:`leakage.uncertainty`), a cluster being what
shares its errors: the blocks of a night, or of some nights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leakage.block_statistics import merge
from leakage.uncertainty import cluster_robust

Array = NDArray[np.float64]

# The column of b holds K, so it is made anew from the K of the pass before; three agree to 1e-6.
PASSES = 3
LEAST_SPAN_K = 0.1


@dataclass(frozen=True, slots=True)
class TemperatureCorrection:
    """Relative change of all loss factors with temperature.

    Attributes
    ----------
    per_kelvin
        b [1/K].
    half_width
        Of its 95 % interval [1/K].
    reference_c
        T₀, the samples' mean temperature [°C].
    """

    per_kelvin: float
    half_width: float
    reference_c: float

    @property
    def is_certain(self) -> bool:
        """True if the interval excludes zero change."""
        return abs(self.per_kelvin) > self.half_width

    def factor(self, temperature_c: Array | float) -> Array:
        """Loss factors at some temperature over those at T₀, shape of `temperature_c`."""
        return np.asarray(1.0 + self.per_kelvin * (np.asarray(temperature_c) - self.reference_c))

    def referred_to(self, reference_c: float) -> TemperatureCorrection:
        """The same straight line, relative to its value at another temperature.

        Examples
        --------
        >>> round(TemperatureCorrection(-0.01, 0.002, 50.0).referred_to(30.0).per_kelvin, 5)
        -0.00833
        """
        there = float(self.factor(reference_c))
        return TemperatureCorrection(self.per_kelvin / there, self.half_width / there, reference_c)


def temperature_correction(
    factors: Array,
    temperature_c: Array,
    clusters: NDArray[np.int64],
    coefficients: Array,
    active: NDArray[np.bool_],
) -> TemperatureCorrection | None:
    """Estimate b from blocks of samples.

    Parameters
    ----------
    factors
        Triangular factors, shape (m, c, c), columns: paths, one, known, measured.
    temperature_c
        Mean temperature of each block [°C], shape (m,).
    clusters
        Label of what shares its errors, shape (m,), increasing.
    coefficients
        θ of a fit of all blocks, shape (c − 2,): K of the paths, and the flushing.
    active
        Coefficients to estimate with b; the others are held, such as those at a bound or fixed;
        shape (c − 2,).

    Returns
    -------
    TemperatureCorrection or None
        None where temperature varied by less than 0.1 K, or fewer than two clusters have samples.

    Notes
    -----
    Holds for b (T − T₀) well below 1. What makes K change in step with temperature by another
    cause, such as wear in a year that gets warmer, is counted as b.
    """
    if np.ptp(temperature_c) < LEAST_SPAN_K:
        return None
    weights = np.sum(factors[:, :, -3] ** 2, axis=1)
    reference_c = float(np.average(temperature_c, weights=weights))
    above = (temperature_c - reference_c)[:, None]
    _, starts = np.unique(clusters, return_index=True)
    theta = np.append(0.0, coefficients)
    free = np.append(True, active)
    for _ in range(PASSES):
        warming = above * (factors[:, :, :-3] @ theta[1:-1])
        columns = np.concatenate([warming[:, :, None], factors], axis=2)
        # A row more, as a factor has as many as columns.
        columns = np.pad(columns, ((0, 0), (0, 1), (0, 0)))
        by_cluster = np.stack([merge(part) for part in np.split(columns, starts[1:])])
        whole = merge(by_cluster)
        target = -(whole @ np.concatenate([np.where(free, 0.0, theta), (1.0, -1.0)]))
        scale = np.linalg.norm(whole[:, :-2], axis=0)
        chosen = free & (scale > 0.0)
        found, *_ = np.linalg.lstsq(whole[:, :-2][:, chosen] / scale[chosen], target, rcond=None)
        theta[chosen] = found / scale[chosen]
    distribution = cluster_robust(by_cluster, theta, chosen)
    interval = None if distribution is None else distribution.interval(np.eye(len(theta))[0])
    if interval is None:
        return None
    return TemperatureCorrection(float(theta[0]), interval.half_width, reference_c)
