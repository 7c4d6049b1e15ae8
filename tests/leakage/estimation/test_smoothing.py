"""The moving average: a slow reference, its borders, and what it does to the loss factors."""

from __future__ import annotations

import datetime as dt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from leakage import OperatingConditions, regressors
from leakage.estimation.compression import smooth
from pipeline.config import load_fleet
from pipeline.demo import shipped_configs

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
STEP = 100_000
FIVE_SECONDS = 5.0
K_M3 = np.array([7.506312e-14, 1.558230e-14, 4.373874e-14])  # model.md, section 4


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


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.2, 0.5, 1.0, 2.0, 50.0]))
def test_as_the_slow_definition(seed: int, window_s: float) -> None:
    z, index, block = some_samples(seed)
    got = smooth(z, index, block, STEP, window_s)
    half = round(window_s * 1e6) // 2 // STEP
    np.testing.assert_allclose(got, slow_average(z, index, block, half), rtol=1e-12, atol=1e-13)


@pytest.fixture(scope="module")
def noise_free() -> tuple[Floats, Ints, Ints]:
    """An hour at 10 Hz with steep changes and gaps, without noise: z, index, block."""
    fleet = load_fleet(shipped_configs() / "fleet.toml")
    spec = next(spec for spec in fleet.motors if spec.file.motor_type == "CB560")
    motor = spec.motor(dt.date(2026, 1, 2), "none")
    rng = np.random.default_rng(8)
    n = 36_000
    levels = np.repeat(rng.uniform(15, 300, n // 60), 60)
    pressure = np.convolve(levels, np.ones(20) / 20, mode="same").clip(10, 320)
    temperature = 50 + 8 * np.sin(np.arange(n) / 5000)
    speed = np.repeat(rng.uniform(3, 110, n // 400), 400)
    inputs = regressors(motor, OperatingConditions.from_bar(pressure, temperature, speed))
    assert motor.columns[:3] == ("piston_ring", "balance_piston", "balance_sleeve")
    known = inputs[:, -1]
    z = np.column_stack([inputs, inputs[:, :3] @ K_M3 + known])
    kept = rng.random(n) > 0.02
    kept[9000:9700] = False
    index = np.flatnonzero(kept)
    return z[kept], index, index // 1200


class TestLossFactors:
    """Model 4: matched smoothing leaves a noise-free K as it is, one of y alone does not."""

    @staticmethod
    def loss_factors(z: Floats) -> Floats:
        phi, known, y = z[:, :3], z[:, -2], z[:, -1]
        scale = np.linalg.norm(phi, axis=0)
        found: Floats = np.linalg.lstsq(phi / scale, y - known, rcond=None)[0] / scale
        return found

    @pytest.mark.parametrize("window_s", [0.5, 5.0, 30.0])
    def test_on_all_columns_unbiased(
        self, noise_free: tuple[Floats, Ints, Ints], window_s: float
    ) -> None:
        smoothed = smooth(*noise_free, STEP, window_s)
        np.testing.assert_allclose(self.loss_factors(smoothed), K_M3, rtol=1e-9)
        assert np.abs(smoothed - noise_free[0])[:, -1].max() > 0.01

    def test_on_the_leakage_alone_biased(self, noise_free: tuple[Floats, Ints, Ints]) -> None:
        smoothed = smooth(*noise_free, STEP, 5.0, "leakage")
        np.testing.assert_array_equal(smoothed[:, :-1], noise_free[0][:, :-1])
        error = self.loss_factors(smoothed) / K_M3 - 1
        assert np.abs(error).max() > 0.005
