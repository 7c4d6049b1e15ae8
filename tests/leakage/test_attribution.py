"""Which path: probabilities by draws, and what is said where the data cannot tell."""

from __future__ import annotations

import numpy as np
import pytest

from leakage.attribution import attribute
from leakage.errors import ParameterError, ShapeError

NAMES = ("piston_ring", "balance_piston", "balance_sleeve")
# Shares of the reference leakage of the placeholders' CB560, as flows at K = 1.
FLOWS = np.array([0.011, 0.340, 0.489])
# Relative errors of K of pistons and sleeves trade against each other.
CORRELATION = np.array([[1.0, 0.7, -0.75], [0.7, 1.0, -0.985], [-0.75, -0.985, 1.0]])


def covariance(sd: np.ndarray) -> np.ndarray:
    return CORRELATION * np.outer(sd, sd)


@pytest.mark.parametrize("seed", range(4))
def test_probabilities_are_those_of_draws(seed: int) -> None:
    generator = np.random.default_rng(seed)
    root = generator.standard_normal((3, 3))
    changes = generator.uniform([1.5, 0.0, 0.0], [2.0, 0.9, 0.9])
    spread = 0.05 * root @ root.T + 0.2 * np.eye(3)
    found = attribute(NAMES, np.ones(3), changes, spread)
    draws = generator.multivariate_normal(changes, spread, size=200_000)
    share = np.bincount(draws.argmax(axis=1), minlength=3) / 200_000
    assert found.status in {"path", "cannot_be_told_apart"}
    assert found.probability == pytest.approx(share.max(), abs=0.005)


def test_four_paths_are_asked_the_same_way_every_time() -> None:
    names = (*NAMES, "distributor")
    spread = np.full((4, 4), 0.3) + 0.7 * np.eye(4)
    changes = np.array([1.9, 1.5, 1.2, 1.0])
    first, second = (attribute(names, np.ones(4), changes, spread) for _ in range(2))
    draws = np.random.default_rng(1).multivariate_normal(changes, spread, size=200_000)
    assert first == second
    assert first.probability == pytest.approx(np.mean(draws.argmax(axis=1) == 0), abs=0.005)


def test_a_sleeve_that_is_damaged_is_named() -> None:
    """+15 % gap is +52 % of K_s; nights know K within some percent."""
    found = attribute(NAMES, FLOWS, np.array([0.0, 0.0, 0.52]), covariance(np.full(3, 0.03)))
    assert (found.status, found.paths) == ("path", ("balance_sleeve",))
    assert found.probability > 0.99
    assert found.contribution == pytest.approx(0.52 * 0.489)
    assert found.lower < found.contribution < found.upper
    assert found.reason == ""


def test_pistons_and_sleeves_are_taken_together_where_their_split_rests_on_noise() -> None:
    """Their sum is known within 2 %, their split hardly at all."""
    changes = np.array([0.02, 0.25, 0.20])
    found = attribute(NAMES, FLOWS, changes, covariance(np.array([0.1, 0.5, 0.35])))
    assert found.status == "together"
    assert found.paths == ("balance_piston", "balance_sleeve")
    assert found.probability > 0.9
    assert found.reason == (
        "the split between balance_piston and balance_sleeve rests on noise (error correlation "
        "-0.985)"
    )


def test_paths_that_have_all_certainly_grown_are_all_named() -> None:
    """Dirty oil: pistons and sleeves each +20 % gap, +73 % of K; the rings not at all."""
    changes, spread = np.array([0.0, 0.73, 0.73]), covariance(np.full(3, 0.02))
    found = attribute(NAMES, FLOWS, changes, spread)
    assert (found.status, found.paths) == ("several", ("balance_piston", "balance_sleeve"))
    assert found.probability > 0.99
    assert found.contribution == pytest.approx(0.73 * (0.340 + 0.489))


def test_the_probability_of_several_is_that_of_draws() -> None:
    changes = np.array([1.0, 1.2, 0.3])
    spread = 0.05 * np.array([[1.0, 0.4, 0.2], [0.4, 1.0, 0.1], [0.2, 0.1, 2.0]])
    found = attribute(NAMES, np.ones(3), changes, spread)
    draws = np.random.default_rng(2).multivariate_normal(changes, spread, size=200_000)
    both = draws[:, :2].min(axis=1)
    assert found.status == "several"
    assert found.probability == pytest.approx(np.mean((both > 0) & (both > draws[:, 2])), abs=0.005)


def test_what_cannot_be_told_apart_is_said_to_be_so() -> None:
    """Two paths of like growth whose errors have nothing to do with each other."""
    found = attribute(("a", "b"), np.ones(2), np.array([1.0, 1.1]), np.diag([0.36, 0.36]))
    assert found.status == "cannot_be_told_apart"
    assert found.paths == ("a", "b")
    assert 0.5 < found.probability < 0.9
    assert found.reason == f"no path is more than {100 * found.probability:.0f} % probable"
    assert found.contribution == pytest.approx(2.1)


def test_without_a_certain_rise_no_path_is_blamed() -> None:
    """And it is not called healthy: wear from port to port does not show in the drain."""
    for changes in (np.zeros(3), np.array([0.0, -0.3, 0.1])):
        found = attribute(NAMES, FLOWS, changes, covariance(np.full(3, 0.03)))
        assert (found.status, found.paths, found.probability) == ("no_change", (), None)
        assert "no change of external leakage" in found.reason
        assert "healthy" not in found.reason


def test_one_path_alone_is_certain_and_none_is_none() -> None:
    found = attribute(("sleeve",), np.ones(1), np.ones(1), np.full((1, 1), 0.01))
    assert (found.status, found.probability) == ("path", 1.0)
    nothing = attribute((), np.empty(0), np.empty(0), np.empty((0, 0)))
    assert (nothing.status, nothing.paths) == ("no_path", ())


def test_changes_that_are_known_exactly() -> None:
    found = attribute(NAMES, np.ones(3), np.array([0.0, 0.2, 2.0]), np.zeros((3, 3)))
    assert (found.paths, found.probability) == (("balance_sleeve",), 1.0)
    assert found.lower == found.upper == 2.0


def test_the_flows_decide_what_a_path_explains() -> None:
    """The rings' K doubles: 0.8 % of the leakage at 200 bar, most of it at 40 bar."""
    changes, spread = np.array([1.0, 0.02, 0.01]), np.diag([1e-4, 1e-4, 1e-4])
    assert attribute(NAMES, np.array([3.2, 1.8, 4.5]), changes, spread).paths == ("piston_ring",)
    assert attribute(NAMES, FLOWS, changes, spread).paths != ("piston_ring",)


def test_arrays_that_do_not_belong_together_are_refused() -> None:
    with pytest.raises(ShapeError) as caught:
        attribute(NAMES, FLOWS, np.zeros(2), np.eye(3))
    assert caught.value.code == "shape"
    with pytest.raises(ParameterError) as unknown:
        attribute(NAMES, FLOWS, np.array([0.1, np.nan, 0.1]), np.eye(3))
    assert unknown.value.code == "not_finite"
