"""The moving average against a slow reference."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from leakage.estimation.blocks import smooth

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
STEP = 100_000


def slow_average(z: Floats, index: Ints, block: Ints, half: int) -> Floats:
    """The definition: the mean of all samples within reach that nothing stands between."""

    def reach(row: int, step: int) -> int:
        end = row
        while (
            0 <= end + step < len(z)
            and index[end + step] - index[end] == step
            and block[end + step] == block[row]
            and abs(index[end + step] - index[row]) <= half
        ):
            end += step
        return end

    return np.array([z[reach(row, -1) : reach(row, 1) + 1].mean(axis=0) for row in range(len(z))])


def some_samples(seed: int, n: int = 80) -> tuple[Floats, Ints, Ints]:
    rng = np.random.default_rng(seed)
    index = np.sort(rng.choice(round(1.15 * n), n, replace=False)).astype(np.int64)
    return rng.normal(0, 1, (n, 4)), index, index // 25


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.19, 0.2, 0.5, 2.0, 50.0]))
def test_as_the_slow_definition(seed: int, window_s: float) -> None:
    z, index, block = some_samples(seed)
    got = smooth(z, index, block, STEP, window_s)
    expected = slow_average(z, index, block, round(window_s * 1e6) // 2 // STEP)
    np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-13)
