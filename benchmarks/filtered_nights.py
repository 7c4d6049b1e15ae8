"""Nights of 10 to 60 minutes, filtered and watched: coverage, false alarms and delay.

Each night goes through the physics: its own duty, noise with memory, and sensors that are off from
night to night (0.3 °C and 0.3 % gain, AR(1) 0.6; 0.3 bar white). Its blocks inform
`leakage.course.night_filter`, and what that says is watched by `leakage.course.monitoring` as the
pipeline does, at one false alarm in ten motor-years for the six indicators together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.error_kinds import night_wander
from benchmarks.results_file import Part, description, median_and_late, write_parts
from benchmarks.simulated_nights import REFERENCE, motor, true_coefficients
from leakage import OperatingConditions, regressors
from leakage.course.baseline import COEFFICIENT_FLOOR, LEAKAGE_FLOOR, BaselineSettings
from leakage.course.monitoring import Monitoring, MonitorSettings, monitor
from leakage.course.night_filter import first_state, follow, night_information
from leakage.estimation.block_statistics import factors
from pipeline.arrays import Array
from pipeline.demo.noise import autoregression

Wear = Callable[[int], tuple[float, float, float]]

MINUTES = (10, 20, 30, 60)
BLOCK = 120
PATHS = ("K_ring", "K_piston", "K_sleeve")
RATE = 0.1 / 6
YEAR = 365
HEALTHY_MOTORS, WORN_MOTORS = 40, 24
STEP_AT, NIGHTS_OF_STEP = 70, 110
WIDEST = 0.5
RAISED = ("warning", "alarm")
WORN: tuple[tuple[str, int, Wear], ...] = (
    ("ring +40 %", STEP_AT, lambda night: (1.0 + 0.4 * (night >= STEP_AT), 1.0, 1.0)),
    ("piston +40 %", STEP_AT, lambda night: (1.0, 1.0 + 0.4 * (night >= STEP_AT), 1.0)),
    ("sleeve +40 %", STEP_AT, lambda night: (1.0, 1.0, 1.0 + 0.4 * (night >= STEP_AT))),
    ("ring, gap +37 % over 120 nights", 0, lambda night: ((1 + 0.37 * night / 120) ** 3, 1.0, 1.0)),
)


@dataclass(frozen=True, slots=True)
class Course:
    """A motor's nights; n of them, k coefficients."""

    truth: Array  # coefficients, shape (n, k)
    mean: Array  # of what the filter says of them, with its half-widths
    half: Array
    leakage: Array  # at the reference conditions, shape (n,), with its half-widths and the truth
    leakage_half: Array
    leakage_truth: Array
    flow: Array  # mean of each night, shape (n,)
    columns: Array  # mean of each night, shape (n, c)

    def indicators(self, first: int) -> dict[str, tuple[Array, float]]:
        """What is watched, with its floor; the baseline's model is of the first nights."""
        model = np.append(np.median(self.mean[:first], axis=0), (0.0, 1.0))
        here = self.columns.mean(axis=0)
        found = {
            "reference leakage": (self.leakage, LEAKAGE_FLOOR),
            "own leakage": (self.mean @ here[:3] + here[-1], LEAKAGE_FLOOR),
            "deviation": (self.flow / (self.columns @ model), LEAKAGE_FLOOR),
        }
        for number, name in enumerate(PATHS):
            counts = self.half[:, number] <= WIDEST * self.truth[0, number]
            values = np.where(counts, self.mean[:, number], np.nan)
            found[name] = (values, COEFFICIENT_FLOOR)
        return found


def course(minutes: int, nights: int, wear: Wear, generator: np.random.Generator) -> Course:
    """A motor's nights of so many minutes."""
    of = motor()
    theta = true_coefficients(of)
    free = np.array([True, True, True, False])
    reference = regressors(of, REFERENCE)[0]
    wander = night_wander(generator, (nights,))
    state, rows = first_state(theta[:3]), []
    for night in range(nights):
        now = theta * (*wear(night), 1.0)
        seen = _duty(60 * minutes, generator)
        clean = regressors(of, OperatingConditions.from_bar(*seen)) @ np.append(now, 1.0)
        level = 0.015 * np.where(seen[0] < 100.0, 3.0, 1.0)
        noise = level * autoregression(generator.standard_normal(len(clean)), 0.95)
        read = (
            np.maximum(seen[0] + wander.pressure_bar[night], 0.5),
            seen[1] + wander.temperature_c[night],
            seen[2],
        )
        columns = regressors(of, OperatingConditions.from_bar(*read))
        flow = (1.0 + wander.gain[night]) * clean + noise
        blocks = factors(np.column_stack([columns, flow]), np.arange(0, len(flow) + 1, BLOCK))
        told = night_information(blocks, theta, free)
        state = follow(state, told, 1, theta[:3], learns_noise=night < 60)
        rows.append(
            (
                now[:3],
                state.mean,
                [state.half_width(one) for one in np.eye(3)],
                reference[:3] @ state.mean + reference[-1],
                state.half_width(reference[:3]),
                reference[:3] @ now[:3] + reference[-1],
                flow.mean(),
                columns.mean(axis=0),
            )
        )
    return Course(*(np.array(part) for part in zip(*rows, strict=True)))


def _duty(n: int, generator: np.random.Generator) -> tuple[Array, Array, Array]:
    """Load steps of a minute, and a temperature that drifts, at 1 Hz."""

    def steps(low: float, high: float) -> Array:
        drawn = generator.uniform(low, high, n // 60 + 2)
        return np.repeat(drawn, 60)[int(generator.integers(60)) :][:n]

    slow = autoregression(generator.standard_normal(n), 0.999)
    drift = generator.uniform(42.0, 58.0) + 4.0 * slow
    return steps(15.0, 300.0), np.clip(drift, 38.0, 62.0), steps(3.0, 110.0)


def watched(found: Course) -> dict[str, Monitoring]:
    """Each indicator of a motor as the pipeline watches it."""
    chosen = BaselineSettings()
    return {
        name: monitor(
            np.arange(len(values)),
            values,
            MonitorSettings(RATE, baseline=BaselineSettings(relative_floor=floor)),
        )
        for name, (values, floor) in found.indicators(chosen.provisional_nights).items()
    }


def raised(found: Monitoring) -> int:
    """How often an indicator became a warning or an alarm."""
    is_raised = np.isin(found.states, RAISED)
    return int(np.count_nonzero(is_raised[1:] & ~is_raised[:-1]))


def healthy_part() -> Part:
    """Coverage and false alarms of motors that do not wear."""
    rows = []
    for minutes in MINUTES:
        generator = np.random.default_rng([1, minutes])
        courses = [
            course(minutes, YEAR, lambda _: (1.0, 1.0, 1.0), generator)
            for _ in range(HEALTHY_MOTORS)
        ]
        held = [np.abs(one.mean - one.truth) <= one.half for one in courses]
        leakage = [np.abs(one.leakage - one.leakage_truth) <= one.leakage_half for one in courses]
        relative = [one.half / one.truth for one in courses]
        wide = [one.leakage_half / one.leakage_truth for one in courses]
        alarms = [sum(raised(found) for found in watched(one).values()) for one in courses]
        years = HEALTHY_MOTORS * (YEAR - BaselineSettings().provisional_nights) / YEAR
        for words, part in (
            ("1", slice(0, 1)),
            ("2–15", slice(1, 15)),
            ("16–365", slice(15, YEAR)),
        ):
            rows.append(
                [
                    f"{minutes}",
                    words,
                    " / ".join(
                        f"{100 * np.mean([one[part, k] for one in held]):.1f}" for k in range(3)
                    ),
                    f"{100 * np.mean([one[part] for one in leakage]):.1f}",
                    " / ".join(
                        f"{100 * np.median([one[part, k] for one in relative]):.1f}"
                        for k in range(3)
                    ),
                    f"{100 * np.median([one[part] for one in wide]):.1f}",
                    f"{sum(alarms)} in {years:.0f}" if part.stop == YEAR else "",
                ]
            )
    return Part(
        "Healthy motors",
        f"{HEALTHY_MOTORS} motors of {YEAR} nights a row. Coverage of 95 % intervals and median "
        "half-width of ring / piston / sleeve and of the reference leakage [%]; false alarms of "
        "all six indicators in so many motor-years.",
        "minutes | nights | K held | leakage held | K ± | leakage ± | false alarms",
        rows,
    )


def worn_part() -> Part:
    """Nights until a wear is told."""
    rows = []
    for words, begin, wear in WORN:
        for minutes in MINUTES if begin else (60,):
            generator = np.random.default_rng([2, minutes])
            nights = NIGHTS_OF_STEP if begin else 121
            states = [
                {name: np.isin(one.states[begin:], RAISED) for name, one in watched(found).items()}
                for found in (course(minutes, nights, wear, generator) for _ in range(WORN_MOTORS))
            ]
            cells = [
                median_and_late([_first(found[name]) for found in states])
                for name in (*PATHS, "deviation", "reference leakage")
            ]
            soonest = [min(_first(one) for one in found.values()) for found in states]
            rows.append([words, f"{minutes}", median_and_late(soonest), *cells])
    return Part(
        "Nights to detection",
        f"Median and 90 % quantile of the nights after a step (night {STEP_AT}), or of the night "
        f"itself where the wear goes on from the first; {WORN_MOTORS} motors a row; –: not within "
        f"{NIGHTS_OF_STEP - STEP_AT} nights (121).",
        " | ".join(("wear", "minutes", "any", *PATHS, "deviation", "reference leakage")),
        rows,
    )


def _first(told: NDArray[np.bool_]) -> float:
    return float(told.argmax()) if told.any() else np.inf


def main() -> None:
    """Write `benchmarks/results/filtered_nights.md`."""
    parts = [healthy_part(), worn_part()]
    write_parts("filtered_nights", "Nights with little data", description(__doc__), parts)
