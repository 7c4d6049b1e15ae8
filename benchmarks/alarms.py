"""False alarms, and nights to detection, over simulated fleets.

Indicators of motors are drawn from the errors of simulated, fitted nights
(`benchmarks/simulated_fleets.py`) and watched by `leakage.course.monitoring.monitor`,
baseline and all, at one and the same setting: one false alarm in ten motor-years, shared by the
motor's indicators.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincinv

from benchmarks.night_kinds import CYCLES_S, ERRORS, KIND_HEADER, STEPS_S, Kind
from benchmarks.results_file import Part, write_stored
from benchmarks.simulated_fleets import (
    INDICATORS,
    PATHS,
    REFERENCE_LEAKAGE,
    NightErrors,
    fleet,
    night_errors,
)
from leakage.course.baseline import COEFFICIENT_FLOOR, LEAKAGE_FLOOR, BaselineSettings
from leakage.course.monitoring import MonitorSettings, monitor
from leakage.course.slope import fit_slope
from leakage.estimation.robust import MAD_TO_SD
from pipeline.arrays import Array

RATE_PER_MOTOR = 0.1
YEAR = 365
MOTORS, WORN_MOTORS = 1000, 200
PROVISIONAL = BaselineSettings().provisional_nights
RING, PISTON, SLEEVE = range(PATHS)
RAISED = ("warning", "alarm")
KINDS = (
    *(Kind(minutes, 1.0, 0.9) for minutes in (10, 30, 60)),
    Kind(60, 1.0, 0.9, STEPS_S),
    Kind(480, 0.2, 0.5),
    *(Kind(60, 10.0, phi) for phi in (0.5, 0.99, 0.999)),
    *(Kind(90, 1.0, 0.9, CYCLES_S, errors) for errors in ERRORS if errors != "wander"),
)
WATCHED_SLOPES = ("reference_leakage", "baseline_deviation")
USUAL = Kind(60, 1.0, 0.9)


@dataclass(frozen=True, slots=True)
class Wear:
    """Gap growth of a path from one night to another: evenly, or at once."""

    words: str
    path: int
    gap: float
    first: int = 0
    last: int = 120
    sudden: bool = False

    def growth(self) -> Array:
        """K over those of the first night, shape (nights, 3)."""
        night = np.arange(self.last)
        share = np.clip((night - self.first) / (self.last - self.first), 0.0, 1.0)
        factors = np.ones((self.last, PATHS))
        factors[:, self.path] = (
            1.0 + self.gap * (night >= self.first if self.sudden else share)
        ) ** 3
        return factors


# model.md, section 7, says which indicator sees the first three; the last is +10 % of leakage.
WEARS = (
    Wear("ring +37 % gap in 120 nights from the first on", RING, 0.37),
    Wear("piston +6 % gap in 120 nights from the first on", PISTON, 0.06),
    Wear("sleeve +12 % gap at once on night 72", SLEEVE, 0.12, first=72, sudden=True),
    Wear("sleeve +9 % gap in a year from night 90 on", SLEEVE, 0.09, first=90, last=455),
)


def raised(values: Array) -> list[list[int]]:
    """Nights on which each indicator of a motor, shape (nights, 5), becomes a warning or alarm."""
    known = int(np.isfinite(values).any(axis=0).sum())
    found = []
    for place in range(values.shape[1]):
        floor = COEFFICIENT_FLOOR if place < PATHS else LEAKAGE_FLOOR
        settings = MonitorSettings(
            false_alarms_per_year=RATE_PER_MOTOR / known,
            baseline=BaselineSettings(relative_floor=floor),
        )
        states = monitor(np.arange(len(values)), values[:, place], settings).states
        is_raised = np.isin(states, RAISED)
        found.append((1 + np.flatnonzero(is_raised[1:] & ~is_raised[:-1])).tolist())
    return found


def poisson_interval(count: int) -> tuple[float, float]:
    """Exact 95 % interval of an expected count (Garwood)."""
    lower = float(gammaincinv(count, 0.025)) if count else 0.0
    return lower, float(gammaincinv(count + 1, 0.975))


def rate_cells(count: int, motor_years: float) -> list[str]:
    """Count, rate, and interval of the rate."""
    lower, upper = (end / motor_years for end in poisson_interval(count))
    return [str(count), f"{count / motor_years:.3f}", f"{lower:.3f} to {upper:.3f}"]


def quantiles(nights: Sequence[float] | Array) -> str:
    """Median and 90 % quantile of nights of which some are infinite."""
    middle, late = np.quantile(nights, [0.5, 0.9], method="higher")
    return f"{middle:.0f} ({late:.0f})".replace("inf", "never")


def false_alarms() -> Part:
    """Healthy motors for a year after their provisional baseline."""
    rows = [_false_alarm_row(kind) for kind in KINDS]
    return Part(
        "False alarms",
        f"{MOTORS} healthy motors a row, each watched for a year from its provisional baseline of "
        f"{PROVISIONAL} nights on; all indicators together "
        f"({', '.join(INDICATORS)}). Configured: {RATE_PER_MOTOR:g} a motor-year. Sensors "
        "wander: temperature by 0.3 °C and gain by 0.3 % with φ = 0.6 from night to night, "
        "pressure by 0.3 bar.",
        f"{KIND_HEADER} | nights with K / reference leakage, % | robust scatter, % | "
        "false alarms | a motor-year | 95 % interval | by indicator",
        rows,
    )


def _false_alarm_row(kind: Kind) -> list[str]:
    healthy = np.ones((PROVISIONAL + YEAR, PATHS))
    values = fleet(night_errors(kind), healthy, MOTORS, np.random.default_rng(2))
    counts = np.array([[len(one) for one in raised(values[:, motor])] for motor in range(MOTORS)])
    nights = values.reshape(-1, len(INDICATORS))
    known = 100 * np.isfinite(nights).mean(axis=0)
    scatter = 100 * MAD_TO_SD * np.nanmedian(np.abs(nights - np.nanmedian(nights, 0)), axis=0)
    return [
        *kind.words,
        f"{known[:PATHS].max():.0f} / {known[REFERENCE_LEAKAGE]:.0f}",
        " / ".join(f"{one:.1f}" for one in scatter).replace("nan", "–"),
        *rate_cells(int(counts.sum()), MOTORS),
        " / ".join(str(count) for count in counts.sum(axis=0)),
    ]


def detection() -> Part:
    """Wear that begins with the first night, or at once, told by K itself and by anything."""
    rows = []
    for kind in KINDS:
        errors = night_errors(kind)
        rows.append([*kind.words, *(_nights_to_detect(errors, wear) for wear in WEARS)])
    return Part(
        "Nights to detection",
        f"{WORN_MOTORS} motors a row, sensors wander; nights from the first of the wear to the "
        "first warning, the median (and 90 % quantile): by K of the worn path, then by any "
        f"indicator. Even wear is a part of the baseline of {PROVISIONAL} nights.",
        " | ".join((KIND_HEADER, *(wear.words for wear in WEARS))),
        rows,
    )


def _nights_to_detect(errors: NightErrors, wear: Wear) -> str:
    generator = np.random.default_rng([3, wear.path])
    values = fleet(errors, wear.growth(), WORN_MOTORS, generator)
    firsts = np.array(
        [
            [
                min((night for night in one if night >= wear.first), default=np.inf)
                for one in raised(values[:, motor])
            ]
            for motor in range(WORN_MOTORS)
        ]
    )
    since = firsts - wear.first + 1
    return f"{quantiles(since[:, wear.path])}; {quantiles(since.min(axis=1))}"


def slopes() -> Part:
    """Coverage of slope intervals of motors that do not wear."""
    errors, rows = night_errors(USUAL), []
    for length in (60, 120, 365):
        for wanders in (False, True):
            generator = np.random.default_rng([6, length, int(wanders)])
            values = fleet(errors, np.ones((length, PATHS)), MOTORS, generator, wanders)
            held = np.zeros(len(WATCHED_SLOPES))
            for motor in range(MOTORS):
                for place, indicator in enumerate(WATCHED_SLOPES):
                    series = values[:, motor, INDICATORS.index(indicator)]
                    line = fit_slope(np.arange(length), series, median=False)
                    if line.lower is not None and line.upper is not None:
                        held[place] += line.lower <= 0.0 <= line.upper
            shares = [f"{100 * one / MOTORS:.1f}" for one in held]
            rows.append([f"{length}", "yes" if wanders else "no", *shares])
    return Part(
        "Coverage of 95 % intervals of slopes",
        f"{MOTORS} motors a row that do not wear, nights of {USUAL.minutes:g} minutes; share of "
        "intervals that hold 0, in %.",
        " | ".join(("nights", "wander", *WATCHED_SLOPES)),
        rows,
    )


PARTS: dict[str, Callable[[], Part]] = {
    "false_alarms": false_alarms,
    "detection": detection,
    "slopes": slopes,
}


def main(options: Sequence[str] = ()) -> None:
    """Measure all parts or some, and write `benchmarks/results/alarms.md`."""
    text = (
        "Nights by length, rate, φ of the short errors, load and other errors, as in `coverage.md`."
    )
    write_stored("alarms", "Alarms on simulated fleets", text, PARTS, options)
