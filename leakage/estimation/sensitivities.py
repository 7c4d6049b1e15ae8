r"""Systematic errors: what stated tolerances of sensors and constants do to every figure.

An interval from the samples cannot see a sensor that reads 1 °C too high, yet such errors dominate
in practice. Each stated tolerance is therefore put on in turn, the model is fitted anew to a
thinned sample, and the change of each figure is kept: an error budget by source. Independent
sources add by their squares:

.. math:: u = \sqrt{\sum_j \left(\hat x(s_j + t_j) - \hat x(s_j)\right)^2}
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leakage.estimation.block_statistics import factors
from leakage.estimation.certificate import certify
from leakage.estimation.error_sources import SENSORS, Source, Tolerances, Window, sources
from leakage.estimation.multi_start import Parametrisation
from leakage.physics.motor import Motor, OperatingConditions, regressors

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Effect:
    """Effect of one source on every figure, signed, for its tolerance taken as positive."""

    source: Source
    coefficients: Array
    leakages_l_per_min: Array


@dataclass(frozen=True, slots=True)
class ErrorBudget:
    """Effects of all sources, and their sum by squares."""

    effects: tuple[Effect, ...]

    def of_sensors(self) -> ErrorBudget:
        """The effects of sensors alone."""
        return ErrorBudget(
            tuple(one for one in self.effects if one.source.name.startswith(SENSORS))
        )

    def coefficients(self) -> Array | None:
        """Systematic ± of θ, shape (p + 1,); None where nothing is stated."""
        return _by_squares([effect.coefficients for effect in self.effects])

    def leakages_l_per_min(self) -> Array | None:
        """Systematic ± of the leakages, shape (m,); None where nothing is stated."""
        return _by_squares([effect.leakages_l_per_min for effect in self.effects])


def _by_squares(effects: Sequence[Array]) -> Array | None:
    if not effects:
        return None
    return np.array([math.hypot(*of_one) for of_one in np.transpose(effects)])


def error_budget(
    motor: Motor,
    conditions: OperatingConditions,
    flow_l_per_min: Array,
    tolerances: Tolerances,
    at: Sequence[OperatingConditions] = (),
    as_read: Sequence[OperatingConditions] = (),
) -> ErrorBudget:
    """Carry each stated tolerance through a fit of a thinned sample; empty where none is stated.

    Parameters
    ----------
    motor, conditions, flow_l_per_min
        The motor as fitted, and n thinned training samples; a few thousand are enough.
    tolerances
        What is stated.
    at, as_read
        Conditions at which the leakage is asked for, one sample each: stated ones, and ones that
        the same sensors have read, so that a sensor that is off moves them, too.

    Raises
    ------
    EstimationError, ValidityError
        If there are fewer samples than free coefficients; if a disturbed temperature leaves the
        range of Walther's equation.
    """
    n, told = len(flow_l_per_min), [*sources(motor, tolerances)]
    read = Window(motor, OperatingConditions.joined([conditions, *as_read]), flow_l_per_min)
    windows = [read, *(source.disturbed(read) for source in told)]
    columns = np.stack([regressors(one.motor, one.conditions) for one in windows])
    flows = np.stack([one.flow_l_per_min for one in windows])
    thetas = _coefficients(motor, np.concatenate([columns[:, :n], flows[:, :, None]], axis=2))
    stated = np.empty((len(windows), len(at), columns.shape[2]))
    for place, each in enumerate(at):
        # No sensor moves what is stated.
        stated[:, place] = regressors(motor, each)[0]
        for row, one in enumerate(windows):
            if one.motor is not motor:
                stated[row, place] = regressors(one.motor, each)[0]
    asked = np.concatenate([stated, columns[:, n:]], axis=1)
    leakages = np.einsum("smp,sp->sm", asked[:, :, :-2], thetas[:, :-1]) + asked[:, :, -1]
    return ErrorBudget(
        tuple(
            Effect(source, source.sign * (theta - thetas[0]), source.sign * (leakage - leakages[0]))
            for source, theta, leakage in zip(told, thetas[1:], leakages[1:], strict=True)
        )
    )


def _coefficients(motor: Motor, samples: Array) -> Array:
    """θ of samples as read and as disturbed by each source, shape (1 + s, p + 1).

    Disturbed ones are fitted without bounds, what the first fit has on a bound held there: cut at a
    bound, the effect on one coefficient would be moved to the others.
    """
    count, n, columns = samples.shape
    whole = factors(samples.reshape(-1, columns), n * np.arange(count + 1))
    certificate = certify(whole[0], *Parametrisation.of(motor).coefficient_bounds())
    off = certificate.off_bounds
    thetas = np.tile(certificate.coefficients, (count, 1))
    matrix, held = whole[:, :, :-2], np.where(off, 0.0, certificate.coefficients)
    targets = whole[:, :, -1] - whole[:, :, -2] - matrix @ held
    scales = np.linalg.norm(matrix[:, :, off], axis=1)
    for place in range(1, count):
        scaled = matrix[place][:, off] / scales[place]
        thetas[place, off] = np.linalg.lstsq(scaled, targets[place])[0] / scales[place]
    return thetas


def effects_elsewhere(
    motor: Motor,
    tolerances: Tolerances,
    coefficients: Array,
    effects: Mapping[str, tuple[Array, float]],
    before: OperatingConditions,
    after: OperatingConditions,
) -> dict[str, float]:
    """Effects on the leakage at one stated condition from those at another, without samples.

    A constant acts on what the thinned sample's own fit says; that is taken as the nearest to θ,
    shape (p + 1,), which explains the known effects: by source, on θ and on the leakage at `before`
    [l/min]. By source, the effect on the leakage at `after` [l/min] is returned.
    """
    told = [source for source in sources(motor, tolerances) if source.name in effects]
    nothing, theta = np.zeros(1), coefficients[:-1]
    disturbed = [source.disturbed(Window(motor, before, nothing)).motor for source in told]

    def changes(at: OperatingConditions) -> tuple[Array, Array]:
        """By source, change of the regressors, and of the leakage that does not hang on θ."""
        was = regressors(motor, at)[0]
        now = np.array([regressors(of, at)[0] for of in disturbed]).reshape(-1, len(was))
        moved = [
            one[:-2] @ (source.sign * effects[source.name][0][:-1]) + one[-1] - was[-1]
            for source, one in zip(told, now, strict=True)
        ]
        return now[:, :-2] - was[:-2], np.array(moved)

    signs = np.array([source.sign for source in told])
    slopes, moved = changes(before)
    unexplained = signs * [effects[source.name][1] for source in told] - moved - slopes @ theta
    theta = theta * (1.0 + np.linalg.lstsq(slopes * theta, unexplained)[0])
    slopes, moved = changes(after)
    found = signs * (slopes @ theta + moved)
    return dict(zip((source.name for source in told), found.tolist(), strict=True))
