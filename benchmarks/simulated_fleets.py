"""Fleets of nightly indicators whose errors are those of simulated, fitted nights.

Some hundred nights of a CB560 are simulated and fitted by the package: their relative errors, with
heavy tails and all, and their verdicts are what an indicator of a healthy motor scatters by. A
fleet draws series from them: normal autoregressions that correlate between indicators as the errors
do and from night to night as asked for, mapped to the errors' own distribution rank by rank.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from benchmarks.simulated_nights import (
    BLOCK_S,
    RATE_HZ,
    REFERENCE,
    CompressedNights,
    Duty,
    correlated_noise,
    duty,
    motor,
    true_coefficients,
)
from leakage import (
    Excitation,
    Motor,
    SearchSettings,
    fit,
    identify,
    judge_leakage,
    merge,
    regressors,
)

Array = NDArray[np.float64]

DUTIES, NIGHTS_A_DUTY = 120, 8
# Of the flow's noise: a deviation relative to the leakage itself and a memory of some seconds.
RELATIVE_NOISE, NOISE_PHI = 0.013, 0.97
MOST_HOURS = 3.0
NO_SEARCH = SearchSettings(starting_points=0)
# A motor is not quite the same every night: relative scatter of each K, as in the demo.
SCATTER_OF_K = 0.006
INDICATORS = (
    "reference_leakage",
    "K_piston_ring",
    "K_balance_piston",
    "K_balance_sleeve",
    "baseline_deviation",
)


@dataclass(frozen=True, slots=True)
class NightErrors:
    """What the simulated nights scatter by.

    Attributes
    ----------
    errors
        Relative errors of the indicators, shape (nights, 5); nan where the night has no verdict
        `identified` for it.
    raw_flow
        Mean drain flow of each night over that of all nights, shape (nights,).
    shares
        Share of each path that can wear in the reference leakage: ring, piston, sleeve.
    """

    errors: Array
    raw_flow: Array
    shares: Array


def night_errors(seed: int = 1) -> NightErrors:
    """Simulate and fit nights of duties of very different use."""
    generator = np.random.default_rng(seed)
    model = motor()
    theta = true_coefficients(model)
    row = regressors(model, REFERENCE)[0]
    shares = row[:3] * theta[:3] / float(row[:-2] @ theta[:-1] + row[-1])
    errors, raw = [], []
    for _ in range(DUTIES):
        seen = _duty(generator)
        compressed = CompressedNights(model, seen)
        columns = compressed.columns
        for _ in range(NIGHTS_A_DUTY):
            true = theta * np.append(1.0 + SCATTER_OF_K * generator.standard_normal(3), 1.0)
            clean = columns @ np.append(true, 1.0)
            noise = correlated_noise(len(clean), NOISE_PHI, 1, generator)[:, 0]
            flow = clean * (1.0 + RELATIVE_NOISE * noise)
            blocks = next(compressed.factors(flow[:, None]))
            expected = float(np.mean(columns @ np.append(theta, 1.0)))
            errors.append(_errors(model, theta, blocks, seen, float(flow.mean()) / expected))
            raw.append(float(flow.mean()))
    return NightErrors(np.array(errors), np.array(raw) / float(np.mean(raw)), shares)


def _duty(generator: np.random.Generator) -> Duty:
    """One to three hours of load between limits that are wide on most nights, narrow on some."""
    seen = duty(generator.uniform(1.0, MOST_HOURS), generator)
    low = generator.uniform(15.0, 40.0) if generator.random() < 0.9 else generator.uniform(60, 90)
    high = generator.uniform(205.0, 300.0) if generator.random() < 0.9 else 190.0
    cold = generator.uniform(41.0, 48.0)
    share = (seen.pressure_bar - 15.0) / 285.0
    warmth = (seen.temperature_c - 40.0) / 20.0
    return Duty(low + (high - low) * share, cold + 12.0 * warmth, seen.speed_rpm)


def _errors(model: Motor, theta: Array, blocks: Array, seen: Duty, ratio: float) -> Array:
    """Relative errors of the indicators of one night."""
    estimate = fit(merge(blocks), model, NO_SEARCH, np.random.default_rng(0))
    excitation = Excitation(
        minutes=len(blocks) * BLOCK_S / 60.0,
        pressure_bar=(seen.pressure_bar.min(), seen.pressure_bar.max()),
        temperature_c=(seen.temperature_c.min(), seen.temperature_c.max()),
        speed_rpm=(seen.speed_rpm.min(), seen.speed_rpm.max()),
        correlation_time_s=-1.0 / (RATE_HZ * np.log(NOISE_PHI)),
        block_s=BLOCK_S,
    )
    verdicts = identify(estimate, blocks, excitation)
    of_k = estimate.coefficients[:3] / theta[:3] - 1.0
    known = [one.verdict == "identified" for one in verdicts.coefficients[:3]]
    leakage = judge_leakage(estimate, verdicts, excitation, REFERENCE)
    row = regressors(model, REFERENCE)[0]
    reference = leakage.leakage_l_per_min / float(row[:-2] @ theta[:-1] + row[-1]) - 1.0
    if leakage.verdict != "identified":
        reference = np.nan
    return np.array([reference, *np.where(known, of_k, np.nan), ratio - 1.0])


@dataclass(frozen=True, slots=True)
class Fleet:
    """Nightly indicators of healthy motors, relative to what they are in truth.

    Attributes
    ----------
    ratios
        Indicator over its true value, shape (nights, motors, 5); nan where gated.
    raw_flow
        Mean drain flow of the night over its long-run mean, shape (nights, motors).
    """

    ratios: Array
    raw_flow: Array


def healthy_fleet(
    of: NightErrors,
    nights: int,
    motors: int,
    phi: float,
    generator: np.random.Generator,
    scale: Array | None = None,
) -> Fleet:
    """A fleet without wear.

    Parameters
    ----------
    of
        Errors to draw from.
    nights, motors
        Size of the fleet.
    phi
        Correlation of neighbouring nights, before the errors' own distribution is put on.
    generator
        Source of randomness.
    scale
        Factor on the errors of each indicator, shape (5,); 1 where left out.

    Returns
    -------
    Fleet
        Errors keep their distribution, and the rank correlation between indicators.
    """
    columns = np.column_stack([of.errors, of.raw_flow])
    root = np.linalg.cholesky(_correlation_of_ranks(columns))
    draws = correlated_noise(nights, phi, motors * columns.shape[1], generator)
    latent = draws.reshape(nights, motors, -1) @ root.T
    place = ndtr(latent)
    found = np.empty_like(place)
    for column, values in enumerate(columns.T):
        known = values[np.isfinite(values)]
        found[..., column] = np.quantile(known, place[..., column])
        gated = generator.random((nights, motors)) > len(known) / len(values)
        found[..., column][gated] = np.nan
    errors = found[..., :-1] * (1.0 if scale is None else scale)
    return Fleet(1.0 + errors, found[..., -1])


def _correlation_of_ranks(columns: Array) -> Array:
    """Correlation of the normal scores of the nights on which all columns are known."""
    known = columns[np.isfinite(columns).all(axis=1)]
    ranks = known.argsort(axis=0).argsort(axis=0)
    scores = ndtri((ranks + 0.5) / len(known))
    correlation = np.corrcoef(scores.T)
    result: Array = correlation + 1e-9 * np.eye(len(correlation))
    return result
