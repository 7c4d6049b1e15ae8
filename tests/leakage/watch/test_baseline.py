"""What the first nights fix: columns, errors within a night, and causes of a change."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from leakage.watch import Machine, NightBlocks
from leakage.watch.baseline import Baseline, Columns, baseline_of, knots_at
from leakage.watch.causes import Cause, causes_of
from leakage.watch.within_night import (
    START,
    BlockErrors,
    estimate_errors,
    night_information,
    unexplained_share,
)
from tests.leakage.watch.made_machine import (
    CB560,
    COEFFICIENTS,
    VG_46,
    VG_68,
    Film,
    Plant,
    kinematic_viscosity,
    slow_errors,
)

Array = NDArray[np.float64]


def mean_residual(baseline: Baseline, nights: Sequence[NightBlocks]) -> float:
    every = [baseline.columns.of_night(night) for night in nights]
    return float(
        np.concatenate([rest - design @ baseline.unknowns for design, rest in every]).mean()
    )


def test_coefficients_of_the_fitted_machine_are_found_again() -> None:
    nights = Plant().nights(60, 1)
    baseline = baseline_of(CB560, nights)
    assert baseline.columns.theta == pytest.approx(COEFFICIENTS, rel=0.05, abs=0.0)
    assert baseline.columns.least_scale == pytest.approx(
        0.2 * np.mean([night.flow for night in nights])
    )
    assert (baseline.all_paths[:4] * baseline.share).sum() == pytest.approx(1.0, abs=0.02)


def test_a_drive_that_counts_backwards_has_a_coefficient_all_the_same() -> None:
    """However small it is beside 1: a speed's sign is that of a sensor."""
    turned = np.array([-COEFFICIENTS[0], 1.0, 1.0, 1.0])
    nights = [replace(night, drives=night.drives * turned) for night in Plant().nights(15, 1)]
    before = baseline_of(CB560, Plant().nights(15, 1)).columns.theta
    assert np.abs([night.drives[:, 0] for night in nights]).mean() < 1.0
    assert baseline_of(CB560, nights).columns.theta[0] == pytest.approx(
        before[0] / COEFFICIENTS[0], rel=1e-3
    )


@pytest.mark.parametrize(
    "plant",
    [
        Plant(),
        Plant(film="slot"),
        Plant(film="turbulent"),
        Plant(operating_point="one pressure"),
        Plant(blocks=5),
        Plant(wander=0.03),
    ],
    ids=["fitted", "slot", "turbulent", "one pressure", "ten minutes", "wild"],
)
@pytest.mark.parametrize("n", [8, 40])
def test_mean_residual_of_the_baseline_is_within_one_per_cent(plant: Plant, n: int) -> None:
    nights = plant.nights(n, 2)
    baseline = baseline_of(CB560, nights)
    assert abs(mean_residual(baseline, nights)) < 0.01
    assert np.all(baseline.columns.theta >= 0.0)


def test_the_models_error_tells_the_fitted_machine_from_another() -> None:
    for seed in range(5):
        assert baseline_of(CB560, Plant().nights(15, seed)).model_error < 0.009
        assert baseline_of(CB560, Plant(film="turbulent").nights(15, seed)).model_error > 0.03


# Orifice, drag and constant beside a CB560, in mean flows of it.
BESIDE = {"orifice and drag": (0.8, 0.3, 0.0), "drag and constant": (0.0, 0.4, 0.3)}


def with_further_flows(nights: Sequence[NightBlocks], shares: Sequence[float]) -> list[NightBlocks]:
    """Nights of a machine with these flows beside, at 160 bar and 50 rpm."""
    orifice, drag, constant = 1.365 * np.array(shares)
    return [
        replace(
            night,
            flow=night.flow
            + orifice * np.sqrt(night.conditions[:, 1] / 160.0)
            + drag * night.conditions[:, 2] / 50.0
            + constant,
        )
        for night in nights
    ]


@pytest.mark.parametrize("shares", BESIDE.values(), ids=BESIDE)
def test_flows_that_follow_no_viscosity_stand_beside_the_model_where_it_misses_much(
    shares: Sequence[float],
) -> None:
    """7c.10: most of what the model misses is theirs; the verdict is on the model all the same."""
    nights = with_further_flows(Plant().nights(15, 1), shares)
    baseline = baseline_of(CB560, nights)
    assert baseline.model_error > 0.05
    assert baseline.lack_of_fit < 0.4 * baseline.model_error
    # Oil that is warmer is no other duty, and a share of theirs is no error by another one.
    warmer = with_further_flows(Plant(warmer_c=lambda _: 12.0).nights(1, 9), shares)[0]
    colder = with_further_flows(Plant().nights(1, 9), shares)[0]
    assert baseline.distance(warmer) < baseline.distance(colder) + 1.0
    assert not baseline.operating_error[baseline.columns.n_driven :].any()
    # Another grade of oil moves none of them.
    (grade, *_) = [cause for cause in causes_of(CB560, baseline) if cause.grade == 46]
    further = slice(baseline.columns.n_driven, baseline.n_paths)
    assert not grade.direction[further].any()


def test_where_nothing_follows_the_oil_all_flows_are_those_that_do_not() -> None:
    """A direction that is no flow would size a change of the meter by the surface alone."""
    nights = [replace(night, flow=0.0 * night.flow) for night in Plant().nights(15, 1)]
    baseline = baseline_of(CB560, with_further_flows(nights, (0.5, 0.3, 0.2)))
    for cause in causes_of(CB560, baseline):
        if cause.name in ("all_flows", "oil_grade", "temperature_sensor"):
            assert abs(cause.direction @ baseline.own_row) > 0.1


def test_air_in_the_drain_line_is_no_part_of_the_baseline() -> None:
    """A block in twenty shows twice the flow: ordinary ones of the same nights do not lie below."""
    nights = Plant().nights(15, 1)
    airy = [
        replace(night, flow=night.flow * np.where(np.arange(30) % 20 == night.day, 2.0, 1.0))
        for night in nights
    ]
    baseline = baseline_of(CB560, airy)
    assert abs(mean_residual(baseline, nights)) < 0.01


def test_a_path_that_does_not_leak_has_a_coefficient_of_zero_and_costs_nothing() -> None:
    """A path that would be fitted below 0: clipped afterwards, it would put ŷ off."""
    nights = Plant(growth=lambda _: np.array([1.0, 0.0, 1.0, 1.0])).nights(15, 3)
    pulling = [
        replace(night, flow=night.flow - 0.1 * COEFFICIENTS[1] * night.drives[:, 1])
        for night in nights
    ]
    baseline = baseline_of(CB560, pulling)
    assert baseline.columns.theta[1] == 0.0
    assert np.all(baseline.columns.unit > 0.0)
    assert abs(mean_residual(baseline, pulling)) < 0.01


def test_one_pressure_tells_no_gap_from_another() -> None:
    still, varied = (
        baseline_of(CB560, Plant(operating_point=operating_point).nights(15, 7))
        for operating_point in ("one pressure", "varied")
    )
    assert (still.identifies_gaps, still.identifies_speed) == (False, False)
    assert (varied.identifies_gaps, varied.identifies_speed) == (True, True)


@pytest.mark.parametrize(("film", "tells"), [("barus", True), ("slot", True), ("turbulent", False)])
def test_gaps_are_not_distinguished_where_the_model_misses_the_shape(
    film: Film, *, tells: bool
) -> None:
    assert baseline_of(CB560, Plant(film=film).nights(15, 1)).identifies_gaps == tells


COLUMNS = Columns(
    sign=np.array([1.0, -1.0]),
    theta=np.array([2.0, 0.0]),
    unit=np.array([2.0, 0.5]),
    least_scale=1.0,
    temperature_c=50.0,
    pressure_knots=np.array([100.0, 200.0]),
    speed_knots=np.array([10.0]),
    has_zero=True,
    further=np.empty(0),
)
# Warm and busy; at a tenth of the flow, half way between the knots; and beyond them, cold.
NIGHT = NightBlocks(
    7,
    np.array([60.0, 180.0, 300.0]),
    np.array([[2.0, -1.0], [0.2, -1.0], [1.0, 0.0]]),
    np.array([4.4, 0.5, 2.0]),
    np.array([[60.0, 100.0, 10.0], [50.0, 150.0, 10.0], [40.0, 250.0, 10.0]]),
)


def test_residuals_are_shares_of_the_expected_flow_but_for_a_floor_in_the_scale() -> None:
    """By hand: ŷ = 4, 0.4 and 2; at 0.4 it is (0.5 − 0.4)/1, not (0.5 − 1)/1."""
    _, residuals = COLUMNS.of_night(NIGHT)
    assert residuals == pytest.approx([0.1, 0.1, 0.0])


def test_design_is_by_hand() -> None:
    """By columns: paths in their units; warmth in 10 K and its square, of ŷ, and of each path;
    surface, of ŷ; zero of 5 l/min.
    """
    design, _ = COLUMNS.of_night(NIGHT)
    assert COLUMNS.n == 9
    assert design == pytest.approx(
        np.array(
            [
                [1.0, 0.5 / 4.0, 1.0, 1.0, 1.0, 0.5 / 4.0, 1.0, 0.0, 1.25],
                [0.4, 0.5, 0.0, 0.0, 0.0, 0.0, 0.2, 0.2, 5.0],
                [1.0, 0.0, -1.0, 1.0, -1.0, 0.0, 0.0, 1.0, 2.5],
            ]
        )
    )


def test_knots_that_are_near_are_merged() -> None:
    values = np.concatenate([np.full(500, 100.0), np.linspace(101.0, 300.0, 500)])
    knots = knots_at(values, (0.02, 0.35, 0.65, 0.98), 0.10)
    assert len(knots) == 3
    assert np.all(np.diff(knots) > 0.1 * 300.0)


MIDDLE_S: Array = np.linspace(60.0, 3540.0, 30)
TRUTH = BlockErrors(0.012, 0.006, 0.01, 700.0)


def made_nights(n: int, seed: int) -> list[tuple[Array, Array]]:
    generator = np.random.default_rng(seed)
    made = []
    for _ in range(n):
        residuals = slow_errors(MIDDLE_S, TRUTH.slow, TRUTH.memory_s, generator)
        residuals += TRUTH.block * generator.standard_normal(len(MIDDLE_S))
        made.append((MIDDLE_S, residuals + TRUTH.night * generator.standard_normal()))
    return made


def test_errors_are_found_again() -> None:
    found = estimate_errors(made_nights(60, 1), BlockErrors.of(START))
    assert found.block == pytest.approx(TRUTH.block, rel=0.1)
    assert found.slow == pytest.approx(TRUTH.slow, rel=0.2)
    assert found.memory_s == pytest.approx(TRUTH.memory_s, rel=0.4)
    assert found.night == pytest.approx(TRUTH.night, rel=0.4)


def test_information_is_that_of_generalised_least_squares() -> None:
    generator = np.random.default_rng(3)
    design = generator.uniform(0.2, 0.5, (len(MIDDLE_S), 3))
    residuals = made_nights(1, 4)[0][1] - design @ np.array([0.1, -0.2, 0.0])
    apart = np.abs(np.subtract.outer(MIDDLE_S, MIDDLE_S))
    covariance = TRUTH.slow**2 * np.exp(-apart / TRUTH.memory_s)
    covariance += TRUTH.block**2 * np.eye(len(MIDDLE_S))
    precise = np.linalg.inv(covariance)
    information, score = night_information(design, residuals, MIDDLE_S, TRUTH, 2)
    assert information == pytest.approx(design.T @ precise @ design, rel=1e-9)
    assert score == pytest.approx(design.T @ precise @ residuals, rel=1e-9)


def test_one_odd_block_counts_less() -> None:
    generator = np.random.default_rng(5)
    design = generator.uniform(0.2, 0.5, (len(MIDDLE_S), 2))
    residuals = made_nights(1, 6)[0][1]
    odd = residuals.copy()
    odd[11] += 0.4
    kept = np.arange(len(MIDDLE_S)) != 11
    without = np.linalg.solve(
        *night_information(design[kept], residuals[kept], MIDDLE_S[kept], TRUTH, 2)
    )
    weighed = np.linalg.solve(*night_information(design, odd, MIDDLE_S, TRUTH, 2))
    whole = np.linalg.inv(TRUTH.covariance(MIDDLE_S))
    believed = np.linalg.solve(design.T @ whole @ design, design.T @ whole @ odd)
    assert np.abs(weighed - without).max() < 0.15 * np.abs(believed - without).max()


def test_a_broken_path_makes_no_block_odd() -> None:
    """Against the night's mean its busy blocks would be outliers of thirty standard deviations."""
    share = np.zeros(len(MIDDLE_S))
    share[::10] = 0.4
    design = np.column_stack([share, 0.6 - 0.3 * share])
    broken = made_nights(1, 7)[0][1] + 2.0 * share
    information, score = night_information(design, broken, MIDDLE_S, TRUTH, 2)
    precise = np.linalg.inv(TRUTH.covariance(MIDDLE_S))
    assert information == pytest.approx(design.T @ precise @ design, rel=1e-9)
    assert np.linalg.solve(information, score)[0] == pytest.approx(2.0, abs=0.1)


def conditions_of(seed: int) -> Array:
    """Temperature, pressure and speed of thirty blocks."""
    generator = np.random.default_rng(seed)
    ends = (45.0, 60.0), (60.0, 280.0), (5.0, 45.0)
    return np.column_stack([generator.uniform(low, high, 30) for low, high in ends])


def flow_at(conditions: Array, warmer_k: float = 0.0) -> Array:
    """A flow that goes with pressure over viscosity, and with the speed, [l/min]."""
    temperature, bar, rpm = conditions.T
    return 0.004 * bar * np.exp((temperature + warmer_k - 50.0) / 25.0) + 0.01 * rpm


OWN = conditions_of(1)


@pytest.mark.parametrize(
    ("flow", "least", "most"),
    [
        pytest.param(1.3 * flow_at(OWN) + 0.05, 0.0, 1e-3, id="another gain and zero"),
        pytest.param(flow_at(OWN) + 2e-5 * OWN[:, 1] ** 2, 0.0, 1e-3, id="a path of another law"),
        pytest.param(flow_at(OWN, 5.0), 0.0, 5e-3, id="a temperature sensor 5 K low"),
        pytest.param(
            0.1 * flow_at(OWN) - 0.1, 0.0, 1e-3, id="less than the flushing that is known"
        ),
        pytest.param(flow_at(conditions_of(2)), 0.15, 0.6, id="the meter of another motor"),
        pytest.param(0.74 + 0.01 * np.cos(np.arange(30)), 0.15, 0.6, id="a meter that is stuck"),
    ],
)
def test_what_conditions_leave_unexplained(flow: Array, least: float, most: float) -> None:
    """Nothing of wear, oil and gain; where it does not follow, more than a seventh of the flow."""
    assert least <= unexplained_share(flow, flow_at(OWN), OWN, 0.4) < most


def test_a_short_night_tells_nothing_of_what_is_unexplained() -> None:
    assert math.isnan(unexplained_share(flow_at(OWN)[:12], flow_at(OWN)[:12], OWN[:12], 0.4))
    constant = np.tile(OWN[0], (30, 1))
    assert unexplained_share(flow_at(constant), flow_at(constant), constant, 0.4) < 1e-9


BASELINE = baseline_of(CB560, Plant().nights(15, 1))


def named(name: str, machine: Machine = CB560, baseline: Baseline = BASELINE) -> list[Cause]:
    return [cause for cause in causes_of(machine, baseline) if cause.name == name]


def assert_follows(cause: Cause, factor: Array) -> None:
    """All flows by a factor less 1 that is given at T₀, T₀ + 5 K and T₀ − 5 K.

    Per size at T₀ it is 1 + β x + γ x² of x = (T − T₀)/10 K, through the three points.
    """
    size = abs(float(factor[0]))
    bend, slope, level = np.polyfit([0.0, 0.5, -0.5], factor / size, 2)
    wanted = level * BASELINE.all_flows
    wanted[4:6] += slope, bend
    assert cause.direction == pytest.approx(wanted, rel=1e-7)


def test_a_path_that_is_next_to_nothing_cannot_fall() -> None:
    for share, n in ((0.04, 1), (0.06, 2)):
        own_row = BASELINE.own_row.copy()
        own_row[0] = share / BASELINE.all_paths[0]
        assert len(named("ring", baseline=replace(BASELINE, own_row=own_row))) == n


def test_all_gaps_leave_what_is_known_and_all_flows_take_the_surface_too() -> None:
    gaps, flows = named("all_gaps")[0].direction, named("all_flows")[0].direction
    in_units = BASELINE.columns.theta / BASELINE.columns.unit
    assert gaps[:4] == pytest.approx([*in_units[:3], 0.0])
    assert not gaps[4:].any()
    assert flows == pytest.approx([*in_units, *BASELINE.unknowns[4:-1], 0.0])


def test_another_grade_is_by_the_standard() -> None:
    """Flow goes with 1/ν: another level, and another slope over temperature."""
    middle_c = BASELINE.columns.temperature_c
    thin = {cause.grade: cause for cause in named("oil_grade")}
    assert set(thin) == {32, 46, 100}
    at_c = np.array([middle_c, middle_c + 5.0, middle_c - 5.0])
    ratio = kinematic_viscosity(VG_68, at_c) / kinematic_viscosity(VG_46, at_c) - 1.0
    # By hand at 50 °C: 42.867 / 29.973 − 1.
    at_50_c = kinematic_viscosity(VG_68, 50.0) / kinematic_viscosity(VG_46, 50.0) - 1.0
    assert at_50_c == pytest.approx(0.43019, abs=1e-4)
    assert thin[46].mean == pytest.approx(ratio[0], rel=1e-9)
    assert thin[46].spread == pytest.approx(0.15 * ratio[0], rel=1e-9)
    assert not thin[46].is_half
    assert_follows(thin[46], ratio)
    assert thin[100].mean < 0.0


@pytest.mark.parametrize(("place", "shift_k"), [(0, 5.0), (1, -5.0)])
def test_a_temperature_sensor_is_by_the_standard(place: int, shift_k: float) -> None:
    """An oil that is warmer than it reads is thinner: the flow rises."""
    at_c = BASELINE.columns.temperature_c + np.array([0.0, 5.0, -5.0])
    factor = kinematic_viscosity(VG_68, at_c) / kinematic_viscosity(VG_68, at_c + shift_k) - 1.0
    assert np.sign(factor[0]) == np.sign(shift_k)
    cause = named("temperature_sensor")[place]
    assert_follows(cause, factor)
    assert (cause.mean, cause.spread, cause.is_half) == (0.0, 0.25, True)


def test_two_gaps_together_are_a_cause_where_the_model_is_right() -> None:
    (pair,) = named("ring and sleeve")
    assert pair.direction == pytest.approx(
        np.isin(np.arange(BASELINE.columns.n), (0, 2)) * BASELINE.all_paths
    )
    assert named("ring and sleeve", baseline=replace(BASELINE, model_error=0.03)) == []


def test_a_flushing_is_one_with_the_zero_of_the_meter() -> None:
    paths = ("ring", "piston", "sleeve", "flushing")
    nights = [
        replace(night, drives=np.column_stack([night.drives[:, :3], np.ones(30)]))
        for night in Plant().nights(8, 2)
    ]
    machine = Machine(paths, paths[:3], VG_68)
    baseline = baseline_of(machine, nights)
    assert named("zero", machine, baseline) == []
    assert named("flushing", machine, baseline)
    # No oil thins a flushing: neither another grade nor a sensor's error moves it.
    thin = named("oil_grade", machine, baseline)[0].direction
    assert thin[:4] == pytest.approx([1.0, 1.0, 1.0, 0.0] * baseline.all_paths[:4])


@pytest.mark.parametrize("power", [0.5, 0.7, 1.0, 1.6, 2.2])
def test_the_leakage_beside_a_flushing_holds_where_the_leakage_is_another_power(
    power: float,
) -> None:
    """What is missed over the range of pressures is missed of what stays constant, too."""
    paths = ("ring", "piston", "sleeve", "flushing")
    nights, leakages = [], []
    for night in Plant().nights(8, 2):
        flow = night.flow.mean() * (night.flow / night.flow.mean()) ** power
        made = np.column_stack([night.drives[:, :3], np.ones(30)])
        nights.append(replace(night, drives=made, flow=flow + 2.0))
        leakages.append(flow)
    baseline = baseline_of(Machine(paths, paths[:3], VG_68), nights)
    true = np.mean(leakages) / (np.mean(leakages) + 2.0)
    assert abs(baseline.leakage_share - true) < 1.96 * baseline.split_error * true
