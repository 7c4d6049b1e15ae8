"""How often nights have an interval, how often it holds the truth, and how wide it is.

Each night is a CB560 with the placeholders of its type. Every estimate, verdict and interval is
made by the package as in a nightly run; a figure counts as known where it has an interval that the
package would publish.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from benchmarks.night_kinds import (
    CYCLES_S,
    ERRORS,
    KIND_HEADER,
    NIGHTS_A_DUTY,
    STEPS_S,
    Kind,
    SimulatedNights,
    figures,
)
from benchmarks.results_file import store, stored, write_results

NIGHTS = 1000
KINDS = (
    *(Kind(minutes, 10.0, 0.95) for minutes in (10, 15, 30, 60, 90, 480)),
    *(Kind(minutes, 10.0, 0.95, STEPS_S) for minutes in (10, 30, 60, 90)),
    *(Kind(60, 0.2, phi) for phi in (0.5, 0.95)),
    *(Kind(60, 1.0, phi) for phi in (0.5, 0.9, 0.99)),
    *(Kind(60, 10.0, phi) for phi in (0.5, 0.99, 0.999)),
    *(Kind(90, 1.0, 0.9, CYCLES_S, errors) for errors in ERRORS),
    Kind(30, 1.0, 0.9, CYCLES_S, "slow, 15 min"),
    Kind(480, 0.2, 0.5, CYCLES_S, "slow, 60 min"),
    *(Kind(minutes, 1.0, 0.9, coefficients=1) for minutes in (10, 30)),
    *(Kind(90, 1.0, 0.9, CYCLES_S, errors, 1) for errors in ("slow, 15 min", "random walk")),
)
NONE = "–"
# Figures side by side in a column.
GROUPS = {
    "K": ("K_piston_ring", "K_balance_piston", "K_balance_sleeve"),
    "leakage": ("reference", "own conditions"),
}
COLUMNS = ("with interval", "held", "median ±")


def measured(kind: Kind) -> dict[str, list[str]]:
    """Share with an interval, coverage and median half-width of each figure, in %."""
    by_figure = defaultdict(list)
    with threadpool_limits(1):
        for seed in range(NIGHTS // NIGHTS_A_DUTY):
            nights = SimulatedNights.of(kind, seed)
            for night in figures(nights, nights.flow(kind)):
                for one in night:
                    by_figure[one.name].append((one.half_width, one.error))
    return {name: _summary(np.array(found)) for name, found in by_figure.items()}


def _summary(found: NDArray[np.float64]) -> list[str]:
    known = found[np.isfinite(found[:, 0])]
    share = f"{100 * len(known) / len(found):.0f}"
    if not len(known):
        return [share, NONE, NONE]
    half_width, error = known.T
    held = np.mean(np.abs(error) <= half_width)
    return [share, f"{100 * held:.1f}", f"{100 * np.median(half_width):.3g}"]


def main(options: Sequence[str] = ()) -> None:
    """Measure all kinds of nights or some, and write `benchmarks/results/coverage.md`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks coverage")
    parser.add_argument("--first", type=int, default=0, help="first row to measure")
    parser.add_argument("--last", type=int, default=len(KINDS) - 1, help="last row to measure")
    asked = parser.parse_args(list(options))
    for kind in KINDS[asked.first : asked.last + 1]:
        store("coverage", " ".join(kind.words), measured(kind))
    found = stored("coverage")
    known = [(kind.words, found.get(" ".join(kind.words))) for kind in KINDS]
    rows = [[*words, *_columns(one)] for words, one in known if one]
    columns = (f"{group}: {name} %" for group in GROUPS for name in COLUMNS)
    header = " | ".join((KIND_HEADER, *columns))
    write_results("coverage", f"Coverage of 95 % intervals, {NIGHTS} nights a row", header, rows)


def _columns(found: dict[str, list[str]]) -> list[str]:
    return [
        " / ".join(found[figure][place] for figure in group if figure in found)
        for group in GROUPS.values()
        for place in range(len(COLUMNS))
    ]
