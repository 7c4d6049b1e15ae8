"""Constants of the laws from points of a simulated curve: X of a gap, the polynomial over speed.

Source: the thesis, sections 3.1.1, 3.1.3 and 3.1.4.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike

from leakage.arrays import Array
from leakage.errors import CurveError

DEGREE = 5  # of the polynomial over speed
# A polynomial may undershoot points near 0 by the accuracy with which a plot can be read.
_TOLERATED_UNDERSHOOT = 0.01
_STEPS_OVER_RANGE = 1000


def fit_deformation_pressure(points: ArrayLike) -> float:
    r"""Return deformation constant X [Pa] of a gap from points (ΔP, h, Q) of a simulation.

    .. math:: Q = a\,h^3\,\Delta P\,e^{-3 \Delta P / X}

    by least squares in Q over a and X, from the straight line of ln(Q/(h³ ΔP)) over ΔP; (28) to
    (31) of the thesis. The simulation's viscosity is taken as constant and falls into a, as do
    count, geometry, eccentricity and the factor on h. The points, shape (n, 3), are in Pa, m and
    l/min, all above 0.

    Raises CurveError if there are fewer than 3 points or 2 pressures, a value is not above 0, or
    the gap does not close with pressure.

    Examples
    --------
    >>> pressure = np.array([20e5, 40e5, 80e5, 160e5])
    >>> flow = 1e-3 * pressure * np.exp(-3 * pressure / 120e5)
    >>> round(fit_deformation_pressure([(p, 8e-6, q) for p, q in zip(pressure, flow)]) / 1e5, 6)
    120.0
    """
    given = np.asarray(points, np.float64).reshape(-1, 3)
    _require_points(given, least=3, different=2, above_zero=True)
    # Scaled so that the search sees numbers near 1.
    pressure, gap, flow = (given / given.max(axis=0)).T
    undeformed = gap**3 * pressure
    slope, intercept = np.polyfit(pressure, np.log(flow / undeformed), 1)

    def deviation(unknowns: Array) -> Array:
        log_amplitude, decay = unknowns
        at = undeformed * np.exp(log_amplitude - decay * pressure)
        return np.asarray(at - flow, dtype=np.float64)

    # Imported where it is needed: scipy.optimize is a tenth of what a worker loads.
    from scipy.optimize import least_squares

    search = least_squares(
        deviation, [intercept, -slope], jac="3-point", xtol=1e-14, ftol=1e-14, gtol=1e-14
    )
    decay = float(search.x[1])
    if not search.success or decay <= 0.0:
        raise CurveError(
            "curve_without_deformation",
            "the simulated gap does not close with pressure; declare the path without a"
            " deformation constant, or check the order of the points' columns",
        )
    return float(3.0 * given[:, 0].max() / decay)


def fit_speed_curve(points: ArrayLike) -> tuple[float, ...]:
    r"""Return quintic over speed of a simulated curve, by least squares; (32) of the thesis.

    .. math:: f(\omega) = a \omega^5 + b \omega^4 + c \omega^3 + d \omega^2 + e \omega + f

    Coefficients have the highest power first. The points (ω, Q) of an interface, shape (n, 2), are
    in rpm and l/min, and not negative.

    Raises CurveError if there are fewer than 6 different speeds, a value is negative, or the
    polynomial turns negative between the points.

    Examples
    --------
    >>> curve = fit_speed_curve([(0, 1), (20, 2), (40, 3), (60, 4), (80, 5), (100, 6)])
    >>> [round(coefficient, 9) for coefficient in curve[-2:]]
    [0.05, 1.0]
    """
    given = np.asarray(points, np.float64).reshape(-1, 2)
    _require_points(given, least=DEGREE + 1, different=DEGREE + 1, above_zero=False)
    speed, flow = given.T
    # `fit` maps the speeds to -1 ... 1 first: powers of 125 rpm would cost six digits.
    polynomial = Polynomial.fit(speed, flow, DEGREE)
    between = np.linspace(speed.min(), speed.max(), _STEPS_OVER_RANGE + 1)
    values = polynomial(between)
    if values.min() < -_TOLERATED_UNDERSHOOT * flow.max():
        raise CurveError(
            "curve_undershoot",
            f"the fitted polynomial falls to {values.min():.3g} l/min at"
            f" {between[values.argmin()]:.4g} rpm; give more points there",
        )
    coefficients = np.zeros(DEGREE + 1)
    fitted = polynomial.convert().coef
    coefficients[: fitted.size] = fitted
    return tuple(coefficients[::-1].tolist())


def _require_points(points: Array, *, least: int, different: int, above_zero: bool) -> None:
    """Refuse points that are too few, or have values that a simulation cannot have."""
    bad = points <= 0.0 if above_zero else points < 0.0
    if bad.any() or not np.isfinite(points).all():
        bound = "above 0" if above_zero else "not negative"
        raise CurveError("curve_points", f"points of a simulated curve must be finite and {bound}")
    speeds = np.unique(points[:, 0]).size
    if len(points) < least or speeds < different:
        raise CurveError(
            "curve_points",
            f"a simulated curve needs {least} points, at {different} different pressures or"
            f" speeds; {len(points)} at {speeds} are given",
        )
