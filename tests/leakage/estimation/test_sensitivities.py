"""Error budgets: against closed forms, and the effects that model.md gives for a CB560."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from leakage import AnnularGap, Motor, OperatingConditions, SpeedCurve, leakage_l_per_min
from leakage.errors import ValidityError
from leakage.estimation.sensitivities import ChannelTolerance, ErrorBudget, Tolerances, error_budget
from leakage.physics.paths import Law
from tests.leakage.made_samples import made_conditions, made_samples, true_coefficients
from tests.leakage.placeholders import placeholder_motor

REFERENCE = OperatingConditions.from_bar(200.0, 50.0, 30.0)


def budget_of(motor: Motor, tolerances: Tolerances, n: int = 1500) -> ErrorBudget:
    conditions = made_conditions(n)
    flow = made_samples(motor, noise_l_per_min=0.0, conditions=conditions)[:, -1]
    return error_budget(motor, conditions, flow, tolerances, [REFERENCE])


def effects(motor: Motor, tolerances: Tolerances) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Relative effect of each source on K and on the reference leakage, and the truth."""
    budget = budget_of(motor, tolerances)
    theta = true_coefficients(motor)[:-1]
    leakage = float(leakage_l_per_min(motor, REFERENCE)[0])
    found = {
        effect.source.name: np.append(
            effect.coefficients[:-1] / theta, effect.leakages_l_per_min / leakage
        )
        for effect in budget.effects
    }
    return found, theta


def test_effects_are_of_the_size_and_sign_that_the_model_states() -> None:
    """model.md section 5, in % of K_o, K_p, K_s and reference leakage, of these nights."""
    found, _ = effects(
        placeholder_motor("CB560"),
        Tolerances(
            pressure_bar=ChannelTolerance(offset=1.0),
            temperature_c=ChannelTolerance(offset=1.0, gain=0.02),
            flow_l_per_min=ChannelTolerance(offset=0.02, gain=0.01),
            pressure_viscosity=-0.1,
        ),
    )
    in_percent = {name: 100 * values for name, values in found.items()}
    assert in_percent["oil_temperature offset"][3] == pytest.approx(-4.8, abs=0.3)
    # At 50 °C it is the same as a degree.
    assert in_percent["oil_temperature gain"][3] == pytest.approx(-4.8, abs=0.4)
    assert in_percent["leakage_flow offset"][3] == pytest.approx(1.5, abs=0.4)
    assert in_percent["leakage_flow offset"][0] > 5
    assert in_percent["leakage_flow gain"][3] == pytest.approx(1.1, abs=0.2)
    assert in_percent["pressure_difference offset"][3] == pytest.approx(-0.2, abs=0.15)
    assert in_percent["pressure-viscosity coefficient"][3] == pytest.approx(-0.5, abs=0.5)
    assert -60 < in_percent["pressure-viscosity coefficient"][1] < -20


def with_tolerance(path: Law) -> Law:
    """A path of which every constant is known to some percent."""
    if isinstance(path, AnnularGap):
        return replace(path, deformation_tolerance=0.1)
    return replace(path, curve_tolerance=0.05) if isinstance(path, SpeedCurve) else path


def test_sources_add_by_squares() -> None:
    plain = placeholder_motor("CB560")
    motor = replace(plain, paths=tuple(map(with_tolerance, plain.paths)))
    budget = budget_of(motor, Tolerances(temperature_c=ChannelTolerance(offset=1.0)), 800)
    names = [effect.source.name for effect in budget.effects]
    assert len(names) == len(set(names)) == 4  # temperature, X_o, X_s, the roller's curve
    squares = np.sum([effect.coefficients**2 for effect in budget.effects], axis=0)
    total = budget.coefficients()
    assert total == pytest.approx(np.sqrt(squares), abs=0.0)


def test_leakage_where_the_sensors_read_the_motor_to_run_is_what_the_meter_reads() -> None:
    """A motor at one pressure: sensors that are off move the point with the samples."""
    motor = placeholder_motor("CB560")
    turn = np.arange(600.0)
    conditions = OperatingConditions.from_bar(
        180.0 + 0.05 * np.sin(turn), np.full(600, 50.0), 40.0 + 10.0 * np.cos(turn / 7.0)
    )
    flow = np.asarray(leakage_l_per_min(motor, conditions))
    own = OperatingConditions.from_bar(180.0, 50.0, 40.0)
    tolerances = Tolerances(
        pressure_bar=ChannelTolerance(offset=4.0), temperature_c=ChannelTolerance(offset=1.0)
    )
    budget = error_budget(motor, conditions, flow, tolerances, [own], [own])
    leakage = float(leakage_l_per_min(motor, own)[0])
    for effect in budget.effects:
        stated, read = np.abs(effect.leakages_l_per_min) / leakage
        assert stated > 0.02
        assert read < 0.005


def test_an_absurd_tolerance_is_reported() -> None:
    tolerances = Tolerances(temperature_c=ChannelTolerance(offset=1000.0))
    with pytest.raises(ValidityError):
        budget_of(placeholder_motor("CB560"), tolerances, 100)
