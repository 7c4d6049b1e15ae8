"""The pressure difference at which a gap that closes with pressure leaks most.

References
----------
.. [1] N. Ydebäck, *Grey Box Model of Leakage in Radial Piston Hydraulic Motors*, Luleå University
   of Technology, 2021, sections 2.3.1 and 3.1.1.
"""

from __future__ import annotations

import math

from leakage.errors import ParameterError
from leakage.physics.oil import FilmPressure


def pressure_of_largest_leakage_pa(
    deformation_pressure_pa: float,
    pressure_viscosity_per_pa: float = 0.0,
    film_pressure: FilmPressure | None = None,
) -> float:
    r"""Pressure difference at which an annular gap with deformation leaks most.

    .. math:: \Delta P^* = \frac{1}{3/X + s\,\alpha} \;\text{(thesis)}, \qquad
        \frac{1}{\alpha} \ln\left(1 + \frac{\alpha X}{3}\right) \;\text{(slot)}, \qquad
        \frac{X}{3} \;\text{(constant viscosity)}

    Parameters
    ----------
    deformation_pressure_pa
        Deformation constant X, [Pa]; above 0.
    pressure_viscosity_per_pa
        Barus coefficient α, [1/Pa]; 0: constant viscosity.
    film_pressure
        Pressure at which the film's viscosity is taken; None: at no pressure, which is constant
        viscosity.

    Returns
    -------
    float
        ΔP*, [Pa].

    Raises
    ------
    ParameterError
        If X is not finite and above 0.

    Notes
    -----
    The zero of the derivative of exp(-3ΔP/X) ΔP/η by ΔP. Neither gap height nor temperature has
    an effect on it.

    Examples
    --------
    >>> round(pressure_of_largest_leakage_pa(120e5) / 1e5, 6)
    40.0
    >>> [round(pressure_of_largest_leakage_pa(120e5, 2e-8, FilmPressure(share=share)) / 1e5, 2)
    ...  for share in (1.0, 0.5)]
    [37.04, 38.46]

    References
    ----------
    .. [1] N. Ydebäck, *Grey Box Model of Leakage in Radial Piston Hydraulic Motors*, 2021,
       equations (1), (28) and (29).
    """
    if not 0.0 < deformation_pressure_pa < math.inf:
        raise ParameterError(
            "path_constant",
            f"a deformation constant of {deformation_pressure_pa:g} Pa is none; it must be finite"
            " and above 0",
        )
    closing_per_pa = 3.0 / deformation_pressure_pa
    alpha = pressure_viscosity_per_pa
    if film_pressure is None or alpha == 0.0:
        return 1.0 / closing_per_pa
    if film_pressure.model == "slot":
        return math.log1p(alpha / closing_per_pa) / alpha
    return 1.0 / (closing_per_pa + film_pressure.share * alpha)
