r"""Loss factors that change with the measured temperature: the sensor is not at the gap.

Where the temperature sensor sits away from the gaps, or the oil's curve is not the stated one, all
loss factors of the fit seem to change with temperature. To first order, with one b for all paths,

.. math:: y = \text{known} + C_f + \bigl(1 + b\,(T - T_0)\bigr) \sum_i K_i \varphi_i .

Of a block of samples only its factor and its mean temperature are kept, so T is the block's mean,
and b is the coefficient of one more column, :math:`(T_b - T_0) \sum K_i \varphi_i`, with the K of
the last pass. Its interval is cluster-robust (:mod:`leakage.estimation.uncertainty`), a cluster
being what shares its errors: the blocks of a night, or of some nights. A sensor that wanders from
night to night shows a b of its own, the larger the less the nights differ: the
interval holds it, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.special import stdtrit

from leakage.course.autoregression import Nights, correlation_to_previous, whitened
from leakage.estimation.block_statistics import merge
from leakage.estimation.uncertainty import cluster_robust

Array = NDArray[np.float64]

# ± of b where nothing is known of it (model.md, section 5) [1/K].
UNKNOWN_PER_KELVIN: Final = 0.01
# Wander of a temperature sensor from night to night [K], its memory, and what a kelvin that it is
# off moves the loss factors by (model.md, section 5: 4 to 13 %) [1/K].
WANDER_K: Final = 0.3
WANDER_PHI: Final = 0.6
K_PER_KELVIN: Final = 0.07
# ± at which b counts as known [1/K].
KNOWN_PER_KELVIN: Final = 0.003
# Nights that tell what b is now.
NIGHTS_OF_NOW: Final = 30
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

    @property
    def is_known(self) -> bool:
        """True if it is certain, or certainly small."""
        return self.is_certain or self.half_width <= KNOWN_PER_KELVIN

    @property
    def taken_off(self) -> float:
        """b as far as it is certain [1/K]."""
        return self.per_kelvin if self.is_certain else 0.0

    @property
    def left(self) -> float:
        """± of what is left of b once the certain part is taken off [1/K]."""
        return self.half_width + (0.0 if self.is_certain else abs(self.per_kelvin))

    def with_wander(self, variance: float) -> TemperatureCorrection:
        """The same, with the b of a sensor's wander over nights of some variance [K²] in its ±."""
        wander = K_PER_KELVIN * WANDER_K**2 / variance
        return replace(self, half_width=math.hypot(self.half_width, wander))

    def referred_to(self, reference_c: float) -> TemperatureCorrection:
        """The same straight line, relative to its value at another temperature.

        Examples
        --------
        >>> round(TemperatureCorrection(-0.01, 0.002, 50.0).referred_to(30.0).per_kelvin, 5)
        -0.00833
        """
        there = float(self.factor(reference_c))
        return TemperatureCorrection(self.per_kelvin / there, self.half_width / there, reference_c)

    def factor(self, temperature_c: Array | float) -> Array:
        """Loss factors at some temperature over those at T₀, shape of `temperature_c`."""
        return np.asarray(1.0 + self.per_kelvin * (np.asarray(temperature_c) - self.reference_c))


def temperature_correction(
    factors: Array,
    temperature_c: Array,
    clusters: NDArray[np.int64],
    coefficients: Array,
    active: NDArray[np.bool_],
    time: Array | None = None,
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
    time
        Of each block, in any unit, shape (m,): loss factors that grow evenly with it are no effect
        of temperature. None: they do not grow.

    Returns
    -------
    TemperatureCorrection or None
        None where temperature varied by less than 0.1 K, or fewer than two clusters have samples.

    Notes
    -----
    Holds for b (T − T₀) well below 1.
    """
    if np.ptp(temperature_c) < LEAST_SPAN_K:
        return None
    weights = np.sum(factors[:, :, -3] ** 2, axis=1)
    reference_c = float(np.average(temperature_c, weights=weights))
    above = temperature_c - reference_c
    above = np.stack([above] if time is None else [above, time - np.mean(time)], axis=-1)
    _, starts = np.unique(clusters, return_index=True)
    more = above.shape[1]
    theta = np.append(np.zeros(more), coefficients)
    free = np.append(np.ones(more, dtype=np.bool_), active)
    for _ in range(PASSES):
        changing = (factors[:, :, :-3] @ theta[more:-1])[:, :, None] * above[:, None]
        columns = np.concatenate([changing, factors], axis=2)
        # More rows, as a factor has as many as columns.
        columns = np.pad(columns, ((0, 0), (0, more), (0, 0)))
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


def temperature_response(
    factors: Array, coefficients: Array, active: NDArray[np.bool_], above_k: Array
) -> Array:
    """Change of a fit's coefficients with b: a night has no single temperature.

    Parameters
    ----------
    factors
        Factors of the fit's blocks, shape (m, c, c), columns: paths, one, known, measured.
    coefficients
        θ of the fit, shape (c − 2,).
    active
        Coefficients that it estimates, off their bounds, shape (c − 2,).
    above_k
        Mean temperature of each block above the night's [K], shape (m,).

    Returns
    -------
    ndarray
        dθ/db, shape (c − 2,): θ + b dθ/db is what the fit would find, to first order, if each block
        had its loss factors brought to the night's mean temperature.
    """
    columns = factors[:, :, :-2].reshape(-1, len(coefficients))[:, active]
    warming = above_k[:, None] * (factors[:, :, :-3] @ coefficients[:-1])
    scale = np.linalg.norm(columns, axis=0)
    scale[scale == 0.0] = 1.0
    found, *_ = np.linalg.lstsq(columns / scale, warming.ravel(), rcond=None)
    response = np.zeros(len(coefficients))
    response[active] = -found / scale
    return response


def latest_slopes(nights: Nights, ratio: Array, temperature_c: Array) -> tuple[Array, Array]:
    """Slope of a ratio over the nights' temperature, of the last 30 nights as of each.

    Beside a straight line in time, so that wear is no effect of a season's temperature; with errors
    that remember as the sensors' wander does.

    Parameters
    ----------
    nights
        Numbers of the nights, increasing, shape (n,).
    ratio, temperature_c
        Shape (n,); nights on which one is not finite do not count.

    Returns
    -------
    slope, half_width
        And of its 95 % interval [1/K], shape (n,) each; nan on nights that do not count or have
        fewer than 30, and where temperature varies too little beside its line in time to tell more
        than is known without them.
    """
    slope, half = np.full(len(nights), np.nan), np.full(len(nights), np.nan)
    known = np.flatnonzero(np.isfinite(ratio) & np.isfinite(temperature_c))
    if len(known) < NIGHTS_OF_NOW:
        return slope, half
    numbers = nights[known]
    columns = np.column_stack(
        [np.ones(len(known)), numbers - numbers[0], temperature_c[known], ratio[known]]
    )
    white = whitened(columns, correlation_to_previous(WANDER_PHI, numbers))
    windows = sliding_window_view(white, NIGHTS_OF_NOW, axis=0)
    r: Array = np.asarray(np.linalg.qr(windows.transpose(0, 2, 1), mode="r"))
    freedom = NIGHTS_OF_NOW - 3
    spread = np.abs(r[:, 2, 2]) / math.sqrt(freedom)
    varies = spread > LEAST_SPAN_K / NIGHTS_OF_NOW
    last = known[NIGHTS_OF_NOW - 1 :][varies]
    r, spread = r[varies], spread[varies]
    slope[last] = r[:, 2, 3] / r[:, 2, 2]
    scatter = float(stdtrit(freedom, 0.975)) * np.abs(r[:, 3, 3]) / freedom / spread
    half[last] = np.hypot(scatter, K_PER_KELVIN * WANDER_K**2 / spread**2)
    untold = ~(half <= UNKNOWN_PER_KELVIN)
    slope[untold], half[untold] = np.nan, np.nan
    return slope, half
