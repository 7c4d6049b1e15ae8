"""The fit of blocks whose errors scale and hardly turn within the log."""

from __future__ import annotations

import numpy as np
import pytest

from leakage.estimation.block_fit import SampleBlocks, fit_blocks
from leakage.estimation.block_statistics import factors
from leakage.estimation.identifiability import Excitation, judge_leakage
from leakage.physics.conditions import OperatingConditions
from leakage.physics.motor import regressors
from tests.leakage.placeholders import placeholder_motor

BLOCK, N_BLOCKS = 120, 45
MODEL = placeholder_motor()
PATHS = MODEL.coefficient_paths
THETA = np.array([path.configured_coefficient if path else 0.0 for path in PATHS])
REFERENCE = OperatingConditions.from_bar(200.0, 50.0, 30.0)


def drifting_night(generator: np.random.Generator) -> SampleBlocks:
    """90 minutes in which the flow drifts evenly by 8 % against the model; one sample a second."""
    n = BLOCK * N_BLOCKS
    bar = np.repeat(generator.uniform(20.0, 300.0, n // 45 + 1), 45)[:n]
    rpm = np.repeat(generator.uniform(5.0, 45.0, n // 45 + 1), 45)[:n]
    celsius = 50.0 + 5.0 * np.sin(np.arange(n) / 1000.0)
    columns = regressors(MODEL, OperatingConditions.from_bar(bar, celsius, rpm))
    flow = columns @ np.append(THETA, 1.0) * np.linspace(0.96, 1.04, n)
    flow += 0.02 * generator.standard_normal(n)
    made = factors(np.column_stack([columns, flow]), np.arange(0, n + 1, BLOCK))
    spans = [(float(one.min()), float(one.max())) for one in (bar, celsius, rpm)]
    means = np.column_stack([celsius, bar, rpm]).reshape(-1, BLOCK, 3).mean(axis=1)
    every = np.ones(N_BLOCKS, dtype=bool)
    return SampleBlocks(made, np.arange(N_BLOCKS), float(BLOCK), every, means, Excitation(*spans))


def test_an_error_that_hides_the_level_costs_no_leakage() -> None:
    """Whitened, it would leave the level to one block, and one block has no interval."""
    generator, n_hidden = np.random.default_rng(1), 0
    row = regressors(MODEL, REFERENCE)[0]
    true = float(row[:-2] @ THETA[:-1] + row[-1])
    for _ in range(15):
        blocks = drifting_night(generator)
        made = fit_blocks(blocks, MODEL)
        n_hidden += made.slow.hides_level(blocks.number)
        judged = made.identified(blocks.excitation)
        found = judge_leakage(made.fit, judged, blocks.excitation, REFERENCE)
        assert found.is_told, found.reason
        assert found.leakage_l_per_min == pytest.approx(true, rel=0.02)
        assert found.interval is not None
        assert abs(found.leakage_l_per_min - true) <= found.interval.half_width
    assert n_hidden >= 5
