"""Fleets of nightly indicators whose errors are those of simulated, fitted nights.

Some hundred nights of a kind are simulated and fitted by the package. A motor's night has the
errors of one of them, drawn at random, all indicators together, so that they keep their heavy tails
and depend on one another as they do; what is not identified stays unknown. Wander of the sensors
moves a night's indicators by how its duty answers to it, from fits of noise-free flows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.error_kinds import night_wander
from benchmarks.night_kinds import NIGHTS_A_DUTY, Kind, SimulatedNights, figures
from benchmarks.simulated_nights import REFERENCE
from leakage import regressors
from leakage.estimation.block_statistics import merge
from leakage.estimation.certificate import certify
from leakage.estimation.multi_start import Parametrisation
from pipeline.arrays import Array

DUTIES = 100
# A motor is not quite the same every night: relative scatter of each K, as in the demo.
SCATTER_OF_K = 0.006
INDICATORS = (
    "K_piston_ring",
    "K_balance_piston",
    "K_balance_sleeve",
    "reference_leakage",
    "baseline_deviation",
)
PATHS = 3
REFERENCE_LEAKAGE = 3


@dataclass(frozen=True, slots=True)
class NightErrors:
    """Errors of the simulated nights of a kind."""

    # Relative errors of the indicators, shape (nights, 5); nan where the night has none that the
    # package would publish.
    errors: Array
    # Their change by 1 °C, by a gain of 1 (all of the flow), and by 1 bar, shape (nights, 5, 3).
    answers: Array
    shares: Array  # share of ring, piston and sleeve in each night's flow, shape (nights, 3)
    reference_shares: Array  # the same of the reference leakage, shape (3,)


def night_errors(kind: Kind) -> NightErrors:
    """Simulate and fit nights of one kind."""
    errors, answers, shares = [], [], []
    with threadpool_limits(1):
        for seed in range(DUTIES):
            nights = SimulatedNights.of(kind, seed)
            flow = nights.flow(kind)
            means = np.mean(nights.compressed.columns, axis=0) * np.append(nights.theta, 1.0)
            for found, mean in zip(figures(nights, flow), flow.mean(axis=0), strict=True):
                known = [one.error if one.half_width > 0.0 else np.nan for one in found[:4]]
                errors.append([*known, float(mean / means.sum()) - 1.0])
            answers += [answers_to_wander(nights)] * NIGHTS_A_DUTY
            shares += [means[:PATHS] / means.sum()] * NIGHTS_A_DUTY
    row = regressors(nights.motor, REFERENCE)[0] * np.append(nights.theta, 1.0)
    return NightErrors(
        np.array(errors),
        np.array(answers),
        np.array(shares),
        row[:PATHS] / row.sum(),
    )


def answers_to_wander(nights: SimulatedNights) -> Array:
    """Relative change of the indicators by 1 °C, by a gain of 1, and by 1 bar, shape (5, 3)."""
    seen, clean = nights.seen, nights.clean_flow
    # Small enough to be linear, large against rounding.
    small = 0.1
    flows = np.hstack(
        [
            clean,
            clean + nights.as_if(temperature_c=seen.temperature_c - small),
            clean * (1.0 + small),
            clean + nights.as_if(pressure_bar=seen.pressure_bar - small),
        ]
    )
    bounds = Parametrisation.of(nights.motor).coefficient_bounds()
    free = bounds[0] < bounds[1]
    # Wide bounds: the answer to a small change must not end on one.
    wide = np.where(free, -1e3, bounds[0]), np.where(free, 1e3, bounds[1])
    row = regressors(nights.motor, REFERENCE)[0]
    indicators = []
    for place, blocks in enumerate(nights.compressed.factors(flows)):
        theta = certify(merge(blocks), *wide).coefficients
        leakage = row[:-2] @ theta[:-1] + row[-1]
        indicators.append([*theta[:PATHS], leakage, flows[:, place].mean()])
    at_rest, *moved = np.array(indicators)
    result: Array = (np.array(moved) / at_rest - 1.0).T / small
    return result


def fleet(
    of: NightErrors,
    growth: Array,
    motors: int,
    generator: np.random.Generator,
    wanders: bool = True,
) -> Array:
    """Indicators of motors over their values as built, shape (nights, motors, 5); nan: unknown.

    `growth` is K of ring, piston and sleeve over those of the first night, shape (nights, 3).
    """
    shape = (len(growth), motors)
    drawn = generator.integers(len(of.errors), size=shape)
    errors = of.errors[drawn]
    if wanders:
        wander = night_wander(generator, shape)
        moved = np.stack([wander.temperature_c, wander.gain, wander.pressure_bar], axis=-1)
        errors = errors + np.einsum("nmik,nmk->nmi", of.answers[drawn], moved)
    grown = growth[:, None] * (1.0 + SCATTER_OF_K * generator.standard_normal((*shape, PATHS)))
    reference = 1.0 + (grown - 1.0) @ of.reference_shares
    deviation = 1.0 + np.einsum("nmi,nmi->nm", grown - 1.0, of.shares[drawn])
    indicators = np.concatenate([grown, reference[..., None], deviation[..., None]], axis=-1)
    result: Array = indicators * (1.0 + errors)
    return result
