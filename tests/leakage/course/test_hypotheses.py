"""A common factor or paths: nights simulated through the laws, with what sensors do by themselves.

Each night has its own load, and wander: 0.3 °C, 0.3 % of gain, 0.3 bar.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
import pytest

from benchmarks import error_kinds
from leakage import Motor, OperatingConditions, regressors
from leakage.course.growth import Blocks, Growth, Shift, growth
from leakage.course.hypotheses import CommonFactor, Posterior, mean_factor, weigh
from leakage.errors import ShapeError
from pipeline.demo.noise import autoregression
from tests.leakage.made_samples import true_coefficients
from tests.leakage.placeholders import placeholder_motor

BASELINE, NOW, SAMPLES = 30, 8, 900
MOTOR: Motor = placeholder_motor()
THETA = true_coefficients(MOTOR)
NAMES = RING, _, SLEEVE = tuple(path.name for path in MOTOR.column_paths)
FREE = np.array([True, True, True, False])


@dataclass(frozen=True)
class Change:
    """Simulated change: viscosity, gain, the sensor's temperature [°C], K of paths, flushing."""

    viscosity: float = 1.0
    gain: float = 1.0
    reads_low_c: float = 0.0
    paths: Mapping[str, float] = field(default_factory=dict)
    flushing: float = 0.0


@dataclass(frozen=True)
class Load:
    """Ranges of pressure [bar] and speed [rpm]."""

    pressure: tuple[float, float] = (15.0, 300.0)
    speed: tuple[float, float] = (3.0, 110.0)


def nights(n: int, change: Change, load: Load, seed: int) -> Blocks:
    """A block of every third of each night."""
    generator = np.random.default_rng(seed)
    shape = (SAMPLES, n)

    def steps(low: float, high: float, held: int = 10) -> np.ndarray:
        return np.repeat(generator.uniform(low, high, (SAMPLES // held, n)), held, axis=0)

    pressure, speed = steps(*load.pressure), steps(*load.speed)
    temperature = steps(42.0, 58.0, SAMPLES // 3)
    wander = error_kinds.night_wander(generator, (n,))
    truth = OperatingConditions.from_bar(
        (pressure - wander.pressure_bar).T.ravel(),
        (temperature - wander.temperature_c + change.reads_low_c).T.ravel(),
        speed.T.ravel(),
    )
    theta = THETA * [*(change.paths.get(name, 1.0) for name in NAMES), 1.0]
    flow = regressors(MOTOR, truth) @ np.append(theta, 1.0) / change.viscosity + change.flushing
    errors = 0.013 * autoregression(generator.standard_normal(shape), 0.9).T.ravel()
    flow *= change.gain * (1.0 + np.repeat(wander.gain, SAMPLES)) * (1.0 + errors)
    seen = OperatingConditions.from_bar(pressure.T.ravel(), temperature.T.ravel(), speed.T.ravel())
    columns = np.column_stack([regressors(MOTOR, seen), flow]).reshape(3 * n, SAMPLES // 3, -1)
    means = temperature.T.reshape(3 * n, -1).mean(axis=1)
    return Blocks(np.linalg.qr(columns, mode="r"), np.repeat(np.arange(n), 3), means)


@cache
def baseline(load: Load, seed: int) -> Blocks:
    return nights(BASELINE, Change(), load, seed)


def grown(change: Change, seed: int, load: Load = Load()) -> Growth:
    now = nights(NOW, change, load, 1000 + seed)
    found = growth(NAMES, baseline(load, seed), now, THETA, FREE, "cam_roller")
    assert found is not None
    return found


def explained(change: Change, seed: int, load: Load = Load()) -> Posterior:
    return weigh(grown(change, seed, load))


SEEDS = (1, 2, 3)
COMMON = {
    "oil 10 % thinner": (Change(viscosity=0.9), 1 / 0.9),
    "oil 20 % thinner": (Change(viscosity=0.8), 1.25),
    "oil 20 % thicker": (Change(viscosity=1.25), 0.8),
    "gain 6 % high": (Change(gain=1.06), 1.06),
    # VG 68 loses 4.5 % of its viscosity a kelvin at 50 °C.
    "temperature 3 °C low": (Change(reads_low_c=3.0), np.exp(3 * 0.0435)),
}


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("name", COMMON)
def test_what_scales_all_flows_is_never_told_as_a_path(name: str, seed: int) -> None:
    change, factor = COMMON[name]
    found = explained(change, seed)
    assert found.named == ()
    assert np.exp(found.factor.log) == pytest.approx(factor, abs=3.5 * found.factor.sd * factor)
    assert found.factor.sd < 0.03
    assert found.common > 0.8


def test_a_change_of_all_flows_is_told_on_most_motors() -> None:
    for change, _ in COMMON.values():
        assert [explained(change, seed).verdict for seed in SEEDS].count("common") >= 2


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("path", NAMES)
def test_a_path_that_wears_by_thirty_percent_is_named_alone(path: str, seed: int) -> None:
    found = explained(Change(paths={path: 1.3}), seed)
    assert found.named == (path,)
    assert not found.is_common


@pytest.mark.parametrize("path", NAMES)
def test_wear_with_thinner_oil_is_both(path: str) -> None:
    found = explained(Change(viscosity=0.8, paths={path: 1.3}), 1)
    assert found.named == (path,)
    assert found.is_common
    assert np.exp(found.factor.log) == pytest.approx(1.25, abs=0.06)


def test_two_paths_that_wear_are_both_named() -> None:
    assert explained(Change(paths={RING: 1.3, SLEEVE: 1.3}), 1).named == (RING, SLEEVE)


def test_a_healthy_motor_has_neither() -> None:
    for seed in SEEDS:
        found = explained(Change(), seed)
        assert found.named == ()
        assert not found.is_common


def test_the_change_with_temperature_tells_a_sensor_from_thinner_oil() -> None:
    """−2.1 % per 10 K for 3 °C; 0 for a gain or thinner oil (model.md, section 8)."""
    found = [grown(Change(reads_low_c=3.0), seed).with_temperature for seed in SEEDS]
    of_oil = [grown(Change(viscosity=0.9), seed).with_temperature for seed in SEEDS]
    for one, expected in ((found, -0.0021), (of_oil, 0.0)):
        betas = [each for each in one if each is not None]
        assert len(betas) == len(SEEDS)
        mean, error = np.mean(betas, axis=0)
        assert mean == pytest.approx(expected, abs=3 * error)
        assert error < 0.0015


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("viscosity", [0.8, 0.9, 1.25])
def test_thinner_oil_is_told_beside_an_estimated_flushing(viscosity: float, seed: int) -> None:
    before = nights(BASELINE, Change(flushing=0.5), Load(), seed)
    now = nights(NOW, Change(viscosity=viscosity, flushing=0.5), Load(), 1000 + seed)
    change = growth(NAMES, before, now, THETA, np.ones(4, dtype=np.bool_), "cam_roller")
    assert change is not None
    assert change.shift is not None
    told = weigh(change)
    assert told.verdict == "common"
    assert told.taken_back is None
    # The flow of all gaps, rollers included, moves by one factor; the flushing stays.
    sd = np.sqrt(np.diag(change.shift.covariance))
    assert change.shift.gaps == pytest.approx(1 / viscosity - 1, abs=4 * sd[0] + 0.02)
    assert change.shift.flushing == pytest.approx(0.0, abs=4 * sd[1] + 0.02)


def taking_back(flushing: float, sd: float) -> Growth:
    """Gaps that halved, known to `sd`, beside a flushing; both together are known to 0.5 %."""
    whole = 0.005**2 * np.diag([0.0, 1.0])
    covariance = sd**2 * np.array([[1.0, -1.0], [-1.0, 1.0]]) + whole
    return Growth(
        ("gaps",),
        False,
        np.array([-0.5]),
        covariance[:1, :1],
        np.eye(1),
        shift=Shift(-0.5, flushing, covariance, 3.0),
    )


@pytest.mark.parametrize(
    ("flushing", "sd", "is_common"),
    [
        (0.0, 0.01, True),
        (0.05, 0.01, True),  # less than a model does that is somewhat off
        (-0.1, 0.01, True),  # with the gaps, as a meter's gain moves it
        (0.6, 0.01, False),
        (0.2, 0.01, False),  # the whole flow fell, and less than by oil
        (0.2, 0.08, True),  # the same within what the nights tell
        (0.49, 0.16, False),  # the whole flow stayed
    ],
)
def test_a_factor_that_the_flushing_takes_back_is_not_told(
    flushing: float, sd: float, is_common: bool
) -> None:
    found = weigh(taking_back(flushing, sd))
    assert found.is_common is is_common
    assert found.verdict == ("common" if is_common else "cannot_be_told")
    assert found.named == ()
    assert (found.taken_back is None) is is_common


def test_a_factor_that_the_tank_has_is_the_oil_whatever_the_flushing_did() -> None:
    found = weigh(taking_back(0.6, 0.01), CommonFactor(np.log(0.5), 0.015))
    assert found.is_of_tank
    assert found.is_common
    elsewhere = weigh(taking_back(0.6, 0.01), CommonFactor(0.0, 0.015))
    assert elsewhere.origin is None


def test_at_one_speed_the_rollers_and_pistons_are_the_standard_together() -> None:
    """Their columns are one and the same; ring and sleeve still stand out."""
    load = Load(speed=(30.0, 30.0))
    thin = explained(Change(viscosity=0.8), 1, load)
    assert not thin.has_standard
    assert thin.named == ()
    assert np.exp(thin.factor.log) == pytest.approx(1.25, abs=0.06)
    assert explained(Change(paths={RING: 1.3}), 1, load).named == (RING,)


def test_at_one_pressure_and_speed_no_path_is_named_and_the_tank_decides() -> None:
    load = Load(pressure=(180.0, 180.0), speed=(30.0, 30.0))
    found = grown(Change(viscosity=0.8), 1, load)
    assert weigh(found).verdict == "cannot_be_told"
    assert weigh(found).unjudged
    with_tank = weigh(found, CommonFactor(np.log(1.25), 0.015))
    assert with_tank.named == ()
    assert with_tank.is_of_tank


def test_last_digits_of_the_columns_move_no_probability() -> None:
    """At one pressure but for one night of the baseline, which alone tells what the others do."""
    load = Load(pressure=(179.7, 180.3))
    now = nights(NOW, Change(paths={SLEEVE: 1.3}), load, 1001)
    before = baseline(load, 1)
    other = nights(1, Change(), Load(pressure=(170.0, 190.0)), 2).factors
    factors = np.concatenate([other, before.factors[3:]])

    def found(disturbed_by: float) -> Posterior:
        noise = 1.0 + disturbed_by * np.random.default_rng(3).standard_normal(factors.shape)
        then = replace(before, factors=factors * noise)
        change = growth(NAMES, then, now, THETA, FREE, "cam_roller")
        assert change is not None
        return weigh(change)

    one, two = found(0.0), found(1e-13)
    assert one.common == pytest.approx(two.common, rel=1e-6)
    assert one.paths == pytest.approx(two.paths, rel=1e-6)


def test_the_others_factor_is_the_tanks_or_the_sensor_is_its_own() -> None:
    thin = grown(Change(viscosity=0.8), 1)
    assert weigh(thin, CommonFactor(np.log(1.25), 0.015)).origin == "tank"
    assert weigh(thin, CommonFactor(0.0, 0.015)).origin == "own_sensor"
    worn = weigh(grown(Change(paths={SLEEVE: 1.3}), 1), CommonFactor(0.0, 0.015))
    assert worn.named == (SLEEVE,)
    assert worn.origin is None


def test_factors_of_several_motors_scatter_by_what_they_differ_in() -> None:
    same = mean_factor([CommonFactor(0.2, 0.02)] * 4)
    assert (same.log, same.sd) == pytest.approx((0.2, 0.01))
    apart = mean_factor([CommonFactor(0.0, 0.02), CommonFactor(0.4, 0.02)])
    assert (apart.log, apart.sd) == pytest.approx((0.2, 0.2))


def test_blocks_of_another_shape_are_refused() -> None:
    blocks = baseline(Load(), 1)
    with pytest.raises(ShapeError, match=r"expected \(m, 6, 6\) and \(m,\)"):
        growth(NAMES, replace(blocks, nights=blocks.nights[:-1]), blocks, THETA, FREE)
