"""Peers of an oil circuit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from leakage.errors import ShapeError
from leakage.medians import row_medians
from leakage.peers import medians_of_others, peer_deviations

NAN = np.nan


def test_what_moves_all_motors_alike_is_no_deviation() -> None:
    generator = np.random.default_rng(1)
    own = generator.standard_normal((50, 4))
    common = generator.standard_normal((50, 1))
    assert peer_deviations(own + common).deviation == pytest.approx(peer_deviations(own).deviation)


def test_the_median_of_the_others_is_taken_each_time_without_the_motor_itself() -> None:
    found = peer_deviations(np.array([[0.0, 1.0, 10.0, 100.0]]))
    assert found.others.tolist() == [[10.0, 10.0, 1.0, 1.0]]
    assert found.deviation.tolist() == [[-10.0, -9.0, 9.0, 99.0]]
    assert found.n_others.tolist() == [[3, 3, 3, 3]]


def test_wear_of_one_of_three_leaves_the_others_where_they_are() -> None:
    """The others of a healthy motor are one healthy and one worn motor: it moves by half."""
    found = peer_deviations(np.log([[1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.3]]))
    assert found.deviation[1] == pytest.approx([0.0, 0.0, 0.0, np.log(1.3)])


def test_motors_that_are_not_known_do_not_count() -> None:
    found = peer_deviations(np.array([[0.1, NAN, 0.3], [0.1, NAN, NAN], [NAN, NAN, NAN]]))
    assert found.deviation[0, 0] == pytest.approx(-0.2)
    assert np.isnan(found.deviation[0, 1])
    assert found.others[1].tolist()[1:] == [0.1, 0.1]
    assert np.isnan(found.deviation[1, 0])
    assert np.isnan(found.others[2]).all()
    assert found.n_others.tolist() == [[1, 2, 1], [0, 1, 1], [0, 0, 0]]


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


def test_words_say_how_much_a_deviation_is_worth() -> None:
    found = peer_deviations(
        np.array([[0.0, 0.1, NAN, NAN], [0.0, 0.1, 0.2, 0.3], [0.0, NAN, NAN, NAN]])
    )
    assert found.words(0, 0) == "the two motors of the circuit diverge"
    assert found.words(1, 0) == "against the median of 3 other motors of the circuit"
    assert found.words(2, 0) == "no other motor of the circuit is known"


def test_a_circuit_of_one_has_no_peers() -> None:
    found = peer_deviations(np.zeros((5, 1)))
    assert np.isnan(found.deviation).all()
    with pytest.raises(ShapeError):
        peer_deviations(np.zeros(5))
