"""Evidence against the marginal likelihood of the whole Gaussian model, with dense matrices.

All blocks of all nights r = S(z + s_n + x_n a d) + e stand in one vector: z has its prior, each
night's shift s_n ~ N(0, Q), and a the size of a change d with shape x_n.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import simpson
from scipy.linalg import block_diag, null_space
from scipy.stats import halfnorm, multivariate_normal, norm

from leakage.watch.causes import Cause
from leakage.watch.evidence import RAMP, STEP, Causes, Evidence, Sums, Window, starts_of
from leakage.watch.state import surroundings
from leakage.watch.wander import (
    PHI,
    SHARE,
    USUAL_MEMORY,
    Wander,
    WanderPrior,
    effective,
    estimate_wander,
)
from tests.leakage.watch.made_machine import autoregression

Array = NDArray[np.float64]

# So many nights that Q is as good as known: no allowance for its being an estimate.
KNOWN = 10**9
P, Q_UNKNOWNS, BLOCKS = 2, 4, 5
# Numbers of dates, as they are given: their squares leave no digits for a ramp of a few days.
DAYS = 739_000 + np.array([100, 101, 102, 105, 106, 107])
# The last three nights have other operating conditions.
DISTANCE = np.array([0.5, 1.0, 0.7, 3.0, 2.5, 6.0])
OPERATING_ERROR = np.array([0.02, 0.05])
SPREAD = 1e-4 * np.array([[2.0, 0.7], [0.7, 1.5]])
PRIOR = np.diag([1.0, 1.0, 25.0, 1000.0])
CAUSES = (
    Cause("first", np.array([1.0, 0.0, 0.0, 0.0])),
    Cause("both", -np.array([0.6, 0.8, 0.1, 0.02])),
    Cause("oil_grade", np.array([0.6, 0.8, -0.3, 0.0]), mean=0.15, spread=0.02, grade=46),
)


def one_memory(phi: float) -> Array:
    """All of the wander remembers by one correlation."""
    return np.where((phi == PHI) & (SHARE == 1.0), 1.0, 0.0)


@dataclass(frozen=True)
class Dense:
    """The nights as blocks: designs and residuals of each, and the covariance of a night's."""

    designs: tuple[Array, ...]
    residuals: tuple[Array, ...]
    within: Array

    @classmethod
    def of_seed(cls, seed: int, change: float = 0.1) -> Dense:
        generator = np.random.default_rng(seed)
        apart = np.abs(np.subtract.outer(np.arange(BLOCKS), np.arange(BLOCKS)))
        within = 1e-4 * (np.exp(-apart / 3.0) + np.eye(BLOCKS))
        designs, residuals = [], []
        for night in range(len(DAYS)):
            design = generator.normal(0.6, 0.3, (BLOCKS, Q_UNKNOWNS))
            covariance = within + design[:, :P] @ SPREAD @ design[:, :P].T
            noise = generator.multivariate_normal(np.zeros(BLOCKS), covariance)
            moved = change * design[:, 0] * (night >= 3)
            designs.append(design)
            residuals.append(noise + moved + 0.05 * design[:, 1])
        return cls(tuple(designs), tuple(residuals), within)

    def evidence(self, serial: float = 0.3, n_nights: int = KNOWN) -> Evidence:
        """The same as the watch is given it."""
        weighted = [design.T @ np.linalg.inv(self.within) for design in self.designs]
        window = Window(
            DAYS,
            np.array([part @ design for part, design in zip(weighted, self.designs, strict=True)]),
            np.array([part @ rest for part, rest in zip(weighted, self.residuals, strict=True)]),
            DISTANCE,
            np.zeros(len(DAYS)),
            PRIOR,
            np.zeros(Q_UNKNOWNS),
        )
        wander = Wander(SPREAD, one_memory(serial), SPREAD)
        causes = Causes.of(CAUSES)
        sums = Sums.of(window, wander, causes.basis)
        return Evidence(window, sums, wander, causes, OPERATING_ERROR, n_nights, 1)

    def covariance(self, start: int, serial: float, *, by_operation: bool) -> Array:
        """Of all blocks without a change.

        Shifts of correlated nights vary by more in their mean, of a long record by L: nights before
        the start have L Q, those since lie between Q and L Q so that m precise ones have f(m) Q. At
        other operating conditions errors within nights are inflated by f(m), too.
        """
        n = len(DAYS) - start
        lags = np.arange(1, n)
        short = 1.0 + 2.0 * float(np.sum((1.0 - lags / n) * serial**lags))
        long = (1.0 + serial) / (1.0 - serial)
        share = (1 / short - 1 / long) / (1 - 1 / long)
        is_other = by_operation and float(DISTANCE[start:].mean()) - 1.5 > 0.5
        nights = []
        for night, design in enumerate(self.designs):
            shift = design[:, :P] @ SPREAD @ design[:, :P].T
            once, often = (np.linalg.inv(self.within + factor * shift) for factor in (1.0, long))
            since = once / short if is_other else share * once + (1.0 - share) * often
            mixed = since if night >= start else often
            nights.append(np.linalg.inv(mixed))
        every = np.concatenate(self.designs)
        covariance = block_diag(*nights) + every @ np.linalg.inv(PRIOR) @ every.T
        if by_operation:
            beyond = min(max(float(DISTANCE[start:].mean()) - 1.5, 0.0), 4.0)
            late = every[:, :P] * np.repeat(np.arange(len(DAYS)) >= start, BLOCKS)[:, None]
            covariance = covariance + late @ np.diag((beyond * OPERATING_ERROR) ** 2) @ late.T
        return np.asarray(covariance)

    def moved(self, start: int, cause: Cause, shape: int) -> Array:
        """What a change of size 1 does to all blocks."""
        rise = np.ones(len(DAYS)) if shape == STEP else (DAYS - DAYS[start] + 1) / 10.0
        rise = np.where(np.arange(len(DAYS)) >= start, rise, 0.0)
        return np.concatenate(
            [x * design @ cause.direction for x, design in zip(rise, self.designs, strict=True)]
        )


def log_ratio_by_quadrature(
    data: Dense, start: int, cause: Cause, shape: int, covariance: Array
) -> float:
    """ln of the ratio of marginal likelihoods, the size integrated out numerically."""
    every, moved = np.concatenate(data.residuals), data.moved(start, cause, shape)
    blocks = multivariate_normal(np.zeros(len(every)), covariance)
    nothing = blocks.logpdf(every)
    spread = cause.spread if shape == STEP else cause.spread / 3.0
    is_half = cause.mean == 0.0 or shape == RAMP
    size = halfnorm(scale=spread) if is_half else norm(cause.mean, spread)

    low = 0.0 if is_half else cause.mean - 8 * spread
    sizes = np.linspace(low, low + (8 if is_half else 16) * spread, 4001)
    changed = blocks.logpdf(every - sizes[:, None] * moved)
    return math.log(simpson(np.exp(changed - nothing) * size.pdf(sizes), x=sizes))


@pytest.mark.parametrize("serial", [0.3, 0.8])
@pytest.mark.parametrize("by_operation", [False, True])
def test_sums_and_ratios_are_those_of_the_whole_model(serial: float, by_operation: bool) -> None:
    data = Dense.of_seed(1)
    starts = np.arange(1, len(DAYS))
    ratios = data.evidence(serial).of_starts(starts, by_operation=by_operation)
    for place, start in enumerate(starts.tolist()):
        covariance = data.covariance(start, serial, by_operation=by_operation)
        precise = np.linalg.inv(covariance)
        for shape in (STEP, RAMP):
            for of_cause, cause in enumerate(CAUSES):
                moved = data.moved(start, cause, shape)
                at = shape, place, of_cause
                first = moved @ precise @ np.concatenate(data.residuals)
                second = moved @ precise @ moved
                assert ratios.first[at] == pytest.approx(first, rel=1e-6, abs=1e-6)
                assert ratios.second[at] == pytest.approx(second, rel=1e-6)
                if shape == STEP:
                    # Posterior of the size, of a normal prior.
                    certain = second + cause.spread**-2
                    size = (first + cause.mean / cause.spread**2) / certain
                    assert ratios.size[at] == pytest.approx(size, rel=1e-6, abs=1e-9)
                    assert ratios.sd[at] == pytest.approx(certain**-0.5, rel=1e-6)
                wanted = log_ratio_by_quadrature(data, start, cause, shape, covariance)
                # Six pairs of shape and cause share the prior.
                assert ratios.log_ratio[at] == pytest.approx(wanted - math.log(6.0), abs=1e-4)


def test_a_start_without_one_of_its_nights_forgets_that_night() -> None:
    data, start, left_out = Dense.of_seed(3), 2, 4
    evidence = data.evidence()
    ratios = evidence.of_starts(np.array([start]), without=np.array([left_out]), by_operation=False)
    kept = np.repeat(np.arange(len(DAYS)) != left_out, BLOCKS)
    precise = np.linalg.inv(data.covariance(start, 0.3, by_operation=False)[np.ix_(kept, kept)])
    moved = data.moved(start, CAUSES[0], STEP)[kept]
    every = np.concatenate(data.residuals)[kept]
    assert ratios.first[STEP, 0, 0] == pytest.approx(moved @ precise @ every, rel=1e-6)
    assert ratios.second[STEP, 0, 0] == pytest.approx(moved @ precise @ moved, rel=1e-6)


def test_surroundings_are_what_nights_say_beside_a_line_in_time() -> None:
    data, end, long = Dense.of_seed(4), 5, 1.3 / 0.7
    own_row, along = np.array([0.5, 0.3, 0.1, 0.05]), np.array([0.6, 0.8, 0.1, 0.02])
    certain, score = block_diag(PRIOR, 0.1**-2), np.zeros(Q_UNKNOWNS + 1)
    for day, design, rest in zip(DAYS[:end], data.designs, data.residuals, strict=False):
        beside = np.column_stack([design, design @ along * (day - DAYS[end - 1]) / 10.0])
        shift = long * design[:, :P] @ SPREAD @ design[:, :P].T
        weighted = beside.T @ np.linalg.inv(data.within + shift)
        certain, score = certain + weighted @ beside, score + weighted @ rest
    level = np.eye(Q_UNKNOWNS) - np.outer(along, own_row) / (own_row @ along)
    evidence, uncertain = data.evidence(), np.linalg.inv(certain)
    found = surroundings(evidence.window, evidence.sums, own_row, along, end)
    assert found.mean == pytest.approx(level @ (uncertain @ score)[:-1], rel=1e-6, abs=1e-12)
    wanted = level @ uncertain[:-1, :-1] @ level.T
    assert found.covariance == pytest.approx(wanted, rel=1e-6, abs=1e-12)


def test_a_wander_from_few_nights_says_less() -> None:
    """Student's t in place of the normal, twice the gain as reported.

    ν = n(1 − φ²)/(1 + φ²) + 6, or 1.2 n over the inflation of so long a stretch in place of n(…).
    """
    data, phi = Dense.of_seed(1, change=0.5), 0.3
    starts = np.arange(1, len(DAYS))
    few, certain = (data.evidence(phi, n).of_starts(starts) for n in (15, KNOWN))
    lengths = [np.arange(1, len(DAYS) - start) for start in starts]
    inflation = np.array([1 + 2 * np.sum((1 - k / (len(k) + 1)) * phi**k) for k in lengths])
    freedom = 15 * np.minimum((1 - phi**2) / (1 + phi**2), 1.2 / inflation)[:, None] + 6
    mean = np.array([[[0.0, 0.0, 0.15]], [[0.0, 0.0, 0.0]]])
    spread = np.array([[[0.3, 0.3, 0.02]], [[0.1, 0.1, 0.02 / 3]]])
    gain = (certain.size / certain.sd) ** 2 - (mean / spread) ** 2
    most = gain.max()
    tempered = (freedom + 1) * np.log((freedom + most) / (freedom + most - gain))
    assert few.log_ratio - certain.log_ratio == pytest.approx(
        0.5 * (tempered - gain), abs=1e-4 * most
    )
    # What is left of the best is far less than all, and the order of the causes stays.
    assert few.log_ratio.max() < 0.5 * certain.log_ratio.max()
    assert few.log_ratio.argmax() == certain.log_ratio.argmax()


@pytest.mark.parametrize(("n_nights", "stand_for"), [(len(DAYS), 4.0), (len(DAYS) + 1, 1.0)])
def test_a_first_night_stands_for_starts_before_it_where_no_earlier_ones_are_known(
    n_nights: int, stand_for: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a ramp alone: a step has to begin behind the baseline."""
    evidence, ratios = Dense.of_seed(1).evidence(n_nights=n_nights), []
    for weight in (1.0, 4.0):
        monkeypatch.setattr("leakage.watch.choices.STARTS_BEFORE", weight)
        ratios.append(evidence.of_starts(np.array([0, 1])).log_ratio)
    assert np.all(np.isneginf(ratios[0][STEP, 0]))
    gained = ratios[1][RAMP] - ratios[0][RAMP]
    assert gained == pytest.approx(np.array([[math.log(stand_for)], [0.0]]) + np.zeros((2, 3)))


@pytest.mark.parametrize(("first", "last"), [(0, 0), (0, 39), (7, 200), (13, 350), (0, 1000)])
def test_thinned_starts_stand_for_all(first: int, last: int) -> None:
    starts, weights = starts_of(first, last)
    assert np.all(np.diff(starts) > 0)
    assert starts[0] >= first
    assert starts[-1] == last
    assert starts[-40:].tolist() == list(range(max(first, last - 39), last + 1))
    n = last - first + 1
    assert np.exp(weights).sum() == pytest.approx(n, rel=0.0 if n <= 40 else 0.07)
    assert len(starts) <= 40 + 24 * math.log2(n / 40 + 1)


def test_a_ramp_has_risen_by_a_day_on_its_first_night_and_less_its_mean_in_the_baseline() -> None:
    """By hand, in ten days: the baseline is the first night, the newest the 107th."""
    risen = Dense.of_seed(1).evidence().risen(np.array([0, 3]))
    assert risen == pytest.approx([0.8 - 0.1, 0.3])


ALL_PATHS = np.array([0.7, 0.3])


def one_path(shifts: Array, days: NDArray[np.int64] | None = None) -> Wander:
    """Wander of a machine of one path, of which nothing else is known."""
    when = np.arange(len(shifts)) if days is None else days
    # Nights that tell their shifts exactly.
    information, score = np.full((len(shifts), 1, 1), 1e9), 1e9 * shifts[:, None]
    wide = np.array([[1e-9]])
    return estimate_wander(information, score, when, np.ones(1), wide, WanderPrior())


def test_a_night_with_its_own_shift_says_what_its_blocks_say_with_it_in_their_errors() -> None:
    generator = np.random.default_rng(1)
    design, residuals = generator.normal(size=(9, 4)), generator.normal(size=9)
    spread = np.array([[2.0, 0.5], [0.5, 1.0]])
    (sums,) = effective((design.T @ design)[None], (design.T @ residuals)[None], spread)
    precise = np.linalg.inv(np.eye(9) + design[:, :2] @ spread @ design[:, :2].T)
    assert sums[:, :-1] == pytest.approx(design.T @ precise @ design, rel=1e-8)
    assert sums[:, -1] == pytest.approx(design.T @ precise @ residuals, rel=1e-8)


def test_spread_and_memory_are_found_again() -> None:
    n, phi = 600, 0.6
    spread = 1e-4 * np.array([[1.5, 0.6], [0.6, 0.8]])
    series = np.column_stack([autoregression(n, phi, np.random.default_rng(k)) for k in (1, 2)])
    shifts = series @ np.linalg.cholesky(spread).T
    # Blocks tell each night's paths well, and a third unknown, which does not wander.
    generator = np.random.default_rng(3)
    information = np.empty((n, 3, 3))
    score = np.empty((n, 3))
    for night in range(n):
        design = generator.normal(size=(6, 3)) / 0.001
        true = np.array([*(np.array([0.02, -0.01]) + shifts[night]), 0.05])
        information[night] = design.T @ design
        score[night] = design.T @ (design @ true + generator.standard_normal(6))
    days = np.arange(n)
    wander = estimate_wander(
        information, score, days, ALL_PATHS, np.diag([1.0, 1.0, 1.0]), WanderPrior()
    )
    assert wander.spread == pytest.approx(spread, rel=0.25)
    assert wander.serial == pytest.approx(phi, abs=0.08)


def correlations(memory: Array, days: Array | NDArray[np.int64]) -> Array:
    """Of nights' shifts: a share of the variance remembers, what is left does not."""
    apart = np.abs(np.subtract.outer(days, days)).astype(float)
    alike = SHARE[:, None, None] * PHI[:, None, None] ** apart
    alike += (1.0 - SHARE)[:, None, None] * np.eye(len(days))
    return np.asarray(np.einsum("g,gij->ij", memory, alike))


def test_spread_of_few_nights_is_by_hand() -> None:
    """Of precise nights and a line that is estimated too, EM gives Q = (Σ(s − ŝ)² + 6 Q₀)/(n + 4).

    Correlated nights scatter less about their own line: what is not prior is scaled up by that.
    """
    shifts = 0.02 * np.array([0.3, -1.2, 0.8, 1.9, -0.6, -0.1, 1.1, -1.5])
    days, prior = np.arange(8), 0.012**2
    line = np.column_stack([np.ones(8), days])
    left = np.eye(8) - line @ np.linalg.pinv(line)
    wander = one_path(shifts)
    correlated = float(np.trace(left @ correlations(wander.memory, days)))
    assert correlated > 0.4 * 8
    of_nights = (8 + 6) * (shifts @ left @ shifts + 6 * prior) / (8 + 4) - 6 * prior
    wanted = (6 / correlated * of_nights + 6 * prior) / (8 + 6)
    assert wander.spread.item() == pytest.approx(wanted, rel=0.03)


def test_slow_wear_is_no_wander() -> None:
    shifts = 0.01 * np.random.default_rng(5).standard_normal(30)
    still, worn = (one_path(shifts + rise * np.arange(30)) for rise in (0.0, 0.004))
    assert worn.spread.item() == pytest.approx(still.spread.item(), rel=0.1)
    assert worn.serial == pytest.approx(still.serial, abs=0.02)


def test_only_what_moves_all_paths_remembers_for_long() -> None:
    """The part of Q that is common to two paths by halves; a difference between them has none."""
    spread, common = np.diag([1.0, 1.0]), np.full((2, 2), 0.5)
    wander = Wander(spread, USUAL_MEMORY, common)
    long = wander.long_inflation
    assert long > 4.0
    both, apart = np.array([1.0, 1.0]), np.array([1.0, -1.0])
    assert both @ wander.long_spread @ both == pytest.approx(long * 2.0)
    assert apart @ wander.long_spread @ apart == pytest.approx(4.0 * 2.0)


@pytest.mark.parametrize("is_even", [True, False])
def test_memory_is_by_the_likelihood_of_what_a_line_leaves(is_even: bool) -> None:
    """Contrasts free of level and slope are Gaussian; their scale is profiled out."""
    days = np.arange(12) if is_even else np.array([0, 1, 3, 6, 7, 8, 12, 13, 14, 25, 26, 40])
    shifts = 0.01 * np.sin(days / 2.0) + 0.004 * np.cos(3 * days)
    free = null_space(np.column_stack([np.ones(12), days]).T)
    log_likelihood = []
    for memory in np.eye(len(PHI)):
        covariance = free.T @ correlations(memory, days) @ free
        left = free.T @ shifts
        squares = left @ np.linalg.solve(covariance, left)
        log_likelihood.append(-0.5 * np.linalg.slogdet(covariance)[1] - 5 * np.log(squares))
    wanted = USUAL_MEMORY * np.exp(np.array(log_likelihood))
    assert one_path(shifts, days).memory == pytest.approx(wanted / wanted.sum(), rel=1e-3)


def test_mean_of_correlated_nights_varies_by_more() -> None:
    wander = Wander(np.eye(1), USUAL_MEMORY, np.eye(1))
    for n in (1, 2, 7, 40):
        wanted = n * correlations(USUAL_MEMORY, np.arange(n)).mean()
        assert wander.inflation(np.array([float(n)])).item() == pytest.approx(wanted)
    assert wander.inflation(np.array([1e6])).item() == pytest.approx(
        wander.long_inflation, rel=1e-3
    )
