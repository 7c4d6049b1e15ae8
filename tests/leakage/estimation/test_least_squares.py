"""A fit from statistics alone: what it recovers, what it publishes, what moves it and what not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leakage.errors import EstimationError
from leakage.estimation.block_statistics import Array, factor, factors, merge
from leakage.estimation.least_squares import Fit, fit
from leakage.estimation.multi_start import SearchSettings, Start
from leakage.physics.motor import Motor, leakage_l_per_min
from leakage.physics.paths import AnnularGap, LeakagePath
from tests.leakage.made_samples import made_conditions, made_samples, true_coefficients
from tests.leakage.placeholders import HIGH_PRESSURE_COUNTS, Flushing, placeholder_motor

FLUSHED = placeholder_motor(flushing="estimated", flushing_l_per_min=4.0)
TEN_STARTS = SearchSettings(starting_points=10)
NO_STARTS = SearchSettings(starting_points=0)


def fitted(z: Array, motor: Motor, settings: SearchSettings = NO_STARTS) -> Fit:
    return fit(factor(z), motor, settings, np.random.default_rng(11))


def worn(motor: Motor, factors_on_gaps: tuple[float, float, float]) -> Motor:
    """The motor with other true gaps; bounds stay."""
    paths: list[LeakagePath] = list(motor.paths)
    for index, share in enumerate(factors_on_gaps):
        path = paths[index]
        assert isinstance(path, AnnularGap)
        paths[index] = replace(path, gap=replace(path.gap, value=path.gap.value * share))
    return replace(motor, paths=tuple(paths))


# --- recovery -------------------------------------------------------------------------------


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


def test_loss_factors_of_the_worked_gaps_are_the_worked_loss_factors() -> None:
    # Model, section 4: CB560, h_o 8, h_p 10, h_s 12 µm, e_p 0.4, e_s 0.3.
    found = fitted(made_samples(FLUSHED, noise_l_per_min=0.0), worn(FLUSHED, (2.0, 0.7, 1.5)))
    assert found.coefficients_by_path == {
        "o": pytest.approx(7.506312e-14, rel=1e-6),
        "p": pytest.approx(1.558230e-14, rel=1e-6),
        "s": pytest.approx(4.373874e-14, rel=1e-6),
        "f": pytest.approx(4.0, rel=1e-9),
    }


def test_reference_leakage_of_the_fit_is_the_worked_one() -> None:
    found = fitted(made_samples(FLUSHED, noise_l_per_min=0.0), FLUSHED)
    reference = made_conditions(1, pressure_bar=(200.0, 200.0))
    reference = replace(reference, oil_temperature_c=np.array([50.0]), speed_rpm=np.array([30.0]))
    leakage = leakage_l_per_min(FLUSHED, reference, found.coefficients_by_path)
    assert leakage == pytest.approx([1.371423], abs=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_noise_scatters_the_estimate_as_least_squares_says(seed: int) -> None:
    z = made_samples(FLUSHED, 4000, 10 * seed, noise_l_per_min=0.02)
    found = fitted(z, FLUSHED)
    scale = np.linalg.norm(z[:, :4], axis=0)
    spread = np.sqrt(np.diag(np.linalg.inv((z[:, :4] / scale).T @ (z[:, :4] / scale))))
    deviation = (found.coefficients - true_coefficients(FLUSHED)) * scale / (0.02 * spread)
    assert np.abs(deviation).max() < 4.0
    assert np.sqrt(found.certificate.cost) == pytest.approx(0.02, rel=0.05)


# --- invariance -----------------------------------------------------------------------------


@given(seed=st.integers(0, 1000), flow=st.sampled_from([4.0, 0.25, 12.0]))
def test_a_flow_added_to_the_measured_moves_only_the_flushing(seed: int, flow: float) -> None:
    z = made_samples(FLUSHED, 500, seed)
    shifted = z.copy()
    shifted[:, -1] += flow
    before, after = fitted(z, FLUSHED), fitted(shifted, FLUSHED)
    np.testing.assert_allclose(after.coefficients[:3], before.coefficients[:3], rtol=1e-10)
    assert after.coefficients[3] - before.coefficients[3] == pytest.approx(flow, rel=1e-11)
    assert after.certificate.cost == pytest.approx(before.certificate.cost, rel=1e-10)


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


@given(seed=st.integers(0, 1000), sizes=st.lists(st.integers(0, 80), min_size=1, max_size=20))
def test_a_window_of_blocks_is_fitted_as_its_samples_are(seed: int, sizes: list[int]) -> None:
    z = made_samples(FLUSHED, sum(sizes) + 100, seed)
    borders = np.concatenate([[0], np.cumsum([*sizes, 100])])
    blocks = fit(merge(factors(z, borders)), FLUSHED, NO_STARTS, np.random.default_rng(1))
    whole = fitted(z, FLUSHED)
    np.testing.assert_allclose(blocks.coefficients, whole.coefficients, rtol=1e-9)
    assert blocks.certificate.cost == pytest.approx(whole.certificate.cost, rel=1e-11)


@given(seed=st.integers(0, 1000))
def test_order_of_samples_does_not_matter(seed: int) -> None:
    z = made_samples(FLUSHED, 300, seed)
    shuffled = np.random.default_rng(seed).permutation(z)
    np.testing.assert_allclose(
        fitted(shuffled, FLUSHED).coefficients, fitted(z, FLUSHED).coefficients, rtol=1e-9
    )


def test_configured_values_of_free_parameters_do_not_move_the_estimate() -> None:
    z = made_samples(FLUSHED)
    one = fitted(z, FLUSHED)
    other = fitted(z, worn(FLUSHED, (3.0, 0.5, 2.0)))
    assert one.coefficients.tobytes() == other.coefficients.tobytes()


def test_counts_scale_nothing_but_the_gap_heights() -> None:
    # K is lumped: twice the interfaces at the same flow is the same K.
    z = made_samples(FLUSHED)
    doubled = replace(
        FLUSHED, paths=tuple(replace(p, count=64) for p in FLUSHED.paths[:3]) + FLUSHED.paths[3:]
    )
    np.testing.assert_allclose(
        fitted(z, doubled).coefficients, fitted(z, FLUSHED).coefficients, rtol=1e-12
    )


# --- what a fit says ------------------------------------------------------------------------


def test_published_estimate_is_the_certificates_and_the_starts_agree() -> None:
    found = fitted(made_samples(FLUSHED), worn(FLUSHED, (1.5, 0.8, 1.2)), TEN_STARTS)
    assert found.coefficients is found.certificate.coefficients
    assert len(found.starts) == 10
    assert [start.number for start in found.starts_at_minimum] == list(range(10))
    assert found.certificate_gap is not None
    assert -1e-10 < found.certificate_gap < 1e-9


def test_the_same_call_gives_the_same_fit() -> None:
    z = made_samples(FLUSHED)
    one, other = fitted(z, FLUSHED, TEN_STARTS), fitted(z, FLUSHED, TEN_STARTS)
    assert one.coefficients.tobytes() == other.coefficients.tobytes()
    for start, again in zip(one.starts, other.starts, strict=True):
        assert start.final.tobytes() == again.final.tobytes()


def test_no_search_is_a_fit_without_starts() -> None:
    found = fitted(made_samples(FLUSHED), FLUSHED, NO_STARTS)
    assert found.starts == found.starts_at_minimum == ()
    assert found.certificate_gap is None


def test_gap_to_the_certificate_is_that_of_the_best_start_that_ended() -> None:
    found = fitted(made_samples(FLUSHED), FLUSHED)
    nowhere = np.empty(0)
    costs = [np.nan, 1.5, 1.0 + 5e-5]
    starts = tuple(
        Start(number, "", "", cost * found.certificate.cost, 1, nowhere, nowhere)
        for number, cost in enumerate(costs)
    )
    with_starts = replace(found, starts=starts)
    assert with_starts.certificate_gap == pytest.approx(5e-5, rel=1e-9)
    assert [start.number for start in with_starts.starts_at_minimum] == [2]
    assert replace(found, starts=starts[:1]).certificate_gap is None
    exact = replace(found.certificate, cost=0.0)
    assert replace(with_starts, certificate=exact).certificate_gap is None


@pytest.mark.parametrize(
    ("flushing", "names"), [("none", "ops"), ("fixed", "opsf"), ("estimated", "opsf")]
)
def test_coefficients_carry_the_names_of_their_paths(flushing: Flushing, names: str) -> None:
    motor = placeholder_motor(flushing=flushing, flushing_l_per_min=0.0)
    found = fitted(made_samples(motor), motor)
    assert "".join(found.coefficients_by_path) == names
    assert list(found.coefficients_by_path.values()) == found.coefficients[: len(names)].tolist()
    assert len(found.coefficients) == 4


def test_a_free_roller_has_its_column_and_its_name() -> None:
    motor = placeholder_motor(roller_is_free=True)
    found = fitted(made_samples(motor, noise_l_per_min=0.0), motor)
    assert found.coefficients_by_path["r"] == pytest.approx(1.0, rel=1e-9)


def test_too_few_samples_are_refused_before_the_search() -> None:
    with pytest.raises(EstimationError) as caught:
        fitted(made_samples(FLUSHED, 3), FLUSHED, TEN_STARTS)
    assert caught.value.code == "too_few_samples"


def test_a_motor_of_known_paths_alone_is_a_prediction() -> None:
    # Everything fixed: nothing to estimate, and a fit all the same.
    motor = placeholder_motor(flushing="fixed", flushing_l_per_min=1.0)
    known = replace(motor, paths=motor.paths[3:])
    z = made_samples(known, noise_l_per_min=0.0)
    found = fitted(z, known, TEN_STARTS)
    assert found.coefficients_by_path == {"f": 1.0}
    assert found.starts == ()
    assert found.certificate.cost < 1e-28
