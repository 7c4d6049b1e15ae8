"""q-values of several tests, against SciPy's and those of the paper."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.stats import false_discovery_control

from leakage.course.false_discoveries import benjamini_hochberg


def test_q_values_are_scipys_and_leave_out_what_has_no_p() -> None:
    generator = np.random.default_rng(9)
    p = generator.uniform(0, 1, 40) ** 2
    assert benjamini_hochberg(p) == pytest.approx(false_discovery_control(p))
    with_gaps = np.insert(p, [0, 17], np.nan)
    found = benjamini_hochberg(with_gaps)
    assert np.isnan(found[[0, 18]]).all()
    assert found[np.isfinite(found)] == pytest.approx(benjamini_hochberg(p))
    assert np.isnan(benjamini_hochberg(np.full(3, np.nan))).all()


def test_q_values_of_the_paper() -> None:
    """Benjamini and Hochberg (1995), section 4.1: at 0.05 the first four of fifteen are told."""
    p = np.array(
        [
            *(0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344, 0.0459),
            *(0.3240, 0.4262, 0.5719, 0.6528, 0.7590, 1.0),
        ]
    )
    q = benjamini_hochberg(p)
    assert (q <= 0.05).tolist() == [True] * 4 + [False] * 11
    assert all(first <= second for first, second in itertools.pairwise(q))
