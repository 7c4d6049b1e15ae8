"""Alarms and names after a change of duty: wrong models, and wear, against the balanced baseline.

A motor of one of thirteen models runs 15 nights of a baseline and ten of another duty, with the
wander of `benchmarks/model_verdict.py`. "Plain" is the mean of the ten nights over the baseline.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.model_verdict import CASES, MODEL, Case, Logged, logged, wander
from benchmarks.results_file import Part
from benchmarks.simulated_nights import true_coefficients
from leakage.course.balanced_baseline import DutyBlocks, Rises, compare, told_rises
from leakage.course.growth import Blocks, growth
from leakage.course.hypotheses import weigh
from leakage.estimation.block_statistics import merge
from leakage.estimation.certificate import certify
from pipeline.arrays import Array

BASELINE, NOW = 15, 10
MOTORS = 24
MODELS = (
    "right, φ 0.9",
    "two-sided, 15 bar",
    "slot film",
    "roller at 60 %",
    "VG 46 under VG 68",
    "T lag 600 s",
    "T lag 60 s",
    "drain lag 20 s",
    "flow offset by load, 0.06 l/min",
    "T by load, ± 1.5 K",
    "dead band 0.3 l/min",
    "X_o + 20 %",
    "X_s − 20 %",
)
NAMES = tuple(path.name for path in MODEL.column_paths)
DUTIES = {"as before": (300.0, 110.0), "load halved": (157.0, 110.0), "speed cut": (300.0, 55.0)}
# The flushing is known.
FIXED = np.array([False, False, False, True])
BOUNDS = np.zeros(4), np.where(FIXED, 0.0, 1e-9)
LEVEL, DEVIATION = 0.15, 0.05
SEED = 1807


@dataclass(frozen=True)
class Outcome:
    """What is told after ten nights: rises of K by path and of the flow, and the named paths."""

    plain: Array
    told: Array
    flow_plain: float
    flow_told: float
    named: tuple[str, ...]
    compared: int


def after_a_change(case: Case, duty: str, wear: Sequence[float], seed: int) -> Outcome:
    """A motor whose duty, and gaps, change after its baseline."""
    generator = np.random.default_rng([SEED, seed])
    errors = wander(BASELINE + NOW, generator)
    before = [logged(case, one, generator) for one in errors[:BASELINE]]
    now = [logged(case, one, generator, *DUTIES[duty], wear) for one in errors[BASELINE:]]
    then = _blocks(before)
    model = certify(merge(then.factors), *BOUNDS).coefficients
    found = [compare(then, _blocks([one]), *BOUNDS) for one in now]
    plain = [certify(merge(one.factors), *BOUNDS).coefficients for one in now]
    rises, errors_of, parts = (np.full((NOW, len(NAMES)), np.nan) for _ in range(3))
    flow, share, plain_flow = np.full(NOW, np.nan), np.full(NOW, np.nan), []
    for place, (night, one) in enumerate(zip(now, found, strict=True)):
        whole = merge(night.factors)
        sums = whole[:, -3] @ whole
        plain_flow.append(sums[-1] / (sums[:3] @ model[:3] + sums[-2]) - 1.0)
        if one is not None:
            k = np.where(one.then[:3] > 0.0, one.then[:3], np.nan)
            rises[place] = one.now[:3] / k - 1.0
            errors_of[place] = np.linalg.norm(one.root, axis=0)[:3] / k
            parts[place] = k * sums[:3] / (sums[:3] @ one.then[:3] + sums[-2])
            flow[place], share[place] = np.expm1(one.log_ratio), one.effective_share
    told = np.array(
        [
            told_rises(Rises(rises[:, at], errors_of[:, at], parts[:, at], flow, share), BASELINE)
            for at in range(len(NAMES))
        ]
    )
    nothing, all_of_it = np.zeros(NOW), np.ones(NOW)
    flow_told = told_rises(Rises(flow, nothing, all_of_it, flow, share), BASELINE)
    last = np.nan_to_num(told[:, -1])
    return Outcome(
        np.mean(plain, axis=0)[:3] / np.maximum(model[:3], 1e-30) - 1.0,
        last,
        float(np.mean(plain_flow)),
        float(np.nan_to_num(flow_told[-1])),
        tuple(name for name in _named(then, _blocks(now)) if last[NAMES.index(name)] > 0.0),
        sum(one is not None for one in found),
    )


def _blocks(nights: Sequence[Logged]) -> DutyBlocks:
    factors = np.concatenate([one.factors for one in nights])
    label = np.repeat(np.arange(len(nights)), len(factors) // len(nights))
    return DutyBlocks(factors, np.concatenate([one.means for one in nights]), label)


def _named(before: DutyBlocks, now: DutyBlocks) -> tuple[str, ...]:
    """Paths that the explanation names, of those that are gaps."""
    periods = (Blocks(one.factors, one.nights, one.conditions[:, 0]) for one in (before, now))
    found = growth(NAMES, *periods, true_coefficients(MODEL), ~FIXED, "cam_roller")
    named = () if found is None else weigh(found).named
    return tuple(name for name in named if name in NAMES)


def false_alarms(motors: int = MOTORS) -> Part:
    """Healthy motors under each model."""
    rows = []
    for duty in DUTIES:
        found = _many([(CASES[name], duty, (1.0, 1.0, 1.0)) for name in MODELS], motors)
        n = len(found)
        counts = (
            sum(bool((one.plain > LEVEL).any()) for one in found),
            sum(bool((one.told > 0.0).any()) for one in found),
            sum(one.flow_plain > DEVIATION for one in found),
            sum(one.flow_told > 0.0 for one in found),
            sum(bool(one.named) for one in found),
        )
        compared = 100.0 * sum(one.compared for one in found) / (n * NOW)
        shares = (f"{one} ({100.0 * one / n:.1f} %)" for one in counts)
        rows.append([duty, str(n), *shares, f"{compared:.0f}"])
    return Part(
        "False alarms after a change of duty",
        f"{len(MODELS)} models, {motors} motors each; goal: 1 % by the rule. "
        "Told in the tenth night.",
        (
            "duty now | motors | K plain, +15 % | K by the rule | flow plain, +5 % | flow by "
            "the rule | a path named | nights compared, %"
        ),
        rows,
    )


def wear_told(motors: int = MOTORS) -> Part:
    """Wear that comes with another duty, under the right model and one that nobody can see."""
    rows = []
    for model in ("right, φ 0.9", "X_s − 20 %"):
        for duty in DUTIES:
            for at, name in enumerate(NAMES):
                factors = [2.0 if place == at else 1.0 for place in range(len(NAMES))]
                found = _many([(CASES[model], duty, factors)], motors)
                others = [place for place in range(len(NAMES)) if place != at]
                counts = (
                    sum(one.told[at] > 0.0 for one in found),
                    sum(bool((one.told[others] > 0.0).any()) for one in found),
                    sum(one.flow_told > 0.0 for one in found),
                    sum(one.named == (name,) for one in found),
                    sum(bool(set(one.named) - {name}) for one in found),
                )
                rows.append([model, duty, name.replace("_", " "), *(str(one) for one in counts)])
    return Part(
        "Wear at another duty",
        f"{motors} motors a row; K of a path +100 %. Told in the tenth night, if it is compared.",
        "model | duty now | path | its K | another K | flow | named | wrong name",
        rows,
    )


def _many(cases: Sequence[tuple[Case, str, Sequence[float]]], motors: int) -> list[Outcome]:
    return [after_a_change(*one, seed) for one in cases for seed in range(motors)]
