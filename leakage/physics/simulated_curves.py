"""Constants of the laws from points of a simulated curve: X of a gap, the polynomial over speed.

Source: the thesis, sections 3.1.1, 3.1.3 and 3.1.4.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike, NDArray

from leakage.errors import CurveError

# A polynomial may undershoot points near 0 by the accuracy with which a plot can be read.
_TOLERATED_UNDERSHOOT = 0.01
_STEPS_OVER_RANGE = 1000


def fit_deformation_pressure(
    pressure_difference_pa: ArrayLike, gap_m: ArrayLike, flow_l_per_min: ArrayLike
) -> float:
    r"""Deformation constant X [Pa] of a gap from points (ΔP, h, Q) of a simulation.

    .. math:: Q = a\,h^3\,\Delta P\,e^{-3 \Delta P / X}

    by least squares in Q over a and X, from the straight line of ln(Q/(h³ ΔP)) over ΔP; (28) to
    (31) of the thesis. The simulation's viscosity is taken as constant and falls into a, as do
    count, geometry, eccentricity and the factor on h. All points are above 0, shape (n,).

    Raises CurveError if there are fewer than 3 points or 2 pressures, a value is not above 0, or
    the gap does not close with pressure.

    Examples
    --------
    >>> pressure = np.array([20e5, 40e5, 80e5, 160e5])
    >>> flow = 1e-3 * pressure * np.exp(-3 * pressure / 120e5)
    >>> round(fit_deformation_pressure(pressure, 8e-6, flow) / 1e5, 6)
    120.0
    """
    pressure, gap, flow = _points(
        pressure_difference_pa=pressure_difference_pa, gap_m=gap_m, flow_l_per_min=flow_l_per_min
    )
    for name, values in (("pressures", pressure), ("gap heights", gap), ("flows", flow)):
        if np.any(values <= 0.0):
            raise CurveError("curve_points", f"simulated {name} must be above 0; leave others out")
    _require_points(pressure, points=3, distinct=2, what="pressures for a deformation constant")

    # Scaled so that the search sees numbers near 1.
    scaled_pressure, scaled_gap = pressure / pressure.max(), gap / gap.max()
    scaled_flow, undeformed = flow / flow.max(), scaled_gap**3 * scaled_pressure

    slope, intercept = np.polyfit(scaled_pressure, np.log(scaled_flow / undeformed), 1)

    def deviation(unknowns: NDArray[np.float64]) -> NDArray[np.float64]:
        log_amplitude, decay = unknowns
        flow_at = undeformed * np.exp(log_amplitude - decay * scaled_pressure)
        return np.asarray(flow_at - scaled_flow, dtype=np.float64)

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
    return float(3.0 * pressure.max() / decay)


def fit_speed_curve(
    speed_rpm: ArrayLike, flow_l_per_min: ArrayLike, degree: int = 5
) -> tuple[float, ...]:
    r"""Polynomial over speed of a simulated curve, by least squares; (32) of the thesis.

    .. math:: f(\omega) = a \omega^5 + b \omega^4 + c \omega^3 + d \omega^2 + e \omega + f

    in the thesis, of degree 5; coefficients are returned with the highest power first. Speeds and
    flows of one interface are not negative, shape (n,).

    Raises CurveError if there are no more different speeds than the degree, a value is negative, or
    the polynomial turns negative between the points.

    Examples
    --------
    >>> found = fit_speed_curve([0.0, 50.0, 100.0], [1.0, 2.0, 3.0], degree=1)
    >>> [round(coefficient, 9) for coefficient in found]
    [0.02, 1.0]
    """
    speed, flow = _points(speed_rpm=speed_rpm, flow_l_per_min=flow_l_per_min)
    if degree < 0 or np.any(speed < 0.0) or np.any(flow < 0.0):
        raise CurveError(
            "curve_points", "degree, speeds and flows of a simulated curve must not be negative"
        )
    needed = degree + 1
    _require_points(speed, points=needed, distinct=needed, what=f"speeds for degree {degree}")

    # `fit` maps the speeds to -1 ... 1 first: powers of 125 rpm would cost six digits.
    polynomial = Polynomial.fit(speed, flow, degree)
    _require_no_undershoot(polynomial, speed, flow)
    coefficients = np.zeros(needed)
    fitted = polynomial.convert().coef
    coefficients[: fitted.size] = fitted
    return tuple(coefficients[::-1].tolist())


def _points(**columns: ArrayLike) -> tuple[NDArray[np.float64], ...]:
    """Columns of points as finite float64 vectors of one length; a scalar is every point's."""
    vectors = [np.atleast_1d(np.asarray(values, np.float64)) for values in columns.values()]
    try:
        vectors = list(np.broadcast_arrays(*vectors))
    except ValueError as error:
        raise CurveError(
            "curve_points", f"{', '.join(columns)} of a simulated curve differ in length"
        ) from error
    for name, vector in zip(columns, vectors, strict=True):
        if vector.ndim != 1 or not np.isfinite(vector).all():
            raise CurveError("curve_points", f"{name} of a simulated curve must be finite numbers")
    return tuple(vectors)


def _require_points(values: NDArray[np.float64], *, points: int, distinct: int, what: str) -> None:
    found = np.unique(values).size
    if values.size < points or found < distinct:
        raise CurveError(
            "curve_points",
            f"a simulated curve needs {points} points at {distinct} different {what};"
            f" {values.size} at {found} are given",
        )


def _require_no_undershoot(
    polynomial: Polynomial, speed_rpm: NDArray[np.float64], flow_l_per_min: NDArray[np.float64]
) -> None:
    between = np.linspace(speed_rpm.min(), speed_rpm.max(), _STEPS_OVER_RANGE + 1)
    values = polynomial(between)
    if values.min() < -_TOLERATED_UNDERSHOOT * flow_l_per_min.max():
        raise CurveError(
            "curve_undershoot",
            f"the fitted polynomial falls to {values.min():.3g} l/min at"
            f" {between[values.argmin()]:.4g} rpm; give more points there or a lower degree",
        )
