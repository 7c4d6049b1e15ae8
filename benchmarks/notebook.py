"""A fit in a notebook beside the nightly run: the same figures, and what it costs.

Same figures: for each motor and night of a fleet, `prepare_log(...).fit()` against the rows that
the nightly run's step makes of the same log, equal to the last bit or not; and against the
published tables.

Cost: one frame of 864 000 rows, a day at 10 Hz, fitted by `fit_frame`, and by the nightly run's own
steps in the same process: regressors, blocks and their factors, error budget, fit without the
verdicts and intervals. Both in turn, processor time, medians. What the
frame has on top is reading its columns; what the night has on top is left out of its time.
"""

from __future__ import annotations

import argparse
import datetime as dt
import statistics as statistics_of
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from benchmarks.results_file import Part, write_stored
from benchmarks.simulated_nights import duty
from leakage import FrameFit, fit_frame, total_flow_l_per_min
from leakage.estimation.sample_blocks import TRAINING, VALIDATION
from leakage.estimation.validation import agreement
from leakage.frame.words import PARTS
from pipeline.clock import latest_us
from pipeline.config import MotorSpec, load_fleet
from pipeline.config.nights import night
from pipeline.logs.motor_logs import LogShelf
from pipeline.night.fit import fit_modes
from pipeline.night.fit_night import fit_night
from pipeline.night.sample_rows import statistics_rows
from pipeline.night.statistics import night_statistics
from pipeline.night.stored_blocks import StoredBlocks
from pipeline.night.time_base import Samples
from pipeline.night.tolerances import tolerances
from pipeline.notebook import open_tables, prepare_log
from pipeline.notebook.preparing import raw_channels
from pipeline.schema.fits import OK

CONFIG = Path("configs/fleet.toml")
FIRST = dt.date(2026, 1, 2)
NIGHT = "the nightly run's steps"
SAMPLES, RATE_HZ, REPEATS = 864_000, 10, 15
CONDITIONS = ("pressure_bar", "temperature_c", "speed_rpm")

Figures = dict[str, Any]


def main(options: Sequence[str] = ()) -> None:
    """Measure and write `benchmarks/results/notebook.md`; of a fitted fleet."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks notebook", add_help=False)
    parser.add_argument("--config", type=Path, default=CONFIG)
    known, rest = parser.parse_known_args(list(options))
    makers: dict[str, Callable[[], Part]] = {
        "figures": lambda: same_figures(known.config),
        "published": lambda: published(known.config),
        "cost": cost,
    }
    write_stored("notebook", "A fit in a notebook beside the nightly run", __doc__, makers, rest)


def same_figures(config: Path) -> Part:
    """Every night of a fleet by the nightly run's step, and by `prepare_log(...).fit()`."""
    fleet = load_fleet(config)
    compared: dict[str, list[int]] = {}
    outcomes: dict[str, int] = {}
    for spec in fleet.motors:
        logs = LogShelf(spec, {}, latest_us(), {})
        for label in sorted(logs.present()):
            channels = raw_channels(spec, logs, label)
            assert not isinstance(channels, str)
            outcome = fit_night(spec, night(label, spec.settings.nights), channels, {})
            outcomes[outcome.status] = outcomes.get(outcome.status, 0) + 1
            if outcome.status != OK:
                continue
            fit, *_ = outcome.rows["fits"]
            mode = fit["flushing_mode"]
            rows = (row for row in outcome.rows["parameters"] if row["flushing_mode"] == mode)
            wanted = published_figures(fit, rows)
            found = prepare_log(fleet, spec.motor_id, label).fit()
            for name, value in figures_of(found, fit).items():
                counts = compared.setdefault(name.split(" ")[0], [0, 0])
                counts[0] += 1
                counts[1] += value == wanted.get(name)
    if not compared:
        sys.exit(f"{config} has no nights: run `make fit-fleet` first, or name a fleet by --config")
    n, equal = (sum(counts[at] for counts in compared.values()) for at in (0, 1))
    return Part(
        "The same figures",
        f"{equal} of {n} figures are equal to the last bit. Nights: "
        f"{', '.join(f'{count} {status}' for status, count in outcomes.items())}.",
        "figure | compared | equal",
        [[name, str(counts[0]), str(counts[1])] for name, counts in compared.items()],
    )


def published(config: Path) -> Part:
    """Estimates of every published night beside those of a fit to its frame."""
    fleet = load_fleet(config)
    apart: dict[bool, list[float]] = {}
    fits = open_tables(fleet.output).fits().filter(status=OK).collect()
    for row in fits.iter_rows(named=True):
        prepared = prepare_log(fleet, row["motor_id"], row["night"])
        assert prepared.motor is not None
        is_free = row["roller_is_free"]
        motor = prepared.motor.with_free_standard() if is_free else prepared.motor
        found = prepared.fit(motor)
        at = found.leakage(*(row[f"own_{one}"] for one in CONDITIONS))
        pairs = [
            (at.leakage_l_per_min, row["own_conditions_leakage_l_per_min"]),
            *zip(found.params.values(), row["coefficients"], strict=False),
        ]
        differences = [abs(own / other - 1.0) for own, other in pairs if other]
        apart.setdefault(is_free, []).append(max(differences))
    return Part(
        "The published tables",
        "Once a motor's baseline asks for it, the nightly run estimates the scale of the rollers' "
        "curve as well, and makes these fits from stored blocks: `fit(motor.with_free_standard())` "
        "sums the same samples in another order.",
        "scale of the rollers | nights | largest relative difference of an estimate",
        [
            ["estimated" if is_free else "as stated", str(len(of)), f"{max(of):.1e}"]
            for is_free, of in apart.items()
        ],
    )


FROM_PARAMETERS = ("value", "lower", "upper", "total_half_width", "verdict", "reason")


def published_figures(fit: Figures, parameters: Iterable[Figures]) -> Figures:
    """Figures of a night's rows in `fits` and `parameters`."""
    found = dict(fit)
    for row in parameters:
        found |= {f"{name} {row['parameter']}": row.get(name) for name in FROM_PARAMETERS}
    return found


def figures_of(found: FrameFit, fit: Figures) -> Figures:
    """The same figures of a fit to a frame, its leakages at the conditions of the published row."""
    slow, structured = found.identification.slow, found.estimate.misfit
    figures: Figures = {
        "model_misfit_percent": None if structured is None else 100.0 * structured.share,
        "slow_error_memory": slow.memory,
        "slow_error_ratio": slow.variance_ratio,
        "correlation_time_s": found.memory_s,
    }
    for part, judged in zip(PARTS, (found.training, found.validation), strict=True):
        figures |= {
            f"n_{part}": judged.n,
            f"{part}_fit_percent": judged.fit_percent,
            f"{part}_rmse_l_per_min": judged.rmse_l_per_min,
            f"{part}_mean_error_l_per_min": judged.mean_error_l_per_min,
            f"{part}_whiteness": found.residual_tests(part).whiteness.verdict,
        }
    for name, leakage in (("own", "own_conditions"), ("reference", "reference")):
        judged_at = found.leakage(*(fit[f"{name}_{one}"] for one in CONDITIONS))
        told = judged_at.information if judged_at.is_told else None
        figures |= {
            f"{leakage}_leakage_l_per_min": judged_at.leakage_l_per_min
            if judged_at.is_told
            else None,
            f"{leakage}_leakage_statistical_half_width": told and told.half_width,
            f"{leakage}_verdict": judged_at.verdict,
        }
    columns = found.columns()
    for at, name in enumerate(columns["parameter"]):
        figures |= {
            f"{one} {name}": (columns[one][at] or None) if one == "reason" else columns[one][at]
            for one in FROM_PARAMETERS
        }
    return figures


def cost() -> Part:
    """Processor time of a day at 10 Hz, by `fit_frame` and by the night's own steps."""
    spec = demo_motor()
    frame, samples = day_of(spec)
    here = night(FIRST, spec.settings.nights)
    motor, sensors = spec.motor(FIRST, "none"), tolerances(spec, FIRST)
    rows = statistics_rows("M", FIRST, motor, night_statistics(spec, motor, here, samples))

    def by_night() -> float:
        begin = time.process_time()
        statistics = night_statistics(spec, motor, here, samples)
        spent = time.process_time() - begin
        blocks = StoredBlocks.of_tonight(spec, rows, statistics.factors)
        begin = time.process_time()
        (mode,), _ = fit_modes(spec, FIRST, statistics, blocks)
        for part in (TRAINING, VALIDATION):
            agreement(statistics.judged_on(part), mode.training.coefficients)
        return spent + time.process_time() - begin

    kinds: dict[str, Any] = {
        "Polars": frame,
        "pandas": frame.to_pandas(),
        "PyArrow": frame.to_arrow(),
        "arrays": {name: frame[name].to_numpy() for name in frame.columns},
    }

    def by_frame(of: Any) -> float:
        begin = time.process_time()
        fit_frame(of, motor, tolerances=sensors)
        return time.process_time() - begin

    taken: dict[str, list[float]] = {name: [] for name in (NIGHT, *kinds)}
    for _ in range(REPEATS + 1):
        taken[NIGHT].append(by_night())
        for name, of in kinds.items():
            taken[name].append(by_frame(of))
    # The first of each warms up.
    medians = {name: statistics_of.median(one[1:]) for name, one in taken.items()}
    return Part(
        "The cost",
        f"{SAMPLES} rows, medians of {REPEATS} in turn, processor time. Goal: at most 1.3.",
        "fitted from | processor time | over the night's steps",
        [
            [name, f"{1000 * one:.0f} ms", f"{one / medians[NIGHT]:.2f}"]
            for name, one in medians.items()
        ],
    )


def demo_motor() -> MotorSpec:
    """A CB560 of the demo, fitted."""
    (spec,) = (one for one in load_fleet(CONFIG).motors if one.motor_id == "CB560-02")
    estimation = spec.settings.estimation.model_copy(update={"starting_points": 0})
    settings = spec.settings.model_copy(update={"estimation": estimation})
    return replace(spec, settings=settings)


def day_of(spec: MotorSpec) -> tuple[pl.DataFrame, Samples]:
    """A simulated day as a frame, and as the kept samples of a night."""
    generator = np.random.default_rng(1)
    seen = duty(SAMPLES / RATE_HZ / 3600, generator, RATE_HZ)
    flow = total_flow_l_per_min(spec.motor(FIRST, "none"), seen.conditions)
    flow = flow + 0.05 * generator.standard_normal(SAMPLES)
    period_us = 1_000_000 // RATE_HZ
    index = np.arange(SAMPLES)
    time_us = night(FIRST, spec.settings.nights).start_us + period_us * index
    samples = Samples(index, time_us, *seen.channels, flow, {}, period_us, SAMPLES, SAMPLES)
    columns = dict(
        zip(("pressure_bar", "oil_temperature_c", "speed_rpm"), seen.channels, strict=True)
    )
    frame = pl.DataFrame({"time": time_us} | columns | {"leakage_l_per_min": flow})
    return frame.with_columns(pl.col("time").cast(pl.Datetime("us", "UTC"))), samples
