"""Causes of a change: directions by hand, both signs, and what cannot fall."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from leakage.watch import Machine
from leakage.watch.baseline import Baseline, baseline_of
from leakage.watch.causes import Cause, causes_of
from tests.leakage.watch.made_machine import CB560, VG_46, VG_68, Plant, kinematic_viscosity

Array = NDArray[np.float64]

BASELINE = baseline_of(CB560, Plant().nights(15, 1))


def named(name: str, machine: Machine = CB560, baseline: Baseline = BASELINE) -> list[Cause]:
    return [one for one in causes_of(machine, baseline) if one.name == name]


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
    thin = {one.grade: one for one in named("oil_grade")}
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
    assert named("ring and sleeve", baseline=replace(BASELINE, lack_of_fit=0.03)) == []


def test_a_flushing_is_one_with_the_zero_of_the_meter() -> None:
    paths = ("ring", "piston", "sleeve", "flushing")
    nights = [
        replace(one, drives=np.column_stack([one.drives[:, :3], np.ones(30)]))
        for one in Plant().nights(8, 2)
    ]
    machine = Machine(paths, paths[:3], VG_68)
    baseline = baseline_of(machine, nights)
    assert named("zero", machine, baseline) == []
    assert named("flushing", machine, baseline)
    # No oil thins a flushing: neither another grade nor a sensor's error moves it.
    thin = named("oil_grade", machine, baseline)[0].direction
    assert thin[:4] == pytest.approx([1.0, 1.0, 1.0, 0.0] * baseline.all_paths[:4])
