"""Film thickness ratio and the regimes of lubrication.

References
----------
.. [1] N. Ydebäck, *Grey Box Model of Leakage in Radial Piston Hydraulic Motors*, Luleå University
   of Technology, 2021, section 2.2.4.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from leakage.errors import ParameterError

LubricationRegime = Literal["boundary", "mixed", "elastohydrodynamic", "hydrodynamic"]

# Lowest and highest film thickness ratio: section 2.2.4 of the thesis, the table after its
# reference [12], in which the regimes overlap. It ends hydrodynamic lubrication at 100; a thicker
# film is no less hydrodynamic.
REGIMES: Mapping[LubricationRegime, tuple[float, float]] = {
    "boundary": (0.0, 1.0),
    "mixed": (1.0, 5.0),
    "elastohydrodynamic": (3.0, 10.0),
    "hydrodynamic": (5.0, math.inf),
}


def film_thickness_ratio(
    gap_m: ArrayLike, eccentricity: ArrayLike, roughness_1_m: float, roughness_2_m: float
) -> NDArray[np.float64]:
    r"""Film thickness ratio at the narrowest place of a gap, shape of the arguments, [-].

    .. math:: \Lambda = \frac{h (1 - e)}{\sqrt{R_{a1}^2 + R_{a2}^2}}

    with the mean gap height h, [m], the eccentricity e from 0 to 1, and the mean roughness of the
    two surfaces, [m]; section 2.2.4 of [1]_.

    Raises
    ------
    ParameterError
        If a gap is negative, an eccentricity outside 0 to 1, or both surfaces perfectly smooth.

    Examples
    --------
    >>> round(float(film_thickness_ratio(10e-6, 0.4, 0.2e-6, 0.2e-6)), 2)
    21.21
    """
    gap = np.asarray(gap_m, dtype=np.float64)
    closeness = 1.0 - np.asarray(eccentricity, dtype=np.float64)
    roughness = math.hypot(roughness_1_m, roughness_2_m)
    if np.any(gap < 0.0) or np.any((closeness < 0.0) | (closeness > 1.0)):
        raise ParameterError(
            "film_gap", "a film needs a gap height from 0 upwards and an eccentricity from 0 to 1"
        )
    if not 0.0 < roughness < math.inf or min(roughness_1_m, roughness_2_m) < 0.0:
        raise ParameterError(
            "film_roughness",
            f"roughness {roughness_1_m:g} m and {roughness_2_m:g} m: neither may be negative,"
            " and one must be above 0",
        )
    ratio: NDArray[np.float64] = gap * closeness / roughness
    return ratio
