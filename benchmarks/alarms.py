"""False alarms, nights to detection, and coverage, over simulated fleets.

Fleets of nightly indicators are drawn from the errors of simulated, fitted nights (see
`benchmarks/simulated_fleets.py`) and watched by `leakage.monitoring.monitor`, baseline and all, at
one and the same setting: one false alarm in ten motor-years, shared by the motor's indicators.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from benchmarks.results_file import Part, write_parts
from benchmarks.simulated_fleets import (
    INDICATORS,
    Fleet,
    NightErrors,
    healthy_fleet,
    night_errors,
)
from leakage.baseline import COEFFICIENT_FLOOR, LEAKAGE_FLOOR, BaselineSettings
from leakage.monitoring import Monitoring, MonitorSettings, monitor
from leakage.peers import peer_deviations
from leakage.robust import MAD_TO_SD
from leakage.slope import fit_slope

Array = NDArray[np.float64]

RATE_PER_MOTOR = 0.1
YEAR = 365
MOTORS = 1200
PHIS = (0.0, 0.3, 0.6)
BASELINES = ((30, 30), (60, 60), (60, 30))
FLOORS = np.where([name.startswith("K_") for name in INDICATORS], COEFFICIENT_FLOOR, LEAKAGE_FLOOR)
RAISED = ("warning", "alarm")
# Wear begins so long after the whole baseline, and is looked for so long.
HEALTHY_FIRST = 30
LOOKED_FOR = 730
WORN_MOTORS = 200
SLEEVE = 2
# Slopes: so many a row, a night's rise, the limit, and how far ahead it is looked for.
SLOPES = 1000
SLOPE = 0.20 / YEAR


@dataclass(frozen=True, slots=True)
class Wear:
    """A rise of the reference leakage: relative, at once or by the year."""

    words: str
    step: float = 0.0
    per_year: float = 0.0

    def rise(self, nights_since: Array) -> Array:
        """Relative rise so many nights after it began; 0 before."""
        begun = nights_since >= 0
        result: Array = np.where(begun, self.step + self.per_year * nights_since / YEAR, 0.0)
        return result


WEARS = (
    Wear("5 % a year", per_year=0.05),
    Wear("10 % a year", per_year=0.10),
    Wear("20 % a year", per_year=0.20),
    Wear("step of 10 %", step=0.10),
    Wear("step of 20 %", step=0.20),
)


def settings(indicator: int, baseline: tuple[int, int], indicators: int) -> MonitorSettings:
    """As the product would watch this indicator of a motor with so many."""
    return MonitorSettings(
        false_alarms_per_year=RATE_PER_MOTOR / indicators,
        baseline=BaselineSettings(
            nights=baseline[0],
            provisional_nights=baseline[1],
            relative_floor=float(FLOORS[indicator]),
        ),
    )


def watched(fleet: Fleet, baseline: tuple[int, int]) -> Iterator[list[Monitoring]]:
    """Each motor's indicators."""
    nights = np.arange(fleet.ratios.shape[0])
    chosen = [settings(at, baseline, len(INDICATORS)) for at in range(len(INDICATORS))]
    for motor in range(fleet.ratios.shape[1]):
        yield [monitor(nights, fleet.ratios[:, motor, at], chosen[at]) for at in range(len(chosen))]


def raised_at(found: Monitoring) -> list[int]:
    """Nights on which the indicator became a warning or an alarm that it was not."""
    return [one.night for one in found.changes if one.after in RAISED and one.before not in RAISED]


def poisson_interval(count: int) -> tuple[float, float]:
    """Exact 95 % interval of an expected count (Garwood)."""
    lower = float(gammaincinv(count, 0.025)) if count else 0.0
    return lower, float(gammaincinv(count + 1, 0.975))


def rate_cells(count: int, motor_years: float) -> list[str]:
    """Count, rate, and interval of the rate."""
    lower, upper = (end / motor_years for end in poisson_interval(count))
    return [str(count), f"{count / motor_years:.4f}", f"{lower:.4f} to {upper:.4f}"]


def at_the_floors(errors: NightErrors) -> Array:
    """Factors that make the indicators' robust scatter as large as their floors."""
    centre = np.nanmedian(errors.errors, axis=0)
    scatter = MAD_TO_SD * np.nanmedian(np.abs(errors.errors - centre), axis=0)
    result: Array = FLOORS / scatter
    return result


def false_alarms(errors: NightErrors) -> Part:
    """Healthy motors after their (provisional) baseline."""
    measured, raised = np.ones(len(INDICATORS)), at_the_floors(errors)
    rows = [
        _false_alarm_row(errors, words, scale, baseline, phi, years=1)
        for words, scale in (("as measured", measured), ("as the floors", raised))
        for baseline in BASELINES
        for phi in PHIS
    ]
    rows += [
        _false_alarm_row(errors, "as the floors", raised, (60, 60), phi, years=3) for phi in PHIS
    ]
    return Part(
        "False alarms",
        f"Healthy motors, {MOTORS} motor-years a row, counted from the end of the (provisional) "
        f"baseline; five indicators together ({', '.join(INDICATORS)}). Configured: "
        f"{RATE_PER_MOTOR:g} a motor-year. *As measured*: the errors of the simulated nights, "
        "which are well below the floors of 1 % and 5 %. *As the floors*: the same errors, "
        "widened until they are as large as the floors, so that the floors help no longer. The "
        "last rows watch a third of the motors for three years each.",
        (
            "scatter",
            "baseline nights",
            "years",
            "φ",
            "false alarms",
            "a motor-year",
            "95 % interval",
            "by indicator",
        ),
        rows,
    )


def _false_alarm_row(
    errors: NightErrors,
    words: str,
    scale: Array,
    baseline: tuple[int, int],
    phi: float,
    years: int,
) -> list[str]:
    whole, first = baseline
    generator = np.random.default_rng([2, whole, first, int(10 * phi), years])
    motors = MOTORS // years
    fleet = healthy_fleet(errors, first + YEAR * years, motors, phi, generator, scale)
    counts = np.zeros(len(INDICATORS), dtype=np.int64)
    for motor in watched(fleet, baseline):
        counts += [len(raised_at(one)) for one in motor]
    return [
        words,
        f"{whole}" if whole == first else f"{first}, then {whole}",
        f"{years}",
        f"{phi:g}",
        *rate_cells(int(counts.sum()), motors * years),
        " / ".join(str(count) for count in counts),
    ]


def detection(errors: NightErrors) -> Part:
    """Wear of the sleeves that raises the reference leakage, seen by it and by any indicator."""
    rows = []
    scales = {"as measured": np.ones(len(INDICATORS)), "as the floors": at_the_floors(errors)}
    for scatter, scale in scales.items():
        for length in (30, 60):
            for phi in PHIS:
                generator = np.random.default_rng([3, length, int(10 * phi)])
                nights = length + HEALTHY_FIRST + LOOKED_FOR
                fleet = healthy_fleet(errors, nights, WORN_MOTORS, phi, generator, scale)
                since = np.arange(nights, dtype=np.float64) - length - HEALTHY_FIRST
                cells = [
                    _nights_cell(*_nights_to_detect(fleet, wear.rise(since), errors, length))
                    for wear in WEARS
                ]
                rows.append([scatter, f"{length}", f"{phi:g}", *cells])
    return Part(
        "Nights to detection",
        "At the same setting. The sleeves wear from the 31st night after the baseline on, until "
        f"the reference leakage has risen as said; {WORN_MOTORS} motors a row. First: median "
        "(and 90 % quantile) of the nights until the reference leakage itself is a warning; then "
        "until any indicator of the motor is. Missed nights count as nights. The first warning "
        "after the wear began counts; motors that gave a false alarm before are left out.",
        ("scatter", "baseline nights", "φ", *(wear.words for wear in WEARS)),
        rows,
    )


def _nights_to_detect(
    fleet: Fleet, rise: Array, errors: NightErrors, length: int
) -> tuple[Array, Array]:
    """Nights until the reference leakage, and until any indicator, is raised; inf if never."""
    worn = fleet.ratios.copy()
    worn[..., 0] += rise[:, None]
    worn[..., 4] += rise[:, None]
    worn[..., 1 + SLEEVE] += rise[:, None] / errors.shares[SLEEVE]
    begin = length + HEALTHY_FIRST
    own, motor = [], []
    for indicators in watched(Fleet(worn, fleet.raw_flow), (length, length)):
        firsts = [min((night for night in raised_at(one)), default=np.inf) for one in indicators]
        if min(firsts) < begin:
            continue
        own.append(firsts[0] - begin + 1)
        motor.append(min(firsts) - begin + 1)
    return np.array(own), np.array(motor)


def _nights_cell(*several: Array) -> str:
    def of(nights: Array) -> str:
        middle, late = np.quantile(nights, [0.5, 0.9], method="higher")
        return f"{middle:.0f} ({late:.0f})"

    return "; ".join(of(nights) for nights in several)


def raw_flow(errors: NightErrors) -> Part:
    """A fixed threshold on the night's mean drain flow, on the same fleets."""
    rows = []
    for phi in PHIS:
        generator = np.random.default_rng([4, int(10 * phi)])
        nights = 60 + HEALTHY_FIRST + LOOKED_FOR
        healthy = healthy_fleet(errors, 60 + YEAR, MOTORS, phi, generator).raw_flow
        fleet = healthy_fleet(errors, nights, WORN_MOTORS, phi, generator).raw_flow
        since = np.arange(nights, dtype=np.float64) - 60 - HEALTHY_FIRST
        ratio_of_healthy = healthy / healthy[:60].mean(axis=0)
        as_rare = _threshold_at(ratio_of_healthy, int(RATE_PER_MOTOR * MOTORS))
        for words, threshold in (("+30 %", 0.3), ("0.1 false alarms", as_rare)):
            above = _crossings(ratio_of_healthy, threshold)
            cells = []
            for wear in WEARS:
                flow = fleet * (1.0 + wear.rise(since)[:, None])
                ratio = flow[60 + HEALTHY_FIRST :] / flow[:60].mean(axis=0)
                first = np.where((ratio > 1 + threshold).any(axis=0), 0.0, np.inf)
                first += (ratio > 1 + threshold).argmax(axis=0) + 1
                cells.append(_nights_cell(first).replace("inf", "never"))
            rows.append(
                [f"{phi:g}", f"{words} ({100 * threshold:.0f} %)", f"{above / MOTORS:.2f}", *cells]
            )
    return Part(
        "What a fixed threshold on raw drain flow gives",
        "The same fleets; the night's mean drain flow over the mean of the motor's first 60 "
        f"nights, alarm on a single night above. It scatters by "
        f"{100 * float(np.std(errors.raw_flow)):.0f} %, as pressure and temperature differ from "
        "night to night. Median (90 % quantile) of the nights until the first alarm, within "
        f"{LOOKED_FOR}; a threshold that is often wrong is often early by chance.",
        ("φ", "threshold", "false alarms a motor-year", *(wear.words for wear in WEARS)),
        rows,
    )


def _threshold_at(ratio: Array, crossings: int) -> float:
    """Lowest threshold, in steps of a thousandth, that is crossed no more often."""
    for threshold in np.arange(0.05, 2.0, 0.001):
        if _crossings(ratio, float(threshold)) <= crossings:
            return float(threshold)
    return 2.0


def _crossings(ratio: Array, threshold: float) -> int:
    """How often nights after the baseline come to lie above, from below."""
    above = ratio[60:] > 1.0 + threshold
    return int((above[1:] & ~above[:-1]).sum() + above[0].sum())


def slopes(errors: NightErrors) -> Part:
    """Coverage of slope intervals and of times to a limit."""
    rows = []
    for n in (60, 120, 365):
        for phi in PHIS:
            for missing in (0.0, 0.3):
                generator = np.random.default_rng([5, n, int(10 * phi), int(10 * missing)])
                fleet = healthy_fleet(errors, n, SLOPES, phi, generator)
                for at in (0, 2):
                    values = fleet.ratios[..., at] + SLOPE * np.arange(n)[:, None]
                    values[generator.random(values.shape) < missing] = np.nan
                    cells = _coverage_cells(values)
                    rows.append(
                        [INDICATORS[at], f"{n}", f"{phi:g}", f"{100 * missing:.0f}", *cells]
                    )
    return Part(
        "Coverage of 95 % intervals",
        f"{SLOPES} motors a row that wear by {100 * SLOPE * YEAR:.0f} % a year, scatter as "
        "measured. Nights are missing at random, beside those that are gated (some 20 % of the "
        "reference leakage's); with fewer than 60 left the slope is marked provisional.",
        (
            "indicator",
            "nights",
            "φ",
            "missing, %",
            "provisional, %",
            "slope, %",
        ),
        rows,
    )


def _coverage_cells(values: Array) -> list[str]:
    nights = np.arange(len(values))
    of_slope = provisional = 0
    for one in values.T:
        line = fit_slope(nights, one)
        assert line.lower is not None
        assert line.upper is not None
        of_slope += line.lower <= SLOPE <= line.upper
        provisional += line.status == "provisional"
    return [f"{100 * count / values.shape[1]:.1f}" for count in (provisional, of_slope)]


def tank(errors: NightErrors) -> Part:
    """Four motors on one tank whose oil thins by 20 %."""
    rows = []
    circuits, motors, baseline = 125, 4, (60, 60)
    nights = np.arange(60 + YEAR)
    thin = {
        "at once": np.where(nights >= 150, 1 / 0.8, 1.0),
        "over 90 nights": np.exp(np.clip((nights - 150) / 90, 0, 1) * np.log(1 / 0.8)),
    }
    wear = Wear("", per_year=0.20).rise(nights.astype(np.float64) - 150.0)
    for words, common in thin.items():
        for phi in PHIS:
            for worn in (False, True):
                generator = np.random.default_rng([6, int(10 * phi), int(worn)])
                counts = _Tank()
                for _ in range(circuits):
                    fleet = healthy_fleet(errors, len(nights), motors, phi, generator)
                    ratios = fleet.ratios * common[:, None, None]
                    if worn:
                        for at, share in ((0, 1.0), (4, 1.0), (1 + SLEEVE, errors.shares[SLEEVE])):
                            ratios[:, 0, at] *= 1.0 + wear / share
                    counts.watch(nights, ratios, baseline, worn)
                healthy = circuits * (motors - worn)
                first = _nights_cell(np.array(counts.seen)) if worn else "–"
                rows.append(
                    [
                        words,
                        f"{phi:g}",
                        "yes" if worn else "no",
                        *rate_cells(counts.false, healthy),
                        f"{100 * counts.common / counts.nights:.0f}",
                        first,
                    ]
                )
    return Part(
        "A tank whose oil thins by 20 %",
        f"{circuits} circuits of {motors} motors, 60 nights of baseline and a year; from night "
        "150 on everything rises by 25 %. False alarms of motors that do not wear, a motor-year; "
        "how many of their nights and indicators, from 20 nights after the oil has thinned on, "
        "say `common_cause`; and where one motor's sleeves wear as well, so that the reference "
        "leakage rises by 20 % a year from night 150 on, nights until it is told.",
        (
            "oil thins",
            "φ",
            "one motor wears",
            "false alarms",
            "a motor-year",
            "95 % interval",
            "common cause, %",
            "nights until the wear is told",
        ),
        rows,
    )


class _Tank:
    """Counts over circuits."""

    def __init__(self) -> None:
        self.false = self.common = self.nights = 0
        self.seen: list[float] = []

    def watch(
        self, nights: NDArray[np.int64], ratios: Array, baseline: tuple[int, int], worn: bool
    ) -> None:
        """Watch one circuit; motor 0 wears."""
        firsts = []
        for at in range(len(INDICATORS)):
            peers = peer_deviations(np.log(ratios[..., at]))
            chosen = settings(at, baseline, len(INDICATORS))
            for motor in range(ratios.shape[1]):
                found = monitor(nights, ratios[:, motor, at], chosen, peers.others[:, motor])
                raised = raised_at(found)
                if worn and motor == 0:
                    firsts += [night - 149.0 for night in raised if night >= 150]
                    continue
                self.false += len(raised)
                late = found.states[260:]
                self.common += late.count("common_cause")
                self.nights += len(late)
        if worn:
            self.seen.append(min(firsts, default=np.inf))


def main() -> None:
    """Measure and write `benchmarks/results/alarms.md`."""
    errors = night_errors()
    scatter = MAD_TO_SD * np.nanmedian(
        np.abs(errors.errors - np.nanmedian(errors.errors, axis=0)), axis=0
    )
    sd = np.nanstd(errors.errors, axis=0)
    told = "; ".join(
        f"{name} {100 * robust:.2f} ({100 * whole:.2f})"
        for name, robust, whole in zip(INDICATORS, scatter, sd, strict=True)
    )
    write_parts(
        "alarms",
        "Alarms on simulated fleets",
        f"Relative scatter of the {len(errors.errors)} simulated nights that the fleets are drawn "
        f"from, in %, robust (and plain): {told}.",
        [part(errors) for part in (false_alarms, detection, raw_flow, slopes, tank)],
    )


if __name__ == "__main__":
    main()
