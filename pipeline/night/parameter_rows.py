"""Rows of `parameters` and `error_budget`: what a fit says of each parameter, and how sure."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from leakage import Motor, regressors
from leakage.estimation.identifiability import Judgement
from leakage.estimation.sensitivities import Effect, ErrorBudget
from leakage.physics.motor import path_flows_l_per_min
from leakage.physics.paths import LeakagePath
from pipeline.arrays import Array
from pipeline.config import MotorSpec
from pipeline.night.block_fit import OWN, REFERENCE, BlockFit

Row = dict[str, Any]

MICROMETRE = 1e-6
# A share is identified where it is known to this much of the whole, or to half of itself.
WIDEST_SHARE = 0.02


def parameter_rows(spec: MotorSpec, mode: BlockFit) -> list[Row]:
    """Rows of `parameters`: coefficients, what they say of gaps, and shares of the leakage."""
    fit = mode.fit
    places = {path.name: place for place, path in enumerate(fit.motor.coefficient_paths) if path}
    rows: list[Row] = []
    for path in fit.motor.paths:
        row = _coefficient_row(mode, path, places.get(path.name))
        if path is fit.motor.standard:
            row["reason"] = _why_fixed(mode)
        rows += [row, *_derived_rows(spec, path, row)]
    return rows + _share_rows(mode)


def _why_fixed(mode: BlockFit) -> str:
    """Return reason why the scale of the rollers' curve is held as configured."""
    if mode.roller is not None and mode.roller.judgement.reason:
        return f"configured, as speed varies too little: {mode.roller.judgement.reason}"
    return "configured, as most of a baseline's first nights do not identify it yet"


def _coefficient_row(mode: BlockFit, path: LeakagePath, place: int | None) -> Row:
    """The row of a coefficient: of a known path its configured value, else estimate and verdict."""
    row: Row = {"parameter": path.coefficient_name, "unit": path.coefficient_unit}
    if place is None:
        value, judgement = path.configured_coefficient, Judgement("fixed", "configured", None)
    else:
        value = float(mode.fit.coefficients[place])
        judgement = mode.identification.coefficients[place]
    row |= {"value": value, "verdict": judgement.verdict, "reason": judgement.reason or None}
    if place is None or judgement.verdict == "fixed":
        return row
    if judgement.interval is None:
        return row
    row |= _interval(value, judgement.interval.half_width)
    row["systematic"] = mode.systematic.get(path.coefficient_name)
    return row


def _interval(value: float, half_width: float) -> Row:
    return {"lower": value - half_width, "upper": value + half_width}


def _derived_rows(spec: MotorSpec, path: LeakagePath, coefficient: Row) -> list[Row]:
    """Rows of the figures that a coefficient implies, each with a value or a feasible range."""
    first, second = spec.motor_type.surface_roughness_um
    limits = (coefficient["lower"], coefficient["upper"]) if "lower" in coefficient else None
    rows: list[Row] = []
    for figure in path.derived_figures(
        coefficient["value"], limits, (first * MICROMETRE, second * MICROMETRE)
    ):
        row: Row = {
            "parameter": figure.name,
            "value": figure.lowest if figure.lowest == figure.highest else None,
            "unit": figure.unit,
            "feasible_min": figure.lowest,
            "feasible_max": figure.highest,
            "verdict": coefficient["verdict"],
            "reason": coefficient["reason"],
        }
        if figure.combination and coefficient["verdict"] != "fixed":
            row["verdict"] = "only_in_combination"
            row["reason"] = f"only {figure.combination} shows in the data"
        if figure.limits is not None:
            row["lower"], row["upper"] = figure.limits
        rows.append(row)
    return rows


def _share_rows(mode: BlockFit) -> list[Row]:
    """Return share of each path in the reference leakage, where the data determine it.

    With L = Σ K_i φ_i + known, K within bounds, the share Q_j / L has the gradient
    φ_i (δ_ij L − Q_j) / L².
    """
    reference, fit = mode.reference, mode.fit
    if not reference.has_value:
        return [
            {"parameter": f"share_{path.name}", "unit": "1", "value": None}
            | {"verdict": reference.verdict, "reason": reference.reason}
            for path in fit.motor.paths
            if path is not fit.motor.constant
        ]
    flows = path_flows_l_per_min(fit.motor, mode.reference_conditions, fit.coefficients_by_path)
    total = sum(float(flow[0]) for flow in flows.values())
    slopes = np.append(regressors(fit.motor, mode.reference_conditions)[0, :-2], 0.0)
    places = {path.name: place for place, path in enumerate(fit.motor.column_paths)}
    rows = []
    for path in fit.motor.paths:
        if path is fit.motor.constant:
            continue
        flow = float(flows[path.name][0])
        gradient = -slopes * flow / total**2
        if path.name in places:
            gradient[places[path.name]] += slopes[places[path.name]] / total
        rows.append(_share_row(mode, path, flow / total, gradient))
    return rows


def _share_row(mode: BlockFit, path: LeakagePath, share: float, gradient: Array) -> Row:
    row: Row = {"parameter": f"share_{path.name}", "unit": "1", "value": share}
    if mode.reference.verdict == "fixed":
        return row | {"verdict": "fixed", "reason": mode.reference.reason}
    distribution = mode.identification.distribution
    interval = None if distribution is None else distribution.interval(gradient)
    if interval is None:
        return row | {"verdict": "not_identified", "reason": "the samples do not span it"}
    if interval.half_width > max(WIDEST_SHARE, share / 2):
        reason = f"known to ± {100 * interval.half_width:.0f} % of the leakage only"
        return row | {"value": None, "verdict": "not_identified", "reason": reason}
    return row | {"verdict": "identified"} | _interval(share, interval.half_width)


def error_budget_rows(motor: Motor, budget: ErrorBudget, assumed: Collection[str]) -> list[Row]:
    """Rows of `error_budget`: effect of each tolerance, stated or assumed, on each figure."""
    return [
        row | {"is_assumed": effect.source.name.split()[0] in assumed}
        for effect in budget.effects
        for row in _effect_rows(motor, effect)
    ]


def _effect_rows(motor: Motor, effect: Effect) -> list[Row]:
    source: Row = {
        "source": effect.source.name,
        "tolerance": effect.source.tolerance,
        "tolerance_unit": effect.source.unit,
    }
    rows: list[Row] = [
        {"indicator": path.coefficient_name, "unit": path.coefficient_unit}
        | {"effect": float(effect.coefficients[place])}
        for place, path in enumerate(motor.coefficient_paths)
        if path is not None and path.is_free
    ]
    leakages = effect.leakages_l_per_min.tolist()
    rows += [
        {"indicator": name, "unit": "l_per_min", "effect": value}
        for name, value in zip((REFERENCE, OWN), leakages, strict=True)
    ]
    return [row | source for row in rows]
