"""The noise library held against a real record: sizes by time scale, tails and drift.

`python -m benchmarks noise --folder FOLDER` reads the pump rig's records in a folder (see
`validation/record.py`); no record is part of this project.

Errors are relative to the mean flow. Those of the record are given twice: beside the law by least
squares (a gap, and what leaves the case at no pressure), and beside a free function of pressure and
temperature, which leaves what no model of these channels could explain. Sizes by time scale are
standard deviations of nested means: of samples about those of 10 s, of these about those of a
minute, and so on. A setting of the library is a night of 4.5 hours of a CB560. Its distance from
the record is the mean factor between their sizes by time scale.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from benchmarks.night_kinds import CYCLES_S, ERRORS, Kind, SimulatedNights
from benchmarks.results_file import Part, description, write_parts
from benchmarks.watch.rig import METER_READS_FROM, PUMP, RPM
from leakage import Motor, OperatingConditions, regressors
from leakage.estimation.block_statistics import factor
from leakage.estimation.certificate import certify
from leakage.estimation.correlation import autocorrelation
from leakage.estimation.multi_start import Parametrisation
from leakage.estimation.robust import MAD_TO_SD
from pipeline.arrays import Array
from validation.record import FLOW, PRESSURE, TEMPERATURE, TIME, Record, read_records

Numbers = NDArray[np.int64]

SCALES_S = (10, 60, 600, 3600)
LAGS_S = (1, 60, 600)
WINDOW_S = 1200
HOURS = 4.5
NIGHTS = 5
# Pressures [bar] between which the free function is a polynomial of the temperature.
BINS_BAR = np.arange(0.0, 260.0, 10.0)
# Sizes below it count as this much in a distance [-].
LEAST_SIZE = 5e-4
HEADER = (
    "errors | all | to 10 s | to 1 min | to 10 min | to 1 h | longer | correlation after 1 / 60 "
    "/ 600 s | beyond 3 sd, % | excess kurtosis | drift of 20 min, % | distance"
)


@dataclass(frozen=True, slots=True)
class Seen:
    """Channels at 1 Hz, shape (n,) each, and the place of each sample on the clock."""

    index: Numbers
    pressure_bar: Array
    temperature_c: Array
    speed_rpm: Array
    flow_l_per_min: Array

    @property
    def conditions(self) -> OperatingConditions:
        """As the physics takes them."""
        return OperatingConditions.from_bar(self.pressure_bar, self.temperature_c, self.speed_rpm)


@dataclass(frozen=True, slots=True)
class Character:
    """What errors are like; relative to the mean flow."""

    # Of all, and by time scale: within 10 s, a minute, ten minutes, an hour, and longer.
    sizes: tuple[float, ...]
    correlations: tuple[float, ...]  # after `LAGS_S`
    # beyond, kurtosis: share beyond three robust standard deviations and excess kurtosis, of the
    # errors about their means of a minute.
    beyond: float
    kurtosis: float
    drift: float  # standard deviation of the means of 20 minutes

    def distance(self, other: Character) -> float:
        """Mean factor between the sizes by time scale of two."""
        own, others = (np.maximum(one.sizes[1:], LEAST_SIZE) for one in (self, other))
        return float(np.exp(np.mean(np.abs(np.log(own / others)))))

    def row(self, words: str, like: Character) -> list[str]:
        """Its row of the table."""
        return [
            words,
            *(f"{100 * one:.2f}" for one in self.sizes),
            " / ".join(f"{one:.2f}" for one in self.correlations),
            f"{100 * self.beyond:.1f}",
            f"{self.kurtosis:.1f}",
            f"{100 * self.drift:.2f}",
            f"{self.distance(like):.1f}",
        ]


def by_scale(error: Array, index: Numbers) -> tuple[float, ...]:
    """Sizes of errors: all, within 10 s, a minute, ten minutes, an hour, and longer."""
    sizes, rest = [float(error.std())], error
    for scale in SCALES_S:
        means = _means(error, index // scale)
        sizes.append(float((rest - means).std()))
        rest = means
    return (*sizes, float(rest.std()))


def _means(values: Array, group: Numbers) -> Array:
    """The mean of its group for each value."""
    _, place = np.unique(group, return_inverse=True)
    found: Array = (np.bincount(place, values) / np.bincount(place))[place]
    return found


def character(error: Array, index: Numbers) -> Character:
    """What errors relative to the mean flow are like."""
    short = error - _means(error, index // 60)
    z = np.abs(short) / (MAD_TO_SD * np.median(np.abs(short)))
    correlation = autocorrelation(error, index, LAGS_S[-1])
    return Character(
        by_scale(error, index),
        tuple(float(correlation[lag]) for lag in LAGS_S),
        float(np.mean(z > 3.0)),
        float(np.mean(short**4) / np.mean(short**2) ** 2 - 3.0),
        float(np.std(_means(error, index // WINDOW_S))),
    )


def of_law(seen: Seen, motor: Motor) -> Character:
    """Errors beside the law by least squares, coefficients within their bounds."""
    z = np.column_stack([regressors(motor, seen.conditions), seen.flow_l_per_min])
    bounds = Parametrisation.of(motor).coefficient_bounds()
    theta = certify(factor(z), *bounds).coefficients
    error = (z @ np.concatenate([-theta, (-1.0, 1.0)])) / seen.flow_l_per_min.mean()
    return character(error, seen.index)


def of_any_function(seen: Seen) -> Character:
    """Errors beside a free function of pressure and temperature."""
    place = np.digitize(seen.pressure_bar, BINS_BAR)
    warm = (seen.temperature_c - seen.temperature_c.mean())[:, None] ** np.arange(3)
    columns = (np.eye(len(BINS_BAR) + 1)[place][:, :, None] * warm[:, None]).reshape(len(warm), -1)
    found, *_ = np.linalg.lstsq(columns, seen.flow_l_per_min, rcond=None)
    error = (seen.flow_l_per_min - columns @ found) / seen.flow_l_per_min.mean()
    return character(error, seen.index)


def of_record(record: Record) -> Seen:
    """The warm part of a record, where its meter reads."""
    rows = record.warm().filter(pl.col(FLOW) >= METER_READS_FROM)
    second = (rows[TIME] - rows[TIME][0]).dt.total_seconds().to_numpy().astype(np.int64)
    channels = (rows[name].cast(pl.Float64).to_numpy() for name in (PRESSURE, TEMPERATURE, FLOW))
    pressure, temperature, flow = channels
    return Seen(second, pressure, temperature, np.full(len(flow), RPM), flow)


def of_setting(errors: str, seed: int) -> Character:
    """A night of the library, fitted with its own law."""
    kind = Kind(60.0 * HOURS, 1.0, 0.9, CYCLES_S, errors)
    nights = SimulatedNights.of(kind, seed)
    flow = nights.flow(kind)[:, 0]
    return of_law(Seen(np.arange(len(flow)), *nights.seen.channels, flow), nights.motor)


def mean_of(found: Sequence[Character]) -> Character:
    """The mean of some, figure by figure."""

    def mean(name: str) -> Array:
        values: Array = np.mean([getattr(one, name) for one in found], axis=0)
        return values

    return Character(
        tuple(mean("sizes").tolist()),
        tuple(mean("correlations").tolist()),
        *(float(mean(name)) for name in ("beyond", "kurtosis", "drift")),
    )


def record_part(record: Record) -> Part:
    """A record, and the settings of the library from the nearest on."""
    seen = of_record(record)
    law, left = of_law(seen, PUMP), of_any_function(seen)
    settings = {
        name: mean_of([of_setting(name, seed) for seed in range(NIGHTS)]) for name in ERRORS
    }
    rows = [law.row("the record, beside the law", left)]
    rows.append(left.row("the record, beside any function of pressure and temperature", left))
    nearest_first = sorted(settings, key=lambda name: settings[name].distance(left))
    rows += [settings[name].row(name, left) for name in nearest_first]
    text = (
        f"{len(seen.index)} samples over {seen.index[-1] / 3600:.1f} hours, mean flow "
        f"{seen.flow_l_per_min.mean():.2f} l/min. Sizes are % of the mean flow."
    )
    return Part(f"{record.name}, state {record.state}", text, HEADER, rows)


def main(options: Sequence[str] = ()) -> None:
    """Write `benchmarks/results/noise.md`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks noise")
    parser.add_argument("--folder", type=Path, required=True, help="of records *UT*.csv")
    records = read_records(parser.parse_args(list(options)).folder)
    parts = [record_part(one) for one in records]
    write_parts("noise", "The noise library against a real record", description(__doc__), parts)
