"""Motors that share their oil: what moves all of them, and what moves one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leakage.autoregression import Array
from leakage.errors import ShapeError

# Good nights that say how far something has moved.
NIGHTS_OF_NOW = 5


@dataclass(frozen=True, slots=True)
class PeerDeviations:
    """Each motor of an oil circuit against the others.

    Attributes
    ----------
    others
        Median of the logarithms of the other motors, shape (n, m); nan where none is known.
    deviation
        Logarithm of each motor less that, shape (n, m).
    n_others
        How many others were known, shape (n, m). With one, the deviation says that two motors
        diverge, and not which of them is the odd one.
    """

    others: Array
    deviation: Array
    n_others: NDArray[np.int64]

    def words(self, night: int, motor: int) -> str:
        """Meaning of a motor's deviation in a night, in words.

        Examples
        --------
        >>> peer_deviations(np.array([[0.1, 0.0]])).words(0, 0)
        'the two motors of the circuit diverge'
        """
        number = int(self.n_others[night, motor])
        if number == 0:
            return "no other motor of the circuit is known"
        if number == 1:
            return "the two motors of the circuit diverge"
        return f"against the median of {number} other motors of the circuit"


def peer_deviations(log_ratios: Array) -> PeerDeviations:
    r"""Deviation of each motor from the others of its circuit.

    .. math::
        d_i = \ln\frac{y_i}{\hat y_i} - \operatorname{median}_{j \ne i} \ln\frac{y_j}{\hat y_j}

    Parameters
    ----------
    log_ratios
        Logarithm of each motor's indicator over what its own baseline lets expect, shape (n nights,
        m motors); nan where it is not known.

    Returns
    -------
    PeerDeviations
        Oil, temperature and charge pressure cancel as far as they move all motors alike.

    Raises
    ------
    ShapeError
        ``shape``.

    Examples
    --------
    >>> found = peer_deviations(np.log([[1.2, 1.2, 1.2], [1.2, 1.2, 1.5]]))
    >>> np.exp(found.deviation).round(4).tolist()
    [[1.0, 1.0, 1.0], [0.8944, 0.8944, 1.25]]
    """
    if log_ratios.ndim != 2:
        raise ShapeError(
            "shape",
            f"log ratios of a circuit have {log_ratios.ndim} dimensions; expected nights by motors",
        )
    others, n_others = medians_of_others(log_ratios)
    return PeerDeviations(others, log_ratios - others, n_others)


def medians_of_others(values: Array) -> tuple[Array, NDArray[np.int64]]:
    """Median of each row without the entry itself, for every entry, from one sorting of the row.

    Parameters
    ----------
    values
        Shape (n, m) with m ≥ 1; nan where there is none.

    Returns
    -------
    medians
        Shape (n, m); nan where there is no other value.
    numbers
        Other values of each entry, shape (n, m).

    Examples
    --------
    >>> medians, numbers = medians_of_others(np.array([[1.0, 3.0, 8.0, np.nan]]))
    >>> medians.tolist(), numbers.tolist()
    ([[5.5, 4.5, 2.0, 3.0]], [[2, 2, 2, 3]])
    """
    # nan comes last.
    order = np.argsort(values, axis=1)
    ordered = np.take_along_axis(values, order, axis=1)
    places = np.broadcast_to(np.arange(values.shape[1]), values.shape)
    rank = np.empty_like(order)
    np.put_along_axis(rank, order, places, axis=1)
    known = ~np.isnan(values)
    numbers: NDArray[np.int64] = known.sum(axis=1, keepdims=True) - known

    def without_itself(place: NDArray[np.int64]) -> Array:
        moved = np.minimum(place + (place >= rank), values.shape[1] - 1)
        return np.take_along_axis(ordered, moved, axis=1)

    low, high = np.maximum(numbers - 1, 0) // 2, numbers // 2
    medians = (without_itself(low) + without_itself(high)) / 2
    return np.where(numbers > 0, medians, np.nan), numbers
