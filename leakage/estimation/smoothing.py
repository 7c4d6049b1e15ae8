"""Moving average of the samples' columns, after the regressors and within a block.

The model is linear in the loss factors: the same average on all columns leaves them unbiased, one
on the measured flow alone (as in the thesis, 3.3.2) does not (model.md, section 4).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

SECOND_US = 1_000_000


def smooth(
    z: Array,
    index: Ints,
    block: Ints,
    period_us: int,
    window_s: float,
    apply_to: Literal["all", "leakage"] = "all",
) -> Array:
    """Centred moving average of the columns, of which the last is the flow, over kept samples.

    Parameters
    ----------
    z, index, block
        Columns, shape (n, c), place on the time base and number of the block of each sample, (n,).
    period_us, window_s
        Period of the time base [µs]; length of the average [s], 0: none.
    apply_to
        ``all`` columns, or the flow alone (``leakage``).
    """
    half = round(window_s * SECOND_US) // (2 * period_us)
    if half == 0:
        return z
    row = np.arange(len(z))
    begins = np.flatnonzero(np.concatenate([[True], (np.diff(index) != 1) | (np.diff(block) != 0)]))
    segment = np.searchsorted(begins, row, side="right") - 1
    ends = np.append(begins[1:], len(z))
    first = np.maximum(row - half, begins[segment])
    last = np.minimum(row + half + 1, ends[segment])
    columns = slice(None) if apply_to == "all" else slice(-1, None)
    # Sums run afresh in each segment: over a whole night they would lose digits.
    chosen = z[:, columns]
    averaged = np.empty_like(chosen)
    for begin, end in zip(begins, ends, strict=True):
        sums = np.vstack([np.zeros(chosen.shape[1]), np.cumsum(chosen[begin:end], axis=0)])
        part = slice(begin, end)
        width = (last[part] - first[part])[:, None]
        averaged[part] = (sums[last[part] - begin] - sums[first[part] - begin]) / width
    result = z.copy()
    result[:, columns] = averaged
    return result
