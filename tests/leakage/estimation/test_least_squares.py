"""A fit from statistics alone: what it recovers, what it publishes, what moves it and what not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leakage.estimation.block_statistics import Array, factor
from leakage.estimation.proven_minimum import Fit, fit
from leakage.physics.annular_gap import AnnularGap
from leakage.physics.motor import Motor
from leakage.physics.paths import LeakagePath
from tests.leakage.made_samples import made_samples, true_coefficients
from tests.leakage.placeholders import HIGH_PRESSURE_COUNTS, Flushing, placeholder_motor

FLUSHED = placeholder_motor(flushing="estimated", flushing_l_per_min=4.0)


def fitted(z: Array, motor: Motor) -> Fit:
    return fit(factor(z), motor)


def worn(motor: Motor, factors_on_gaps: tuple[float, float, float]) -> Motor:
    """The motor with other true gaps; bounds stay."""
    paths: list[LeakagePath] = list(motor.paths)
    for index, share in enumerate(factors_on_gaps):
        path = paths[index]
        assert isinstance(path, AnnularGap)
        paths[index] = replace(path, gap=replace(path.gap, value=path.gap.value * share))
    return replace(motor, paths=tuple(paths))


@given(
    wear=st.tuples(st.floats(0.5, 3.0), st.floats(0.5, 3.0), st.floats(0.5, 3.0)),
    motor_type=st.sampled_from(sorted(HIGH_PRESSURE_COUNTS)),
    flushing=st.sampled_from(["none", "fixed", "estimated"]),
    roller_is_free=st.booleans(),
)
def test_known_loss_factors_are_recovered_without_noise(
    wear: tuple[float, float, float], motor_type: str, flushing: Flushing, roller_is_free: bool
) -> None:
    new = placeholder_motor(
        motor_type,
        flushing=flushing,
        flushing_l_per_min=0.0 if flushing == "none" else 3.0,
        roller_is_free=roller_is_free,
    )
    truth = worn(new, wear)
    found = fitted(made_samples(truth, 300, noise_l_per_min=0.0), new)
    np.testing.assert_allclose(found.coefficients, true_coefficients(truth), rtol=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_noise_scatters_the_estimate_as_least_squares_says(seed: int) -> None:
    z = made_samples(FLUSHED, 4000, 10 * seed, noise_l_per_min=0.02)
    found = fitted(z, FLUSHED)
    scale = np.linalg.norm(z[:, :4], axis=0)
    spread = np.sqrt(np.diag(np.linalg.inv((z[:, :4] / scale).T @ (z[:, :4] / scale))))
    deviation = (found.coefficients - true_coefficients(FLUSHED)) * scale / (0.02 * spread)
    assert np.abs(deviation).max() < 4.0
    assert np.sqrt(found.proven_minimum.cost) == pytest.approx(0.02, rel=0.05)


@given(seed=st.integers(0, 1000), flow=st.sampled_from([4.0, 0.25, 12.0]))
def test_a_flow_added_to_the_measured_moves_only_the_flushing(seed: int, flow: float) -> None:
    z = made_samples(FLUSHED, 500, seed)
    shifted = z.copy()
    shifted[:, -1] += flow
    before, after = fitted(z, FLUSHED), fitted(shifted, FLUSHED)
    np.testing.assert_allclose(after.coefficients[:3], before.coefficients[:3], rtol=1e-10)
    assert after.coefficients[3] - before.coefficients[3] == pytest.approx(flow, rel=1e-11)
    assert after.proven_minimum.cost == pytest.approx(before.proven_minimum.cost, rel=1e-10)


def test_fixed_flushing_is_taken_off_the_flow() -> None:
    z = made_samples(FLUSHED)
    fixed = placeholder_motor(flushing="fixed", flushing_l_per_min=4.0)
    none = placeholder_motor()
    without = z.copy()
    without[:, -1] -= 4.0
    found = fitted(z, fixed)
    assert found.coefficients_by_path["f"] == 4.0
    np.testing.assert_allclose(
        found.coefficients[:3], fitted(without, none).coefficients[:3], rtol=1e-11
    )
    # The same flow without its flushing declared is leakage: the mode matters.
    assert fitted(z, none).coefficients[1] > 2.0 * found.coefficients[1]
