r"""All that the criterion needs of a block of samples: a small triangular matrix.

The samples enter the least squares criterion only through the columns of z: a regressor for each
path with a free coefficient, then 1, the known flow and the measured flow. With the QR
decomposition Z = QR of a block's samples,

.. math:: V(\theta) = \frac{1}{N} \lVert Z v(\theta) \rVert^2
                    = \frac{1}{N} \lVert R v(\theta) \rVert^2 ,\quad
          v(\theta) = (K_1, \dots, K_p, C_f, 1, -1)^T ,

exactly and at any parameters. Factors merge: R of two blocks is the R of the two R stacked. A
window of any length is therefore fitted from its blocks, without the samples, and blocks of many
nights merge. The decomposition is backward stable [1]_; the criterion is (20) of the thesis.

References
----------
.. [1] G. H. Golub and C. F. Van Loan, *Matrix Computations*, 4th ed., section 5.3, 2013.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from leakage.arrays import Array
from leakage.errors import StatisticsError


def factor(z: Array) -> Array:
    """Return triangular factor of a block of samples, shape (c, c), its diagonal not negative.

    `z` has the columns of n samples, shape (n, c): paths, one, known, measured. n may be 0.

    Raises StatisticsError if `z` is no matrix or holds a value that is not finite.

    Examples
    --------
    >>> factor(np.array([[3.0, 1.0], [4.0, 1.0]])).round(6)
    array([[5. , 1.4],
           [0. , 0.2]])
    """
    only: Array = factors(z, np.array([0, len(z)]))[0]
    return only


def factors(z: Array, borders: NDArray[np.int64]) -> Array:
    """Triangular factors of consecutive blocks of samples, shape (b, c, c), each as of `factor`.

    `borders` are the first row of each block and, last, the end; shape (b + 1,), not decreasing.
    """
    # Loaded with the first samples: commands that read tables alone do without it.
    from scipy.linalg.lapack import dgeqrf

    z = np.asarray(z, dtype=np.float64)
    if z.ndim != 2:
        raise StatisticsError("shape", f"samples must be a matrix, not of shape {z.shape}")
    columns = z.shape[1]
    found = np.zeros((len(borders) - 1, columns, columns))
    for block, begin, end in zip(found, borders[:-1], borders[1:], strict=True):
        if begin < end:
            r = dgeqrf(z[begin:end])[0][:columns]
            block[: len(r)] = r
    _require_finite("samples", found)
    return _positive(found)


def merge(factors_in_time_order: Array) -> Array:
    """Return factor of the union of blocks, from theirs of shape (b, c, c).

    Their order changes rounding only; keep it, so that runs agree to the bit.

    Raises StatisticsError if a factor holds a value that is not finite.
    """
    blocks, _, columns = factors_in_time_order.shape
    if blocks == 0:
        return np.zeros((columns, columns))
    _require_finite("factors", factors_in_time_order)
    merged: Array = _triangular(factors_in_time_order.reshape(1, -1, columns))[0]
    return merged


def with_free_known(factors: Array, place: int, coefficient: float) -> Array:
    """Return factors with the known flow as a path of its own, whose coefficient can be estimated.

    `factors`: Shape (b, c, c); those that are returned, in which nothing is known, (b, c + 1, c +
    1).
    `place, coefficient`: Of the new column among the paths, and with which the path is in the known
    flow.
    """
    moved = np.insert(factors, place, factors[:, :, -2] / coefficient, axis=2)
    moved[:, :, -2] = 0.0
    return _triangular(np.pad(moved, ((0, 0), (0, 1), (0, 0))))


def _require_finite(what: str, values: Array) -> None:
    if not np.isfinite(values).all():
        raise StatisticsError(
            "not_finite", f"{what} hold a value that is not finite; refuse it before"
        )


def _triangular(stacked: Array) -> Array:
    """Return r of each matrix of a stack."""
    return _positive(np.asarray(np.linalg.qr(stacked, mode="r")))


def _positive(decomposed: Array) -> Array:
    """Return upper triangles, with the signs that QR leaves open made positive."""
    signs = np.where(np.diagonal(decomposed, axis1=1, axis2=2) < 0, -1.0, 1.0)
    # Adding 0 turns -0 into 0: the same statistics have the same bytes.
    result: Array = np.triu(decomposed) * signs[:, :, None] + 0.0
    return result


def criterion(r: Array, coefficients: Array) -> float:
    """Mean squared prediction error V(θ), (20), from a factor [(l/min)²]; nan without samples."""
    n = sample_count(r)
    return float(squared_error(r, coefficients) / n) if n else float("nan")


def squared_error(r: Array, coefficients: Array) -> float:
    """Return sum of squared prediction errors ‖y − ŷ‖² [(l/min)²] from a factor."""
    residual = r @ np.concatenate([coefficients, (1.0, -1.0)])
    return float(residual @ residual)


def sample_count(r: Array) -> int:
    """Return number of samples behind a factor: the squared norm of the column of ones."""
    ones = r[:, -3]
    return round(float(ones @ ones))
