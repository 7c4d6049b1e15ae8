"""Nights as the watch may say them, made by hand: for states, sentences and rows."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from leakage.watch import Change, Estimate, Verdict
from pipeline.config import MotorSpec
from pipeline.config.settings import Conditions
from pipeline.trends.nights.history import BaselinePeriod
from pipeline.trends.states.course import Baseline, WatchedNight
from pipeline.trends.states.judged import JudgedNight, judged
from tests.pipeline.trends.nights import motor, night_of

LIMIT = math.log(365.0 / 0.04)
PATHS = ("piston_ring", "balance_piston", "balance_sleeve")
AT = 30


def change(cause: str, **more: Any) -> Change:
    """A rise by 20 % since night 20, told on night 21."""
    fields: dict[str, Any] = {
        "cause": cause,
        "probability": 0.97,
        "candidates": {cause: 0.97, "all_gaps": 0.03},
        "is_rise": True,
        "shape": "step",
        "since": night_of(20).toordinal(),
        "since_lower": night_of(19).toordinal(),
        "since_upper": night_of(21).toordinal(),
        "told_on": night_of(21).toordinal(),
        "size": Estimate(0.2, 0.01),
    }
    return Change(**(fields | more))


def watched(found: Change | None = None, **more: Any) -> WatchedNight:
    """Night 30 with a baseline of eight nights; `more` are fields of it or of its verdict."""
    size = Estimate(0.0, 0.01) if found is None else found.size
    verdict = Verdict(night_of(AT).toordinal(), 1.0, LIMIT, 0.005, found, size, size, 0.023, 0.9)
    own = Baseline(night_of(0), night_of(7), 8, Conditions(150.0, 50.0, 40.0), (1e-14,) * 3)
    machine = SimpleNamespace(paths=(*PATHS, "known"), gaps=PATHS)
    watch: Any = SimpleNamespace(state=SimpleNamespace(machine=machine))
    night = WatchedNight(
        AT, night_of(AT), BaselinePeriod(0, 40, "first nights"), 20, 0, 0, own, watch, verdict,
        Estimate(1.2, 0.01), Estimate(1.5, 0.02),
    )  # fmt: skip
    names = {"lack_of_fit", "present", "tonight", "smallest", "evidence"}
    in_verdict = {name: more.pop(name) for name in names & more.keys()}
    return replace(night, verdict=replace(verdict, **in_verdict), **more)


def waiting(n: int, **more: Any) -> WatchedNight:
    """A night of a baseline period that has so many nights of its baseline period."""
    period = more.pop("period", BaselinePeriod(0, 40, "first nights"))
    return WatchedNight(
        AT, night_of(AT), period, more.pop("n_blocks", 20), n, more.pop("silent", 0)
    )


def judge(
    night: WatchedNight, spec: MotorSpec | None = None, why: str = "", fitted: Any = None
) -> JudgedNight:
    """The night judged for a motor, by default a CB560 with the default settings."""
    return judged(spec or motor(), night, fitted, why)
