"""Causes of a change: a direction of the unknowns z each, with a prior of its size."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from leakage.arrays import Array
from leakage.physics.oil import Oil, kinematic_viscosity_mm2_per_s, walther_coefficients
from leakage.watch import choices
from leakage.watch.baseline import Baseline
from leakage.watch.nights import FLUSHING, Machine

ALL_GAPS, ALL_FLOWS, OIL_GRADE = "all_gaps", "all_flows", "oil_grade"
TEMPERATURE_SENSOR, TEMPERATURE_EFFECT = "temperature_sensor", "temperature_effect"
ZERO, AND = "zero", " and "
BACK, ODD_NIGHTS, TANK = "back_as_before", "odd_nights", "tank"
NOT_IDENTIFIED, CHANNELS = "not_identified", "channels"
# What changes the drain flow and no leakage.
NO_LEAKAGE = (FLUSHING, ZERO)
# What moves all flows together, and is no path.
COMMON = (ALL_FLOWS, OIL_GRADE, TEMPERATURE_SENSOR, TEMPERATURE_EFFECT)
# What is no change of the leakage that stays.
UNSIZED = (BACK, ODD_NIGHTS, TEMPERATURE_EFFECT)
# Within these many degrees the factor of another oil is followed.
STEP_K = 5.0


@dataclass(frozen=True, slots=True)
class Cause:
    """A cause: its direction, shape (q,), and its size's prior.

    The prior is half-normal of scale `spread` where `mean` is 0, else normal about `mean`. `grade`
    is the ISO grade of another oil.
    """

    name: str
    direction: Array
    mean: float = 0.0
    spread: float = choices.STEP_SIZE
    grade: int | None = None

    @property
    def is_half(self) -> bool:
        """Return whether it has a single sign."""
        return self.mean == 0.0


def causes_of(machine: Machine, baseline: Baseline) -> tuple[Cause, ...]:
    """Return all causes of a motor, both signs."""
    unknown = np.eye(baseline.columns.n)
    # Under a wrong model a gap can do what a zero does.
    by_oil = _by_oil(machine, baseline)
    has_zero = baseline.columns.has_zero and baseline.model_error <= choices.LACK_TO_IDENTIFY
    return (
        *_of_paths(machine, baseline),
        *_of_gaps(machine, baseline),
        *_both(ALL_FLOWS, baseline.all_flows),
        *(_both(ALL_FLOWS, by_oil) if np.any(by_oil != baseline.all_flows) else ()),
        *_both(TEMPERATURE_EFFECT, unknown[baseline.n_paths]),
        *(_both(ZERO, unknown[-1]) if has_zero else ()),
        *(() if machine.oil is None else _of_oil(machine, machine.oil, baseline)),
    )


def back_as_before(direction: Array, size: float = 1.0) -> Cause:
    """Return the cause that a change is undone."""
    return Cause(BACK, -size * direction, 1.0, choices.BACK_SPREAD)


def _both(name: str, direction: Array, *, falls: bool = True) -> Iterator[Cause]:
    if np.any(direction):
        yield Cause(name, direction)
        if falls:
            yield Cause(name, -direction)


def _of_paths(machine: Machine, baseline: Baseline) -> Iterator[Cause]:
    shares = baseline.all_paths[: baseline.n_paths] * baseline.share
    for name, direction, share in zip(
        machine.paths, np.eye(baseline.columns.n), shares, strict=False
    ):
        yield from _both(name, direction, falls=share > choices.LEAST_SHARE_TO_FALL)


def _of_gaps(machine: Machine, baseline: Baseline) -> Iterator[Cause]:
    own = np.eye(baseline.columns.n) * baseline.all_paths
    gaps = {name: own[machine.paths.index(name)] for name in machine.gaps}
    gaps = {name: direction for name, direction in gaps.items() if np.any(direction)}
    every = sum(gaps.values(), np.zeros(baseline.columns.n))
    if len(gaps) > 1 and not np.allclose(every, baseline.all_paths):
        yield from _both(ALL_GAPS, every)
    # Under a wrong model two gaps can do what another alone does.
    if len(gaps) > 2 and baseline.model_error <= choices.LACK_TO_IDENTIFY:
        for (gap, first), (other, second) in combinations(gaps.items(), 2):
            yield Cause(gap + AND + other, first + second)


def _by_oil(machine: Machine, baseline: Baseline) -> Array:
    """Return all flows that follow the oil's viscosity: a flushing and further flows do not.

    All flows where the baseline gives those next to nothing: the surface alone is no flow.
    """
    direction = baseline.all_flows
    direction[baseline.columns.n_driven : baseline.n_paths] = 0.0
    if FLUSHING in machine.paths:
        direction[machine.paths.index(FLUSHING)] = 0.0
    is_flow = float(direction @ baseline.own_row) >= choices.LEAST_SHARE_TO_SHOW
    return direction if is_flow else baseline.all_flows


def _of_oil(machine: Machine, oil: tuple[float, float], baseline: Baseline) -> Iterator[Cause]:
    """Yield the causes of another grade, and of a temperature sensor that reads low or high.

    Each scales all flows by a factor that changes with temperature.
    """
    middle_c = baseline.columns.temperature_c
    own = _viscosity(oil, middle_c)

    def direction(factor: Array) -> Array:
        """Return direction of a factor less 1 at T₀, T₀ + 5 K and T₀ − 5 K, of size 1 at T₀."""
        along = _by_oil(machine, baseline)
        half = STEP_K / 10.0
        straight, bent = baseline.n_paths, baseline.n_paths + 1
        along[straight] += (factor[1] - factor[2]) / (2.0 * half * factor[0])
        along[bent] += ((factor[1] + factor[2]) / factor[0] - 2.0) / (2.0 * half**2)
        return along

    for grade in machine.grades:
        if abs(grade[0] / oil[0] - 1.0) > 0.1:
            factor = own / _viscosity(grade, middle_c) - 1.0
            size = float(factor[0])
            spread = choices.GRADE_SPREAD * abs(size)
            yield Cause(OIL_GRADE, direction(factor), size, spread, round(grade[0]))
    for shift_k in (choices.SENSOR_SHIFT_K, -choices.SENSOR_SHIFT_K):
        factor = own / _viscosity(oil, middle_c + shift_k) - 1.0
        sign = float(np.sign(factor[0]))
        yield Cause(TEMPERATURE_SENSOR, sign * direction(factor), 0.0, choices.SENSOR_SIZE)


def _viscosity(oil: tuple[float, float], middle_c: float) -> Array:
    """Return kinematic viscosity at T₀, T₀ + 5 K and T₀ − 5 K, shape (3,), [mm²/s]."""
    walther = walther_coefficients(40.0, oil[0], 100.0, oil[1])
    at_c = np.array([middle_c, middle_c + STEP_K, middle_c - STEP_K])
    return kinematic_viscosity_mm2_per_s(at_c, *walther)


def oil_spread(before: Oil, after: Oil, at_c: float) -> float:
    """Return what data sheets and the viscosity law miss of a change of oil, relative to the flow.

    σ = 0.2 |Δ ln ν| + 0.02 at a temperature.

    Examples
    --------
    >>> from leakage.physics.oil import walther_coefficients
    >>> constants = (882.0, 7.0e-4, 2.0e-8)
    >>> vg_68, vg_46 = (
    ...     Oil(name, *walther_coefficients(40.0, at_40, 100.0, at_100), *constants)
    ...     for name, at_40, at_100 in (("VG 68", 68.0, 8.7), ("VG 46", 46.0, 6.8))
    ... )
    >>> oil_spread(vg_68, vg_68, 50.0), round(oil_spread(vg_68, vg_46, 50.0), 3)
    (0.02, 0.092)
    """
    thick, thin = (
        float(kinematic_viscosity_mm2_per_s(np.array([at_c]), oil.walther_a, oil.walther_b)[0])
        for oil in (before, after)
    )
    return choices.OIL_LAW * abs(math.log(thick / thin)) + choices.OIL_SHEET
