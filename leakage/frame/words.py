"""The words of a fit to a frame."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from leakage.estimation.identifiability import Excitation
from leakage.estimation.misfit import Misfit
from leakage.estimation.residual_analysis import ResidualAnalysis
from leakage.estimation.validation import Agreement, is_poor
from leakage.frame.samples import FrameSamples

# Structured misfit over the leakage from which on a model does not describe a motor.
LARGEST_MISFIT = 0.02
IN_WORDS = {"m3": "m³", "l_per_min": "l/min", "1": ""}
HEADINGS = ("coefficient", "value", "unit", "95 % interval", "total ±", "verdict")


@dataclass(frozen=True, slots=True)
class Summary:
    """A summary, which prints as text."""

    title: str  # motor, samples, times and operating conditions
    warnings: tuple[str, ...]  # what to know before a figure is used
    table: tuple[tuple[str, ...], ...]  # headings, then a row a coefficient
    notes: tuple[str, ...]  # fit, residuals and model, a line each

    def __str__(self) -> str:
        widths = [max(map(len, column)) for column in zip(*self.table, strict=True)]
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
            for row in self.table
        ]
        lines[1:1] = ["-" * max(map(len, lines))]
        warnings = [f"warning: {warning}" for warning in self.warnings]
        return "\n".join([self.title, *warnings, "", *lines, "", *self.notes])

    __repr__ = __str__


def title(motor_type: str, used: FrameSamples, seen: Excitation) -> str:
    """Return motor, number and times of the samples behind the estimates, and what they span."""
    ends = {"bar": seen.pressure_bar, "°C": seen.temperature_c, "rpm": seen.speed_rpm}
    spans = ", ".join(f"{low:.0f} to {high:.0f} {unit}" for unit, (low, high) in ends.items())
    first, last = used.time_us[[0, -1]].tolist()
    times = f"{first / 1e6:.0f} to {last / 1e6:.0f} s"
    if used.on_clock:
        epoch = dt.datetime(1970, 1, 1, tzinfo=dt.UTC)
        begin, end = (epoch + dt.timedelta(microseconds=at) for at in (first, last))
        times = f"{begin:%Y-%m-%d %H:%M} to {end:%Y-%m-%d %H:%M} UTC"
    return f"{motor_type}: {len(used.time_us)} samples, {times}, {spans}"


def warnings(
    n_left_out: int,
    rows: Sequence[Mapping[str, Any]],
    agreements: Mapping[str, Agreement],
    misfit: Misfit | None,
) -> Iterator[str]:
    """Yield what to know before a figure is used: rows are those of `FrameFit.columns`."""
    if n_left_out:
        yield f"{n_left_out} rows lack a value and are left out"
    for row in rows:
        if row["verdict"] not in ("identified", "fixed"):
            yield f"{row['parameter']}: {row['verdict'].replace('_', ' ')}: {row['reason']}"
    for part, of_part in agreements.items():
        if is_poor(of_part.fit_percent):
            yield f"{part}: the model is worse than a constant flow"
    if not agreements["validation"].n:
        yield "no samples validate this fit"
    if misfit is not None and misfit.is_clear and misfit.share > LARGEST_MISFIT:
        yield f"the model does not describe these samples: {_misfit(misfit)}"


def cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the cells of a coefficient."""
    has_interval = row["lower"] is not None
    return (
        row["parameter"],
        f"{row['value']:.4g}" if has_interval or row["verdict"] == "fixed" else "-",
        IN_WORDS.get(row["unit"], row["unit"]),
        f"[{row['lower']:.4g}, {row['upper']:.4g}]" if has_interval else "-",
        f"{row['total_half_width']:.2g}" if has_interval else "-",
        row["verdict"].replace("_", " "),
    )


def fits(part: str, of_part: Agreement) -> str:
    """Return how the fit to the training samples agrees with a part."""
    fit = "-" if of_part.fit_percent is None else f"{of_part.fit_percent:.1f} %"
    return (
        f"{part}: fit {fit}, rmse {of_part.rmse_l_per_min:.3g} l/min, mean "
        f"error {of_part.mean_error_l_per_min:+.2g} l/min, {of_part.n} samples"
    )


def errors(part: str, found: ResidualAnalysis) -> str:
    """Return what is left of a part after the fit."""
    if found.whiteness.verdict == "not_tested":
        return f"errors of {part}: not tested, {found.whiteness.reason}"
    white = "not autocorrelated" if found.whiteness.verdict == "passed" else "autocorrelated"
    verdicts = {name.replace("_", " "): test.verdict for name, test in found.independence.items()}
    if set(verdicts.values()) == {"passed"}:
        return f"errors of {part}: {white}, independent of every input"
    related = (
        f"{words} {', '.join(name for name, verdict in verdicts.items() if verdict == of)}"
        for of, words in (("failed", "go with"), ("not_tested", "not tested against"))
        if of in verdicts.values()
    )
    return f"errors of {part}: {white}, {', '.join(related)}"


def model(misfit: Misfit | None) -> str:
    """Return whether the model describes the samples."""
    if misfit is None:
        return "model: too few blocks to judge it"
    if not misfit.is_clear and misfit.noise_share > LARGEST_MISFIT:
        noise = 100 * misfit.noise_share
        return f"model: noise hides it: alone it looks like a misfit of {noise:.1f} %"
    return f"model: {_misfit(misfit)}"


def _misfit(misfit: Misfit) -> str:
    return f"{100 * misfit.share:.1f} % of the leakage goes with what the model does not describe"
