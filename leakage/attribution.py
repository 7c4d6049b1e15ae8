r"""Which path a change of leakage comes from, if the data can tell.

The change of the leakage at given conditions is the sum of the changes of its paths,
:math:`\Delta Q = \sum_j r_j \Delta K_j`, with r the flow of each path per unit of its coefficient.
The changes of K have a joint covariance; that of K of balance pistons and sleeves is nearly
degenerate, as only the curvature over pressure tells them apart. The probability that path j
contributes most is

.. math:: P\big(r_j \Delta K_j > r_i \Delta K_i \;\; \forall i \ne j\big)

under a normal distribution of the changes, an orthant probability. Where no path is probable
enough, paths whose errors trade against each other are taken together and asked again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from leakage.autoregression import Array
from leakage.errors import ShapeError

Mask: TypeAlias = NDArray[np.bool_]
AttributionStatus: TypeAlias = Literal[
    "path", "together", "cannot_be_told_apart", "no_change", "no_path"
]

# A path, or paths together, are named from this probability on.
PROBABLE = 0.9
# Error correlation from which on the split between two paths is noise.
DEGENERATE = -0.9


@dataclass(frozen=True, slots=True)
class Attribution:
    """The path behind a change of leakage.

    Attributes
    ----------
    status
        ``path``; ``together``: paths whose split rests on noise, named as one;
        ``cannot_be_told_apart``; ``no_change``: the leakage of the paths has not certainly risen;
        ``no_path``: no path has a coefficient.
    paths
        Those named; all candidates where they cannot be told apart; empty without a change.
    probability
        That they contribute most; None without a change.
    contribution, lower, upper
        Rise of leakage by them, and its 95 % interval [unit of `flows` times that of the changes];
        of all paths where they cannot be told apart or have not changed.
    reason
        In words, wherever not a single path is named.
    """

    status: AttributionStatus
    paths: tuple[str, ...]
    probability: float | None
    contribution: float
    lower: float
    upper: float
    reason: str


def attribute(
    names: tuple[str, ...], flows: Array, changes: Array, covariance: Array
) -> Attribution:
    """Name the path whose growth explains a rise of leakage.

    Parameters
    ----------
    names
        Of the paths whose coefficient is known then and now, k of them.
    flows
        Flow of each path per unit of its coefficient at the conditions of the leakage, shape (k,).
    changes
        Coefficient now less that of the baseline, shape (k,).
    covariance
        Of the changes, shape (k, k): that of now, that of the baseline's mean, and what sensors may
        have drifted meanwhile.

    Returns
    -------
    Attribution
        Wear that leaks from port to port does not show in the drain: ``no_change`` is no proof of
        health.

    Raises
    ------
    ShapeError
        ``unequal_lengths``.

    Examples
    --------
    >>> names = ("ring", "piston", "sleeve")
    >>> flows, changes = np.ones(3), np.array([0.0, 0.1, 5.0])
    >>> found = attribute(names, flows, changes, np.diag([0.1, 1.0, 1.0]))
    >>> found.status, found.paths, found.probability > 0.99
    ('path', ('sleeve',), True)
    """
    k = len(names)
    if flows.shape != (k,) or changes.shape != (k,) or covariance.shape != (k, k):
        raise ShapeError(
            "unequal_lengths",
            f"{k} paths with flows {flows.shape}, changes {changes.shape} and covariance "
            f"{covariance.shape}; expected ({k},), ({k},) and ({k}, {k})",
        )
    if not k:
        return Attribution("no_path", (), None, 0.0, 0.0, 0.0, "no path has a known coefficient")
    rise, spread = flows * changes, covariance * np.outer(flows, flows)
    whole = _contribution(rise, spread, np.ones(k, dtype=np.bool_))
    if whole[1] <= 0.0:
        reason = "the leakage of the paths has not certainly risen: no change of external leakage"
        return Attribution("no_change", (), None, *whole, reason)
    groups: list[Mask] = [np.arange(k) == place for place in range(k)]
    probability = _probabilities(rise, spread, groups)
    best = int(np.argmax(probability))
    if probability[best] >= PROBABLE:
        return _named("path", names, groups[best], probability[best], rise, spread, "")
    joined, reason = _degenerate_joined(names, spread, groups)
    if len(joined) < len(groups):
        together = _probabilities(rise, spread, joined)
        best = int(np.argmax(together))
        if together[best] >= PROBABLE and joined[best].sum() > 1:
            return _named("together", names, joined[best], together[best], rise, spread, reason)
        groups, probability = joined, together
    candidates = np.any(
        [group for group, one in zip(groups, probability, strict=True) if one > 1.0 - PROBABLE],
        axis=0,
    )
    told = "; ".join(
        [f"no path is more than {100 * float(np.max(probability)):.0f} % probable"]
        + ([reason] if reason else [])
    )
    return Attribution(
        "cannot_be_told_apart",
        tuple(np.array(names)[candidates].tolist()),
        float(np.max(probability)),
        *whole,
        told,
    )


def _named(
    status: AttributionStatus,
    names: tuple[str, ...],
    group: Mask,
    probability: float,
    rise: Array,
    spread: Array,
    reason: str,
) -> Attribution:
    named = tuple(np.array(names)[group].tolist())
    return Attribution(
        status, named, float(probability), *_contribution(rise, spread, group), reason
    )


def _contribution(rise: Array, spread: Array, group: Mask) -> tuple[float, float, float]:
    """Summed rise of some paths, and its interval."""
    total = float(rise[group].sum())
    half = float(ndtri(0.975)) * float(np.sqrt(max(spread[np.ix_(group, group)].sum(), 0.0)))
    return total, total - half, total + half


def _probabilities(rise: Array, spread: Array, groups: list[Mask]) -> Array:
    """Probability of each group that it contributes more than any other."""
    sums = np.array(groups, dtype=np.float64)
    mean, covariance = sums @ rise, sums @ spread @ sums.T
    return np.array([_largest(mean, covariance, place) for place in range(len(groups))])


def _largest(mean: Array, covariance: Array, place: int) -> float:
    """P(contribution `place` exceeds all others)."""
    others = np.delete(np.arange(len(mean)), place)
    if not len(others):
        return 1.0
    contrast = np.zeros((len(others), len(mean)))
    contrast[:, place] = 1.0
    contrast[np.arange(len(others)), others] = -1.0
    lead, spread = contrast @ mean, contrast @ covariance @ contrast.T
    scale = np.sqrt(np.maximum(np.diag(spread), 0.0))
    certain = scale <= 0.0
    if np.any(lead[certain] <= 0.0):
        return 0.0
    lead, scale = lead[~certain], scale[~certain]
    if not len(lead):
        return 1.0
    standard = lead / scale
    if len(lead) == 1:
        return float(ndtr(standard[0]))
    # Imported where it is needed: scipy.stats takes longer to load than all of this package.
    from scipy.stats import multivariate_normal

    correlation = spread[np.ix_(~certain, ~certain)] / np.outer(scale, scale)
    distribution = multivariate_normal(
        np.zeros(len(lead)), correlation, allow_singular=True, seed=1
    )
    return float(distribution.cdf(standard))


def _degenerate_joined(
    names: tuple[str, ...], spread: Array, groups: list[Mask]
) -> tuple[list[Mask], str]:
    """Groups in which paths whose errors trade against each other are one, and why."""
    scale = np.sqrt(np.maximum(np.diag(spread), 0.0))
    scale[scale == 0.0] = 1.0
    correlation = spread / np.outer(scale, scale)
    joined, reasons = [group.copy() for group in groups], []
    for first in range(len(names)):
        for second in range(first + 1, len(names)):
            if correlation[first, second] > DEGENERATE:
                continue
            reasons.append(
                f"the split between {names[first]} and {names[second]} rests on noise (error "
                f"correlation {correlation[first, second]:.3f})"
            )
            held = [group for group in joined if group[first] or group[second]]
            joined = [group for group in joined if not (group[first] or group[second])]
            joined.append(np.any(held, axis=0))
    return joined, "; ".join(reasons)
