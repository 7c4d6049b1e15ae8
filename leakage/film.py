"""Film thickness ratio, lubrication regime and plausibility of gap heights.

References
----------
.. [1] N. Ydebäck, *Grey Box Model of Leakage in Radial Piston Hydraulic Motors*, Luleå University
   of Technology, 2021, sections 2.2.2 to 2.2.4 and 2.5.9.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from leakage.errors import ParameterError

LubricationRegime = Literal["boundary", "mixed", "elastohydrodynamic", "hydrodynamic"]
RegimeTable = Literal["[12]", "[13]"]
GapVerdict = Literal[
    "below_usual_films", "elastohydrodynamic_film", "hydrodynamic_film", "above_usual_films"
]

# Section 2.2.4 of the thesis, under its own reference numbers. [13] says "much less than 1" and
# "much greater than 6": read as below 1 and above 6, or it would leave ratios without a regime.
# [12] ends hydrodynamic lubrication at 100; a thicker film is no less hydrodynamic.
REGIME_TABLES: Mapping[RegimeTable, Mapping[LubricationRegime, tuple[float, float]]] = {
    "[12]": {
        "boundary": (0.0, 1.0),
        "mixed": (1.0, 5.0),
        "elastohydrodynamic": (3.0, 10.0),
        "hydrodynamic": (5.0, math.inf),
    },
    "[13]": {
        "boundary": (0.0, 1.0),
        "mixed": (1.0, 3.0),
        "elastohydrodynamic": (3.0, 10.0),
        "hydrodynamic": (6.0, math.inf),
    },
}

# Usual heights of films, sections 2.2.2 and 2.2.3 of the thesis, [m].
ELASTOHYDRODYNAMIC_MINIMUM_M = 0.5e-6
HYDRODYNAMIC_MINIMUM_M = 5e-6
HYDRODYNAMIC_MAXIMUM_M = 500e-6


def film_thickness_ratio(
    gap_m: ArrayLike, eccentricity: ArrayLike, roughness_1_m: float, roughness_2_m: float
) -> NDArray[np.float64]:
    r"""Film thickness ratio at the narrowest place of a gap.

    .. math:: \Lambda = \frac{h (1 - e)}{\sqrt{R_{a1}^2 + R_{a2}^2}}

    Parameters
    ----------
    gap_m
        Mean gap height h, shape (n,) or scalar, [m].
    eccentricity
        Eccentricity e, 0 for a concentric part to 1 for one that touches, shape (n,) or scalar,
        [-].
    roughness_1_m, roughness_2_m
        Mean roughness of the two surfaces, [m].

    Returns
    -------
    ndarray
        Λ, common shape of the arguments, [-].

    Raises
    ------
    ParameterError
        If a gap is negative, an eccentricity outside 0 to 1, or both surfaces perfectly smooth.

    Examples
    --------
    >>> round(float(film_thickness_ratio(10e-6, 0.4, 0.2e-6, 0.2e-6)), 2)
    21.21

    References
    ----------
    .. [1] N. Ydebäck, *Grey Box Model of Leakage in Radial Piston Hydraulic Motors*, 2021,
       section 2.2.4.
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


def lubrication_regimes(ratio: float, table: RegimeTable = "[12]") -> tuple[LubricationRegime, ...]:
    """Lubrication regimes to which a film thickness ratio belongs.

    Parameters
    ----------
    ratio
        Film thickness ratio Λ, [-]; not negative.
    table
        Which of the two tables of section 2.2.4, named as the thesis names its references.

    Returns
    -------
    tuple of str
        The regimes, thinnest film first: more than one where the table's ranges overlap.

    Raises
    ------
    ParameterError
        If the ratio is negative or nan, or the table unknown.

    Notes
    -----
    A range includes its lower end and excludes its upper end. The two tables differ between 3
    and 6.

    Examples
    --------
    >>> lubrication_regimes(4.0, "[12]")
    ('mixed', 'elastohydrodynamic')
    >>> lubrication_regimes(4.0, "[13]")
    ('elastohydrodynamic',)

    References
    ----------
    .. [1] N. Ydebäck, *Grey Box Model of Leakage in Radial Piston Hydraulic Motors*, 2021,
       section 2.2.4.
    """
    if table not in REGIME_TABLES:
        raise ParameterError(
            "film_table", f"table {table!r} is unknown; use one of {list(REGIME_TABLES)}"
        )
    if not ratio >= 0.0:
        raise ParameterError("film_ratio", f"a film thickness ratio of {ratio:g} is none")
    return tuple(
        regime
        for regime, (lowest, highest) in REGIME_TABLES[table].items()
        if lowest <= ratio < highest or ratio == highest == math.inf
    )


def gap_plausibility(gap_m: float) -> GapVerdict:
    """Verdict on a fitted gap height by the usual heights of lubrication films.

    Hydrodynamic films are 5 to 500 µm high, elastohydrodynamic ones 0.5 to 5 µm.

    Parameters
    ----------
    gap_m
        Gap height h, [m].

    Returns
    -------
    str
        ``"below_usual_films"``, ``"elastohydrodynamic_film"``, ``"hydrodynamic_film"`` or
        ``"above_usual_films"``.

    Raises
    ------
    ParameterError
        If the height is negative or nan.

    Notes
    -----
    5 µm itself counts as hydrodynamic. Worth as much as the geometry behind the gap height:
    nothing, where that is a placeholder.

    Examples
    --------
    >>> gap_plausibility(8e-6), gap_plausibility(0.1e-6)
    ('hydrodynamic_film', 'below_usual_films')

    References
    ----------
    .. [1] N. Ydebäck, *Grey Box Model of Leakage in Radial Piston Hydraulic Motors*, 2021,
       sections 2.2.2, 2.2.3 and 2.5.9.
    """
    if not gap_m >= 0.0:
        raise ParameterError("film_gap", f"a gap height of {gap_m:g} m is none")
    if gap_m < ELASTOHYDRODYNAMIC_MINIMUM_M:
        return "below_usual_films"
    if gap_m < HYDRODYNAMIC_MINIMUM_M:
        return "elastohydrodynamic_film"
    return "hydrodynamic_film" if gap_m <= HYDRODYNAMIC_MAXIMUM_M else "above_usual_films"
