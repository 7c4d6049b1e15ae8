"""Simulated nights of the benchmarks: blocks agree with samples, fleets with simulated nights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.night_kinds import ERRORS, NIGHTS_A_DUTY, Kind, SimulatedNights
from benchmarks.simulated_fleets import SCATTER_OF_K, NightErrors, answers_to_wander, fleet
from benchmarks.simulated_nights import BLOCK_S
from leakage import regressors
from leakage.estimation.block_statistics import factors
from leakage.estimation.certificate import certify
from leakage.estimation.multi_start import Parametrisation

# 15 minutes: the last block is half a block.
KIND = Kind(15.0, 1.0, 0.9)


def test_blocks_are_those_of_the_samples() -> None:
    nights = SimulatedNights.of(KIND, 1)
    flow = nights.flow(KIND)
    borders = np.append(np.arange(0, len(flow), int(BLOCK_S)), len(flow))
    for night, blocks in enumerate(nights.compressed.factors(flow)):
        samples = np.column_stack([nights.compressed.columns, flow[:, night]])
        of_samples = factors(samples, borders)
        assert blocks.shape == of_samples.shape
        for ours, theirs in zip(blocks, of_samples, strict=True):
            assert ours.T @ ours == pytest.approx(theirs.T @ theirs, rel=1e-9)


@pytest.mark.parametrize("name", ERRORS)
def test_errors_are_one_series_a_night_and_the_same_for_a_seed(name: str) -> None:
    kind = replace(KIND, errors=name)
    first, again = (SimulatedNights.of(kind, 2).flow(kind) for _ in range(2))
    assert first.shape == (900, NIGHTS_A_DUTY)
    assert np.isfinite(first).all()
    assert np.array_equal(first, again)
    plain = SimulatedNights.of(KIND, 2).flow(KIND)
    assert np.array_equal(first, plain) == (name == "–")


def test_wander_moves_a_night_as_its_answers_say() -> None:
    nights = SimulatedNights.of(replace(KIND, minutes=60.0), 3)
    model, theta, seen = nights.motor, nights.theta, nights.seen
    degrees, gain, bar = 0.3, -0.003, 0.3
    colder, pressure = seen.temperature_c - degrees, seen.pressure_bar - bar
    truth = replace(seen, temperature_c=colder, pressure_bar=pressure)
    flow = regressors(model, truth.conditions) @ np.append(theta, 1.0) * (1.0 + gain)
    samples = np.column_stack([nights.compressed.columns, flow])
    bounds = Parametrisation.of(model).coefficient_bounds()
    found = certify(factors(samples, np.array([0, len(samples)]))[0], *bounds).coefficients
    changes = found[:3] / theta[:3] - 1.0
    told = answers_to_wander(nights) @ [degrees, gain, bar]
    assert told[:3] == pytest.approx(changes, abs=0.002)
    assert told[4] == pytest.approx(flow.mean() / nights.clean_flow.mean() - 1.0, abs=3e-4)


def test_worn_paths_show_in_all_indicators_by_their_shares() -> None:
    nothing = NightErrors(
        errors=np.zeros((1, 5)),
        answers=np.zeros((1, 5, 3)),
        shares=np.array([[0.1, 0.2, 0.3]]),
        reference_shares=np.array([0.0, 0.25, 0.35]),
    )
    growth = np.ones((50, 3))
    growth[25:, 2] = 1.4
    values = fleet(nothing, growth, 400, np.random.default_rng(5))
    rise = values[25:].mean(axis=(0, 1)) / values[:25].mean(axis=(0, 1)) - 1.0
    assert rise == pytest.approx([0.0, 0.0, 0.4, 0.14, 0.12], abs=1e-3)
    assert values[:25, :, 0].std() == pytest.approx(SCATTER_OF_K, rel=0.05)
