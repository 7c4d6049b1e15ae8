"""What a choice of the physics does to the figures when the truth has it and the model has not.

Eight hours of a CB560 with the placeholders of its type, without noise: the truth is simulated
with the choice, the thesis's model is fitted, and its figures are compared with the truth's. Where
"bounds" is "off", the loss factors may be negative, which shows the whole of the bias.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.results_file import write_results
from benchmarks.simulated_nights import duty, motor, true_coefficients
from leakage import FilmPressure, Motor, OperatingConditions, leakage_l_per_min, regressors
from leakage.estimation.block_statistics import factor
from leakage.estimation.certificate import certify
from leakage.estimation.multi_start import Parametrisation
from leakage.physics.paths import Laminar, Parameter
from pipeline.arrays import Array

HOURS = 8.0


@dataclass(frozen=True, slots=True)
class Choice:
    """A truth that the thesis's model does not have."""

    name: str
    truth: Motor
    charge_over_case_bar: float | None = None


def choices() -> list[Choice]:
    """The choices of the physics that go beyond the thesis."""
    thesis = motor()
    slot = replace(thesis, film_pressure=FilmPressure("slot"))
    half = replace(thesis, film_pressure=FilmPressure("thesis", 0.5))
    ring = next(path for path in thesis.column_paths if path.name == "piston_ring")
    distributor = Laminar(
        "distributor",
        1,
        Parameter("C_distributor", "m3", 0.05 * ring.configured_coefficient, 0.0, 1.0, fixed=True),
    )
    return [
        Choice("none: the thesis's own truth", thesis),
        Choice("two_sided, charge 15 bar over case", thesis, 15.0),
        Choice("two_sided, charge 5 bar over case", thesis, 5.0),
        Choice('film_pressure = "slot"', slot),
        Choice("film_pressure_share = 0.5", half),
        Choice(
            "a distributor that leaks 5 % of K_o",
            replace(thesis, paths=(*thesis.paths, distributor)),
        ),
    ]


def main() -> None:
    """Measure and write `benchmarks/results/model_choices.md`."""
    seen = duty(HOURS, np.random.default_rng(1))
    rows = [
        _row(choice, bounded, seen.pressure_bar, seen.temperature_c, seen.speed_rpm)
        for choice in choices()
        for bounded in (True, False)
    ]
    header = "truth | bounds | K_o % | K_p % | K_s % | reference leakage % | fit %"
    title = "The thesis's model on truths that it does not have, change in %"
    write_results("model_choices", title, header, rows)


def _row(choice: Choice, bounded: bool, bar: Array, celsius: Array, rpm: Array) -> list[str]:
    charge = choice.charge_over_case_bar
    conditions = OperatingConditions.from_bar(bar, celsius, rpm, charge)
    flows = leakage_l_per_min(choice.truth, conditions)
    model = motor()
    thesis = OperatingConditions.from_bar(bar, celsius, rpm)
    z = np.column_stack([regressors(model, thesis), flows])
    lower, upper = Parametrisation.of(model).coefficient_bounds()
    if not bounded:
        lower, upper = lower - 1.0 * (upper > lower), upper + 1.0 * (upper > lower)
    found = certify(factor(z), lower, upper).coefficients
    theta = true_coefficients(model)
    reference = OperatingConditions.from_bar(200.0, 50.0, 30.0)
    row = regressors(model, reference)[0]
    leakage = float(row[:-2] @ found[:-1] + row[-1])
    true_reference = OperatingConditions.from_bar(200.0, 50.0, 30.0, charge)
    truth = float(leakage_l_per_min(choice.truth, true_reference)[0])
    error = z @ np.concatenate([found, (1.0, -1.0)])
    fit = 100 * (1 - np.linalg.norm(error) / np.linalg.norm(flows - flows.mean()))
    return [
        choice.name,
        "on" if bounded else "off",
        *(f"{100 * (a / b - 1):+.1f}" for a, b in zip(found[:3], theta[:3], strict=True)),
        f"{100 * (leakage / truth - 1):+.2f}",
        f"{fit:.2f}",
    ]
