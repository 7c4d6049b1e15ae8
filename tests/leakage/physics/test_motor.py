"""A motor as a list of paths: totals, columns, flushing, and a type by declaration alone."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leakage.errors import ParameterError, ShapeError, ValidityError
from leakage.physics.motor import (
    Motor,
    OperatingConditions,
    leakage_l_per_min,
    path_flows_l_per_min,
    regressors,
    speed_beyond_curve,
    total_flow_l_per_min,
)
from leakage.physics.oil import FilmPressure, dynamic_viscosity_pa_s
from leakage.physics.paths import AnnularGap, Constant, Laminar, Parameter, SpeedCurve
from tests.leakage.placeholders import (
    HIGH_PRESSURE_COUNTS,
    eccentricity,
    gap,
    piston_ring,
    placeholder_motor,
    placeholder_oil,
)

WORKED = OperatingConditions.from_bar([40.0, 200.0, 300.0], [40.0, 50.0, 60.0], [10.0, 30.0, 80.0])
WORKED_CB560_L_PER_MIN = [0.361771, 1.371423, 3.220537]


def random_conditions(n: int, seed: int = 1) -> OperatingConditions:
    generator = np.random.default_rng(seed)
    return OperatingConditions.from_bar(
        generator.uniform(-350.0, 350.0, n),
        generator.uniform(0.0, 90.0, n),
        generator.uniform(-150.0, 150.0, n),
    )


def test_total_of_the_cb560_worked_values() -> None:
    total = total_flow_l_per_min(placeholder_motor("CB560"), WORKED)
    assert total == pytest.approx(WORKED_CB560_L_PER_MIN, abs=5e-7)


@pytest.mark.parametrize("motor_type", sorted(HIGH_PRESSURE_COUNTS))
def test_motor_types_differ_by_their_count_alone(motor_type: str) -> None:
    rows = {"CB400": 3, "CB560": 4, "CB1120": 8}[motor_type]
    total = total_flow_l_per_min(placeholder_motor(motor_type), WORKED)
    expected = np.array(WORKED_CB560_L_PER_MIN) * rows / 4
    np.testing.assert_allclose(total, expected, rtol=2e-6)


def test_flows_of_the_paths_add_up_to_the_total() -> None:
    motor = placeholder_motor(flushing="fixed", flushing_l_per_min=4.0)
    flows = path_flows_l_per_min(motor, WORKED)
    assert list(flows) == ["o", "p", "s", "r", "f"]
    np.testing.assert_allclose(sum(flows.values()), total_flow_l_per_min(motor, WORKED), rtol=1e-14)
    # One interface each at 200 bar, 50 °C, 30 rpm, times 32.
    assert [flow[1] / 32 for flow in list(flows.values())[:4]] == pytest.approx(
        [3.445024e-4, 1.061377e-2, 1.529589e-2, 1.660281e-2], rel=3e-7
    )


@pytest.mark.parametrize("flushing", ["fixed", "estimated"])
def test_flushing_is_in_the_flow_and_not_in_the_leakage(flushing: str) -> None:
    motor = placeholder_motor(flushing=flushing, flushing_l_per_min=4.0)  # type: ignore[arg-type]
    leakage = leakage_l_per_min(motor, WORKED)
    assert leakage == pytest.approx(WORKED_CB560_L_PER_MIN, abs=5e-7)
    np.testing.assert_allclose(total_flow_l_per_min(motor, WORKED) - leakage, 4.0, rtol=1e-12)


def test_no_flushing_leaves_leakage_and_flow_equal() -> None:
    motor = placeholder_motor()
    assert motor.constant is None
    np.testing.assert_array_equal(
        leakage_l_per_min(motor, WORKED), total_flow_l_per_min(motor, WORKED)
    )


@given(pressure_bar=st.floats(0.0, 350.0), speed_rpm=st.floats(0.0, 300.0))
def test_direction_has_no_effect(pressure_bar: float, speed_rpm: float) -> None:
    forward, *others = (
        total_flow_l_per_min(
            placeholder_motor(),
            OperatingConditions.from_bar(p * pressure_bar, 50.0, w * speed_rpm),
        )
        for p, w in ((1, 1), (-1, -1), (-1, 1), (1, -1))
    )
    for other in others:
        np.testing.assert_array_equal(other, forward)


@given(
    pressure_bar=st.floats(1.0, 350.0),
    temperature_c=st.floats(0.0, 90.0),
    step=st.floats(0.01, 20.0),
)
def test_hotter_oil_leaks_more(pressure_bar: float, temperature_c: float, step: float) -> None:
    conditions = OperatingConditions.from_bar(
        pressure_bar, [temperature_c, temperature_c + step], 30.0
    )
    cold, hot = total_flow_l_per_min(placeholder_motor(), conditions)
    assert hot > cold > 0.0


@given(factor=st.floats(1.01, 1.5))
def test_a_larger_gap_leaks_more(factor: float) -> None:
    motor = placeholder_motor()
    worn = replace(motor, paths=(piston_ring(32, 8.0 * factor), *motor.paths[1:]))
    before, after = (path_flows_l_per_min(m, WORKED) for m in (motor, worn))
    np.testing.assert_allclose(after["o"] / before["o"], factor**3, rtol=1e-12)
    np.testing.assert_array_equal(after["p"], before["p"])


@pytest.mark.parametrize("roller_is_free", [False, True])
@pytest.mark.parametrize("flushing", ["none", "fixed", "estimated"])
@pytest.mark.parametrize("film_pressure", [FilmPressure(share=0.5), FilmPressure("slot")])
def test_flow_is_linear_in_the_columns(
    roller_is_free: bool, flushing: str, film_pressure: FilmPressure
) -> None:
    # y = known + Σ K φ + C_f: the columns rebuild the flow at any coefficients.
    motor = placeholder_motor(
        flushing=flushing,  # type: ignore[arg-type]
        flushing_l_per_min=3.0,
        roller_is_free=roller_is_free,
        film_pressure=film_pressure,
    )
    conditions = random_conditions(500)
    coefficients = {path.name: 1.7 * path.configured_coefficient for path in motor.column_paths}
    constant = 0.0 if motor.constant is None else motor.constant.configured_coefficient
    z = regressors(motor, conditions)
    assert z.shape == (500, len(motor.columns) - 1)
    rebuilt = z @ np.array([*coefficients.values(), constant, 1.0])
    np.testing.assert_allclose(
        rebuilt, total_flow_l_per_min(motor, conditions, coefficients), rtol=1e-12
    )


def test_columns_of_the_cb_motors_are_the_models_six() -> None:
    assert placeholder_motor(flushing="estimated").columns == (
        *("o", "p", "s"),
        *("one", "known", "measured"),
    )
    free_roller = placeholder_motor(roller_is_free=True)
    assert free_roller.columns == ("o", "p", "s", "r", "one", "known", "measured")
    assert free_roller.known_paths == ()
    np.testing.assert_array_equal(regressors(free_roller, WORKED)[:, -1], 0.0)


def test_columns_follow_the_models_regressors() -> None:
    # φ_o = exp(-3ΔP/X_o)·ΔP/η, φ_p = ΔP/η, φ_s = exp(-3ΔP/X_s)·ΔP/η, each times 60 000.
    z = regressors(placeholder_motor(), WORKED)
    pressure = np.array([40e5, 200e5, 300e5])
    phi_p = 60_000.0 * pressure / dynamic_viscosity_pa_s([40, 50, 60], pressure, placeholder_oil())
    np.testing.assert_allclose(z[:, 1], phi_p, rtol=1e-12)
    np.testing.assert_allclose(z[:, 0], phi_p * np.exp(-3 * pressure / 120e5), rtol=1e-12)
    np.testing.assert_allclose(z[:, 2], phi_p * np.exp(-3 * pressure / 900e5), rtol=1e-12)
    np.testing.assert_array_equal(z[:, 3], 1.0)
    np.testing.assert_allclose(z[:, 4] / 32, [1.735590e-3, 1.660281e-2, 6.068909e-2], rtol=3e-7)


def test_fixed_flushing_is_no_part_of_the_known_flow() -> None:
    without, fixed = (
        regressors(placeholder_motor(flushing=f, flushing_l_per_min=4.0), WORKED)
        for f in ("none", "fixed")
    )
    np.testing.assert_array_equal(without, fixed)


def test_long_series_equal_their_samples_one_by_one() -> None:
    # Longer than the chunks in which the columns are computed.
    motor, conditions = placeholder_motor(), random_conditions(40_000)
    z = regressors(motor, conditions)
    total = total_flow_l_per_min(motor, conditions)
    for index in (0, 16_383, 16_384, 16_385, 32_768, 39_999):
        sample = conditions.part(slice(index, index + 1))
        np.testing.assert_allclose(regressors(motor, sample)[0], z[index], rtol=1e-14)
        np.testing.assert_allclose(total_flow_l_per_min(motor, sample)[0], total[index], rtol=1e-14)


def test_no_samples_give_no_rows() -> None:
    empty = OperatingConditions(np.empty(0), np.empty(0), np.empty(0))
    assert regressors(placeholder_motor(), empty).shape == (0, 5)
    assert total_flow_l_per_min(placeholder_motor(), empty).shape == (0,)


def test_nan_stays_in_its_row_and_in_what_depends_on_it() -> None:
    conditions = OperatingConditions.from_bar(
        [200.0, math.nan, 200.0, 200.0], [50.0, 50.0, math.nan, 50.0], [30.0, 30.0, 30.0, math.nan]
    )
    z = regressors(placeholder_motor(), conditions)
    assert np.isnan(z).tolist() == [
        [False] * 5,
        [True, True, True, False, True],
        [True, True, True, False, True],
        [False, False, False, False, True],
    ]


def test_arguments_are_never_changed() -> None:
    conditions = random_conditions(100)
    channels = (
        conditions.pressure_difference_pa,
        conditions.oil_temperature_c,
        conditions.speed_rpm,
    )
    copies = [channel.copy() for channel in channels]
    for channel in channels:
        channel.flags.writeable = False
    regressors(placeholder_motor(), conditions)
    total_flow_l_per_min(placeholder_motor(), conditions, {"o": 1e-14})
    for channel, copy in zip(channels, copies, strict=True):
        np.testing.assert_array_equal(channel, copy)


def test_temperature_outside_the_oils_range_is_an_error_with_its_code() -> None:
    with pytest.raises(ValidityError) as caught:
        regressors(placeholder_motor(), OperatingConditions.from_bar(200.0, 500.0, 30.0))
    assert caught.value.code == "oil_temperature_range"


def test_samples_beyond_the_curve_are_counted_on_both_sides() -> None:
    speed = np.array([0.0, 125.0, -125.0, 125.1, -130.0])
    assert speed_beyond_curve(placeholder_motor(), speed).tolist() == [
        *(False, False, False),
        *(True, True),
    ]
    without_roller = Motor("ring", (piston_ring(),), placeholder_oil())
    assert not speed_beyond_curve(without_roller, speed).any()


def invented_motor() -> Motor:
    """Invented: two gaps unlike any of a CB motor, a distributor, a line over speed, flushing."""
    return Motor(
        "XY90",
        (
            Laminar("distributor", 3, Parameter("C_distributor", "m3", 2e-15, 0.0, 1e-13)),
            AnnularGap(
                "shaft_seal",
                2,
                0.05,
                0.01,
                gap("shaft_seal", 20.0),
                eccentricity("shaft_seal", 1.0),
                deformation_pressure_pa=300e5,
                height_factor=0.5,
            ),
            AnnularGap("spool", 1, 0.01, 0.03, gap("spool", 12.0, fixed=True), None),
            SpeedCurve(
                "swash",
                9,
                (0.001, 0.02),
                0.0,
                1000.0,
                100e5,
                0.02,
                Parameter("scale_swash", "1", 0.5, 0.0, 2.0),
            ),
            Constant("flushing", Parameter("C_flushing", "l_per_min", 1.25, 0.0, 5.0)),
        ),
        placeholder_oil("VG 46", pressure_viscosity_per_pa=0.0),
    )


def test_a_fourth_type_needs_its_declaration_alone() -> None:
    motor = invented_motor()
    pressure_pa, speed_rpm = 90e5, 400.0
    drive = pressure_pa / float(dynamic_viscosity_pa_s(40.0, 0.0, motor.oil))
    by_hand = {
        "distributor": 3 * 2e-15 * drive * 60_000,
        # π·0.05·(0.5·20e-6)³/(6·0.01) · (1 + 1.5) · exp(-3·90/300)
        "shaft_seal": 2 * math.pi * 0.05 * 1e-15 / 0.06 * 2.5 * math.exp(-0.9) * drive * 60_000,
        "spool": math.pi * 0.01 * (12e-6) ** 3 / 0.18 * drive * 60_000,
        "swash": 0.5 * 9 * (0.001 * 400 + 0.02) * drive * 0.02 / 100e5,
        "flushing": 1.25,
    }
    conditions = OperatingConditions.from_bar(90.0, 40.0, speed_rpm)
    flows = path_flows_l_per_min(motor, conditions)
    assert {name: flow.item() for name, flow in flows.items()} == pytest.approx(by_hand, rel=1e-12)
    assert total_flow_l_per_min(motor, conditions).item() == pytest.approx(sum(by_hand.values()))
    assert motor.columns == ("distributor", "shaft_seal", "swash", "one", "known", "measured")
    assert [path.name for path in motor.known_paths] == ["spool"]
    assert regressors(motor, conditions)[0, -1] == pytest.approx(by_hand["spool"], rel=1e-12)


def test_motors_travel_between_processes() -> None:
    motor = invented_motor()
    assert pickle.loads(pickle.dumps(motor)) == motor  # noqa: S301


def test_coefficient_of_an_unknown_path_is_refused() -> None:
    with pytest.raises(ParameterError, match="has no path") as caught:
        total_flow_l_per_min(placeholder_motor(), WORKED, {"K_o": 1e-14})
    assert caught.value.code == "coefficient_unknown"


def test_motor_without_paths_or_with_doubled_ones_is_refused() -> None:
    oil, ring = placeholder_oil(), piston_ring()
    flushing = Constant("f", Parameter("C_f", "l_per_min", 4.0, 0.0, 20.0))
    other = replace(flushing, name="g", flow=replace(flushing.flow, name="C_g"))
    for paths, message in (
        ((), "no leakage path"),
        ((ring, ring), "more than once"),
        ((ring, replace(ring, name="q")), "parameter"),
        ((replace(ring, name="known"),), "known"),
        ((flushing, other), "more than one constant"),
    ):
        with pytest.raises(ParameterError, match=message) as caught:
            Motor("CB0", paths, oil)
        assert "CB0" in str(caught.value)


def test_conditions_of_unequal_length_are_refused() -> None:
    with pytest.raises(ShapeError):
        OperatingConditions(np.zeros(2), np.zeros(3), np.zeros(2))
    with pytest.raises(ShapeError):
        OperatingConditions(np.zeros((2, 2)), np.zeros((2, 2)), np.zeros((2, 2)))
    with pytest.raises(ShapeError):
        OperatingConditions.from_bar([1.0, 2.0], [1.0, 2.0, 3.0], 0.0)


def test_conditions_from_bar_are_in_pascals() -> None:
    conditions = OperatingConditions.from_bar(200.0, 50.0, 30.0)
    assert len(conditions) == 1
    assert conditions.pressure_difference_pa.item() == 2e7
