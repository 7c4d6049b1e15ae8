"""Rows of `baselines`: one an era, in the night in which it was frozen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from leakage.watch import Estimate
from pipeline.trends.nights.decisions import LEAKAGE
from pipeline.trends.states.judged import JudgedNight

Row = dict[str, Any]


def baseline_rows(nights: Sequence[JudgedNight]) -> Iterator[Row]:
    """Rows of the baselines that were frozen in some nights."""
    for night in nights:
        watched = night.watched
        baseline, watch, verdict = watched.baseline, watched.watch, watched.verdict
        if baseline is None or watch is None or verdict is None or baseline.end != watched.night:
            continue
        own = watched.own
        yield {
            "motor_id": night.spec.motor_id,
            "night": watched.night,
            "indicator": LEAKAGE,
            "start": baseline.start,
            "end": baseline.end,
            "n": baseline.n,
            "mean": own.value if isinstance(own, Estimate) else None,
            "unit": "l/min",
            "phi": watch.state.wander.serial,
            "reason": watched.era.reason,
            "own_pressure_bar": baseline.own.pressure_bar,
            "own_temperature_c": baseline.own.temperature_c,
            "own_speed_rpm": baseline.own.speed_rpm,
            "lack_of_fit": verdict.lack_of_fit,
        }
