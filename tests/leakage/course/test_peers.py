"""Peers of an oil circuit."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from leakage.course.medians import row_medians
from leakage.course.peers import medians_of_others

NAN = np.nan


@given(
    arrays(
        np.float64,
        st.tuples(st.integers(1, 4), st.integers(2, 7)),
        # Ties are many.
        elements=st.sampled_from([NAN, -1.5, 0.0, 0.0, 2.0, 3.25]),
    )
)
def test_one_sorting_gives_what_leaving_out_each_gives(values: np.ndarray) -> None:
    medians, numbers = medians_of_others(values)
    for motor in range(values.shape[1]):
        rest = np.delete(values, motor, axis=1)
        assert np.array_equal(medians[:, motor], row_medians(rest), equal_nan=True)
        assert numbers[:, motor].tolist() == np.isfinite(rest).sum(axis=1).tolist()
