"""Dated events behind which a motor is the same one: other oil, another meter or sensor.

Such an event is no border: what is known of the motor goes on, and the step in its night is the
event's as far as that is likely (model.md, 7c.6).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from leakage.physics.oil import Oil, kinematic_viscosity_mm2_per_s
from leakage.watch import choices
from leakage.watch.baseline import N_TEMPERATURE
from leakage.watch.evidence import Sums
from leakage.watch.nights import Machine
from leakage.watch.state import NOTHING, Crossing, WatchState, all_causes, present


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


def across_event(state: WatchState, machine: Machine, day: int, spread: float) -> WatchState:
    """Return the state of nights from a day on, behind an event that may move the flow by a spread.

    No start of a change lies across it. A baseline period begins with it once it has its nights.
    """
    in_force = state.in_force
    if in_force is not None:
        in_force = replace(in_force, attribution=None, prior=None)
    state = replace(state, in_force=in_force)
    end, q, p = len(state.window), state.baseline.columns.n, state.baseline.n_paths
    known, score = (part[0] for part in state.sums.before(np.array([end]), state.window))
    flows = state.baseline.leakage_flows
    sd = np.full(q, choices.LEFT_OF_SURFACE * spread)
    sd[:p] = choices.LEFT_OF_PATHS * spread / state.baseline.share
    sd[p : p + N_TEMPERATURE] = spread
    freed = np.eye(q) + known @ (spread**2 * np.outer(flows, flows) + np.diag(sd**2))
    window = state.window.from_night(
        end, np.linalg.solve(freed, known), np.linalg.solve(freed, score)
    )
    return replace(
        state,
        machine=machine,
        window=window,
        sums=Sums.of(window, state.wander),
        causes=all_causes(machine, state.baseline),
        first_step=day + 1,
        first_ramp=day + 1,
        due=0,
        often=NOTHING,
        evidence=NOTHING,
        period_from=day,
        crossing=Crossing(day, spread, present(state)),
    )
