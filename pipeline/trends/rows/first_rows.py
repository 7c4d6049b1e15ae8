"""Rows of `trends` that are told and not watched: drain flow, baseline, temperature, model, oil."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from leakage.estimation.model_verdict import model_verdict
from pipeline.trends.baselines.conditions import OwnConditions, regressor_row
from pipeline.trends.baselines.flow import column_sums, expected_flow
from pipeline.trends.figures.indicators import (
    BASELINE_PROGRESS,
    COMPARABLE_FLOW,
    DEVIATION,
    DRAIN_FLOW,
    MODEL_MISFIT,
    OIL_VISCOSITY,
)
from pipeline.trends.figures.temperature import warming
from pipeline.trends.states.standing import Standing
from pipeline.trends.why.oil import oil_as_measured, viscosity_ratio
from pipeline.trends.why.reasons import good_nights, why_no_baseline

Array = NDArray[np.float64]
Row = dict[str, Any]


def first_rows(standing: Standing, place: int) -> Iterator[Row]:
    """Rows of a night from the motor's first on."""
    state = {"state": standing.states[DEVIATION][place]}
    sums = column_sums(standing.history, slice(place, place + 1))[0]
    if np.isfinite(sums).all() and sums[-3] > 0.0:
        yield _row(DRAIN_FLOW, "l/min", float(sums[-1] / sums[-3])) | state
        comparable = _comparable_flow(standing, place, sums)
        if comparable is not None:
            yield _row(COMPARABLE_FLOW, "l/min", comparable) | state
    if standing.watched[DEVIATION].baseline(place) is None:
        good, needed = good_nights(standing, DEVIATION, place)
        row = _row(BASELINE_PROGRESS, "%", 100.0 * min(good / needed, 1.0))
        yield row | state | {"state_reason": why_no_baseline(standing, DEVIATION, place)}
    if (effect := standing.temperature.row(place)) is not None:
        yield effect
    if (misfit := model_row(standing, place)) is not None:
        yield misfit
    if (ratio := viscosity_ratio(standing.history, place, place)) is not None:
        words = oil_as_measured(standing.history, place)
        yield _row(OIL_VISCOSITY, "%", 100.0 * (ratio - 1.0)) | state | {"state_reason": words}


def model_row(standing: Standing, place: int) -> Row | None:
    """Structured misfit of the model over the last nights, with its verdict."""
    model = standing.model
    found = model.at(place)
    if found is None:
        return None
    return _row(MODEL_MISFIT, "%", 100.0 * found.share) | {
        "n_nights": found.n_nights,
        "baseline_mean": 100.0 * float(model.first[place]) if model.first[place] >= 0.0 else None,
        "state": model.state[place],
        "state_reason": model.words(place) or None,
        "model_verdict": model_verdict(found),
    }


def _row(indicator: str, unit: str, value: float) -> Row:
    return {
        "indicator": indicator,
        "unit": unit,
        "value": value,
        "n_nights": 1,
        "outside_fitted_range": False,
    }


def _comparable_flow(standing: Standing, place: int, sums: Array) -> float | None:
    """Drain flow at the fleet's reference conditions, flushing excluded [l/min].

    By the baseline's model, until it is known by the configured one: the measured flow times what
    the model says there over what it says here.
    """
    history, era = standing.history, standing.era(place)
    known = era.model is not None and place >= era.known_from
    theta = np.array(history.layout.configured) if era.model is None or not known else era.model
    row = reference_row(standing, place)
    measured, expected = (float(one[0]) for one in expected_flow(sums[None], theta))
    here, there = 1.0, 1.0
    if known and place > era.temperature_from and era.temperature is not None:
        here = float(warming(history.records[place : place + 1], era.temperature)[0])
        asked = history.spec.settings.reference.temperature_c
        there = 1.0 + era.temperature.taken_off * (asked - era.temperature.reference_c)
    expected += (here - 1.0) * (expected - float(sums[-2]))
    if isinstance(row, str) or expected <= 0.0:
        return None
    return measured / expected * float(there * row[:-2] @ theta[:-1] + row[-1])


def reference_flows(standing: Standing, place: int) -> dict[str, float]:
    """Flow of each free path per unit of its coefficient at the fleet's reference conditions."""
    row, paths = reference_row(standing, place), standing.history.layout.paths
    if isinstance(row, str):
        return {}
    return dict(zip(paths, row[: len(paths)].tolist(), strict=True))


def reference_row(standing: Standing, place: int) -> Array | str:
    """Columns of the statistics at the fleet's reference conditions, or why there are none."""
    reference = standing.history.spec.settings.reference
    charge = float(standing.history.records["charge"][place])
    at = OwnConditions(
        reference.pressure_bar,
        reference.temperature_c,
        reference.speed_rpm,
        None if np.isnan(charge) else charge,
    )
    return regressor_row(standing.history, place, at)
