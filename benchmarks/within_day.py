"""Delay and false alarms of looks within the day, over simulated motors.

Each motor has 60 days of two-minute blocks that calibrate it, days that nothing happens on, and
days with a step. Its errors are those of the noise library, means of 10 Hz samples, or follow
those of two records of real pumps, UT2 and UT3 (surrogates: correlated over 15 to 20 minutes,
1.5 % for UT3 and 20 % for UT2; the records themselves have half a day). All have the wander of
sensors from night to night. Beside the look: a fixed limit on the drain flow, and a moving mean of
the relative error over half an hour, each with the limit that gives it the same false alarms on
the motor's own calibration days.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.error_kinds import heavy_tailed, night_wander, warm_up
from benchmarks.results_file import Part, description, median_and_late, write_parts
from leakage.course.step_detection import (
    BlockErrors,
    StepWatch,
    advance,
    block_errors,
    limit_of_maxima,
)
from pipeline.arrays import Array
from pipeline.demo.noise import autoregression, phi_of

Draw = Callable[[np.random.Generator, int], Array]

BLOCK_MINUTES = 2.0
RATE_HZ, SAMPLE_SD = 10.0, 0.1
BLOCKS = 240
DAY_HOURS = BLOCKS * BLOCK_MINUTES / 60.0
CALIBRATION_DAYS, QUIET_DAYS, STEP_DAYS = 60, 730, 40
MOTORS = 4
STEPS = (0.2, 0.5, 0.8)
STEP_AT = 90
MEAN_BLOCKS = 15
NEVER, FAR = np.inf, 1000.0
YEARS = MOTORS * QUIET_DAYS / 365.0
UNEXCLUDED = "warm-up 10 %, not left out"


def of_samples(phi: float) -> Draw:
    """Means of blocks of first-order samples: their covariance over blocks is that of an ARMA."""
    n = round(BLOCK_MINUTES * 60 * RATE_HZ)
    lags = np.arange(1, n)
    variance = SAMPLE_SD**2 / n * (1.0 + 2.0 * float(np.sum((1.0 - lags / n) * phi**lags)))

    def draw(rng: np.random.Generator, days: int) -> Array:
        # Blocks are longer than twelve correlation times: next to nothing carries over.
        return np.sqrt(variance) * rng.standard_normal((days, BLOCKS))

    return draw


def correlated(minutes: float, sd: float, white_sd: float) -> Draw:
    """Slow errors with a time constant, and white ones."""

    def draw(rng: np.random.Generator, days: int) -> Array:
        white = rng.standard_normal(days * BLOCKS)
        slow = autoregression(white, phi_of(BLOCK_MINUTES, minutes)).reshape(days, BLOCKS)
        return sd * slow + white_sd * rng.standard_normal((days, BLOCKS))

    return draw


def with_warm_up(draw: Draw, at_start: float, excluded_minutes: float) -> Draw:
    """Errors that fade after each start, of which the first minutes are left out (nan)."""
    minutes = BLOCK_MINUTES * (np.arange(BLOCKS) + 0.5)
    fading = warm_up(60.0 * minutes, at_start)

    def drawn(rng: np.random.Generator, days: int) -> Array:
        sizes = rng.uniform(0.5, 1.5, (days, 1))
        found = draw(rng, days) + sizes * fading
        return np.where(minutes < excluded_minutes, np.nan, found)

    return drawn


CASES: dict[str, Draw] = {
    "φ 0.9 at 10 Hz": of_samples(0.9),
    "φ 0.99 at 10 Hz": of_samples(0.99),
    "AR of 5 min, 3 %": correlated(5.0, 0.03, 0.005),
    "AR of 15 min, 3 %": correlated(15.0, 0.03, 0.005),
    "AR of 60 min, 3 %": correlated(60.0, 0.03, 0.005),
    "t₅ blocks, 1 %": lambda rng, days: 0.01 * heavy_tailed(rng, (days, BLOCKS), 5.0),
    "warm-up 10 %, left out": with_warm_up(of_samples(0.9), 0.1, 20.0),
    UNEXCLUDED: with_warm_up(of_samples(0.9), 0.1, 0.0),
    "UT3-like (surrogate)": correlated(15.0, 0.015, 0.01),
    "UT2-like (surrogate)": correlated(20.0, 0.2, 0.05),
}


@dataclass(frozen=True, slots=True)
class Rule:
    """A rule: statistic of each block and day; told where it exceeds the limit."""

    name: str
    statistic: Callable[[Array, Array], Array]
    limit: float

    def delays(self, flow: Array, error: Array) -> Array:
        """Minutes from the step to the end of the block that tells it; infinite where none does."""
        told = self.statistic(flow, error)[:, STEP_AT:] > self.limit
        first = BLOCK_MINUTES * (np.argmax(told, axis=1) + 1.0)
        return np.where(told.any(axis=1), first, NEVER)

    def false_days(self, flow: Array, error: Array) -> int:
        """Days on which it tells something."""
        return int((self.statistic(flow, error) > self.limit).any(axis=1).sum())


def looked(errors: BlockErrors) -> Callable[[Array, Array], Array]:
    """The statistic of a look, each day on its own."""

    def statistic(flow: Array, error: Array) -> Array:
        days = len(flow)
        watch, found = StepWatch.begin(errors, (days,)), []
        for at in range(BLOCKS):
            watch, evidence = advance(
                watch, errors, np.full(days, at), flow[:, at], (flow * error)[:, at]
            )
            found.append(evidence.statistic)
        return np.array(found).T

    return statistic


def fixed(flow: Array, error: Array) -> Array:
    """Drain flow itself [l/min]."""
    return np.nan_to_num(flow * (1.0 + error))


def moving_mean(_: Array, error: Array) -> Array:
    """Mean of the relative errors of the last half hour."""
    total = np.cumsum(np.nan_to_num(error), axis=1)
    total[:, MEAN_BLOCKS:] -= total[:, :-MEAN_BLOCKS].copy()
    return total / MEAN_BLOCKS


def flows(rng: np.random.Generator, days: int) -> Array:
    """Expected flow [l/min]: the duty changes every quarter of an hour."""
    steps = rng.uniform(0.6, 1.6, (days, -(-BLOCKS // 8)))
    return np.repeat(steps, 8, axis=1)[:, :BLOCKS]


def calibrated_rules(rng: np.random.Generator, draw: Draw) -> tuple[Rule, ...]:
    """Rules calibrated on a motor's first days."""
    flow, error = flows(rng, CALIBRATION_DAYS), errors_of(rng, draw, CALIBRATION_DAYS)
    there = np.isfinite(error)
    number = np.arange(error.size).reshape(error.shape)[there]
    found = block_errors(number, flow[there], (flow * error)[there])
    look = looked(found)
    rules = [Rule("look", look, limit_of_maxima(look(flow, error).max(axis=1)))]
    for name, statistic in (("fixed limit", fixed), ("moving mean", moving_mean)):
        maxima = statistic(flow, error).max(axis=1)
        # The same quantile, without the floor of a look.
        rules.append(Rule(name, statistic, limit_of_maxima(maxima + FAR) - FAR))
    return tuple(rules)


def errors_of(rng: np.random.Generator, draw: Draw, days: int) -> Array:
    """Relative errors of some days: those of a case, and the wander of the sensors."""
    wander = night_wander(rng, (days,))
    # 1.3 % of the flow for a kelvin, 0.2 % for a bar.
    shift = wander.gain + 0.013 * wander.temperature_c + 0.002 * wander.pressure_bar
    return draw(rng, days) + shift[:, None]


def case_rows(name: str) -> tuple[list[tuple[str, ...]], int]:
    """Rows of a case, and the false alarms of its looks."""
    false: defaultdict[str, int] = defaultdict(int)
    delays: defaultdict[tuple[str, float], list[float]] = defaultdict(list)
    draw, place = CASES[name], list(CASES).index(name)
    for number in range(MOTORS):
        rng = np.random.default_rng([1, place, number])
        rules = calibrated_rules(rng, draw)
        quiet = flows(rng, QUIET_DAYS), errors_of(rng, draw, QUIET_DAYS)
        flow, error = flows(rng, STEP_DAYS), errors_of(rng, draw, STEP_DAYS)
        for rule in rules:
            false[rule.name] += rule.false_days(*quiet)
            for step in STEPS:
                stepped = error + step * (1.0 + error) * (np.arange(BLOCKS) >= STEP_AT)
                delays[rule.name, step] += rule.delays(flow, stepped).tolist()
    rows = [
        (name, rule, f"{n / YEARS:.2f}", *(median_and_late(delays[rule, step]) for step in STEPS))
        for rule, n in false.items()
    ]
    return rows, false["look"]


def write(found: Mapping[str, tuple[list[tuple[str, ...]], int]]) -> None:
    """Write the page from the rows of all cases."""
    counted = [n for name, (_, n) in found.items() if name != UNEXCLUDED]
    years = YEARS * len(counted)
    part = Part(
        "Delays and false alarms",
        f"{MOTORS} motors a row, {YEARS:.0f} motor-years of quiet days of {DAY_HOURS:.0f} hours, "
        f"and {MOTORS * STEP_DAYS} days with each step. Delays in minutes from the step to the "
        "end of the block that tells it, median / 90 %; –: not on that day. Looks in all rows but "
        f"“{UNEXCLUDED}”: {sum(counted)} false alarms in {years:.0f} motor-years.",
        " | ".join(
            ["errors", "rule", "false a motor-year", *(f"+{100 * step:.0f} %" for step in STEPS)]
        ),
        [row for rows, _ in found.values() for row in rows],
    )
    write_parts("within_day", "Steps within the day", description(__doc__), [part])


def main() -> None:
    """Write `benchmarks/results/within_day.md`."""
    write({name: case_rows(name) for name in CASES})
