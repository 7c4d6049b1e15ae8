"""The oil in use: its curve between two analyses, and the grade that a change of flow suggests.

References
----------
.. [1] ASTM D341.
.. [2] ISO 3448, *Industrial liquid lubricants - ISO viscosity classification*.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from leakage.errors import ShapeError
from leakage.physics.oil import Oil, kinematic_viscosity_mm2_per_s
from leakage.physics.walther import walther_through

# Classes of ISO 3448: the viscosity at 40 °C [mm²/s].
ISO_VG = (10, 15, 22, 32, 46, 68, 100, 150, 220, 320, 460)
# ISO 3448 allows 10 % on either side.
WITHIN_GRADE = math.log(1.1)
# Standard deviation of the change with temperature between oils of one grade [1/K].
SLOPE_SD = 6e-4


def curve_between(
    day: float, days: Sequence[float], curves: Sequence[tuple[float, float]]
) -> tuple[float, float]:
    r"""Walther constants on a day between analyses; before the first and after the last, theirs.

    .. math:: \log\log Z = A - B \log T, \quad A = A_1 + s (A_2 - A_1), \; B = B_1 + s (B_2 - B_1)

    At each temperature :math:`\log \log Z` is then linear in time.

    Parameters
    ----------
    day
        The day, [d].
    days
        Days of the analyses, increasing, at least one, [d].
    curves
        A and B of each, [-].

    Returns
    -------
    tuple of float
        A and B, [-].

    Raises
    ------
    ShapeError
        If there is none, or their numbers differ.

    Examples
    --------
    >>> curve_between(5.0, [0.0, 10.0], [(9.0, 3.5), (9.2, 3.6)])
    (9.1, 3.55)
    """
    if not days or len(days) != len(curves):
        raise ShapeError("shape", f"{len(days)} days with {len(curves)} curves; expected as many")
    a, b = (float(np.interp(day, days, part)) for part in zip(*curves, strict=True))
    return a, b


def likely_grade(
    oil: Oil,
    temperature_c: float,
    log_factor: tuple[float, float],
    with_temperature: tuple[float, float] | None = None,
) -> int | None:
    r"""ISO grade whose filling would change all flows by a factor.

    .. math:: |\ln s - \ln r| \le \ln 1.1 + 2 \sigma_s, \quad
        |\beta - d \ln r / dT| \le 2 \sqrt{\sigma_\beta^2 + \sigma_b^2}, \quad r = \nu / \nu_g

    with the grade's viscosity at 40 °C, and the slope B of the oil.

    Parameters
    ----------
    oil
        The oil that is thought to be in the motor.
    temperature_c
        Mean temperature, [°C].
    log_factor
        ln s of the flows and its standard deviation, [-].
    with_temperature
        Change of the factor with temperature and its standard deviation, [1/K]; None: unknown.

    Returns
    -------
    int or None
        The grade; None if no other grade than the oil's own would.

    Examples
    --------
    VG 46 filled for VG 68 makes the flows 43 % larger at 50 °C.

    >>> from leakage.physics.walther import walther_coefficients
    >>> vg68 = Oil("VG 68", *walther_coefficients(40.0, 68.0, 100.0, 8.7), 882.0, 7e-4, 2e-8)
    >>> likely_grade(vg68, 50.0, (math.log(42.867 / 29.973), 0.02), (-0.0046, 0.0003))
    46
    """
    at = temperature_c + np.array([-1.0, 0.0, 1.0])
    own = np.log(kinematic_viscosity_mm2_per_s(at, oil.walther_a, oil.walther_b))
    nominal = float(kinematic_viscosity_mm2_per_s(40.0, oil.walther_a, oil.walther_b))
    log_s, error = log_factor
    for grade in ISO_VG:
        walther_a = walther_through(40.0, grade, oil.walther_b)
        ratio = own - np.log(kinematic_viscosity_mm2_per_s(at, walther_a, oil.walther_b))
        if abs(math.log(grade / nominal)) <= WITHIN_GRADE:
            continue
        if abs(log_s - ratio[1]) > WITHIN_GRADE + 2.0 * error:
            continue
        if with_temperature is None:
            return grade
        beta, of_beta = with_temperature
        if abs(beta - (ratio[2] - ratio[0]) / 2.0) <= 2.0 * math.hypot(of_beta, SLOPE_SD):
            return grade
    return None
