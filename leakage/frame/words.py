"""The words of a fit to a frame."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from leakage.estimation.misfit import Misfit
from leakage.estimation.validation import Agreement, is_poor

if TYPE_CHECKING:
    from leakage.frame.result import FrameFit

Part = Literal["training", "validation"]

PARTS: tuple[Part, Part] = ("training", "validation")
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
        return "\n".join(
            [
                self.title,
                *(f"warning: {one}" for one in self.warnings),
                "",
                lines[0],
                "-" * max(map(len, lines)),
                *lines[1:],
                "",
                *self.notes,
            ]
        )

    __repr__ = __str__


def summary(fit: FrameFit) -> Summary:
    """Summary of a fit."""
    return Summary(
        f"{fit.motor.motor_type}: {fit.used.sum()} samples, {_span(fit)}, {_seen(fit)}",
        tuple(_warnings(fit)),
        (HEADINGS, *map(_row, _coefficients(fit))),
        (*_fits(fit), *_residuals(fit), _model(fit)),
    )


def _coefficients(fit: FrameFit) -> list[dict[str, Any]]:
    """Rows of `FrameFit.columns`."""
    columns = fit.columns()
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _agreements(fit: FrameFit) -> dict[str, Agreement]:
    return dict(zip(PARTS, (fit.training, fit.validation), strict=True))


def _warnings(fit: FrameFit) -> Iterator[str]:
    if n_left_out := (~fit.samples.kept).sum():
        yield f"{n_left_out} rows lack a value and are left out"
    for row in _coefficients(fit):
        if row["verdict"] not in ("identified", "fixed"):
            yield f"{row['parameter']}: {row['verdict'].replace('_', ' ')}: {row['reason']}"
    for part, judged in _agreements(fit).items():
        if is_poor(judged.fit_percent):
            yield f"{part}: the model is worse than a constant flow"
    if not fit.validation.n:
        yield "no samples validate this fit"
    misfit = fit.estimate.misfit
    if misfit is not None and misfit.is_clear and misfit.share > LARGEST_MISFIT:
        yield f"the model does not describe these samples: {_misfit(misfit)}"


def _row(row: Mapping[str, Any]) -> tuple[str, ...]:
    told = row["lower"] is not None
    return (
        row["parameter"],
        f"{row['value']:.4g}" if told or row["verdict"] == "fixed" else "-",
        IN_WORDS.get(row["unit"], row["unit"]),
        f"[{row['lower']:.4g}, {row['upper']:.4g}]" if told else "-",
        f"{row['total_half_width']:.2g}" if told else "-",
        row["verdict"].replace("_", " "),
    )


def _fits(fit: FrameFit) -> Iterator[str]:
    for part, judged in _agreements(fit).items():
        if judged.n:
            yield (
                f"{part}: fit {_percent(judged)}, rmse {judged.rmse_l_per_min:.3g} l/min, mean "
                f"error {judged.mean_error_l_per_min:+.2g} l/min, {judged.n} samples"
            )


def _residuals(fit: FrameFit) -> Iterator[str]:
    for part in PARTS:
        if not (fit.parts == part).any():
            continue
        found = fit.residual_tests(part)
        failed = [
            f"{name.replace('_', ' ')}"
            for name, test in found.independence.items()
            if test.verdict == "failed"
        ]
        if found.whiteness.verdict == "not_tested":
            yield f"errors of {part}: not tested, {found.whiteness.reason}"
            continue
        white = "white" if found.whiteness.verdict == "passed" else "not white"
        related = f"go with {', '.join(failed)}" if failed else "independent of every input"
        yield f"errors of {part}: {white}, {related}"


def _model(fit: FrameFit) -> str:
    misfit = fit.estimate.misfit
    if misfit is None:
        return "model: too few blocks to judge it"
    if not misfit.is_clear and misfit.noise_share > LARGEST_MISFIT:
        noise = 100 * misfit.noise_share
        return f"model: these samples cannot tell; noise alone looks like a misfit of {noise:.1f} %"
    return f"model: {_misfit(misfit)}"


def _misfit(misfit: Misfit) -> str:
    return f"{100 * misfit.share:.1f} % of the leakage goes with what the model does not describe"


def _percent(judged: Agreement) -> str:
    return "-" if judged.fit_percent is None else f"{judged.fit_percent:.1f} %"


def _seen(fit: FrameFit) -> str:
    seen = fit.blocks.excitation
    ends = {"bar": seen.pressure_bar, "°C": seen.temperature_c, "rpm": seen.speed_rpm}
    return ", ".join(f"{low:.0f} to {high:.0f} {unit}" for unit, (low, high) in ends.items())


def _span(fit: FrameFit) -> str:
    first, last = fit.samples.time_us[fit.used][[0, -1]].tolist()
    if not fit.samples.on_clock:
        return f"{first / 1e6:.0f} to {last / 1e6:.0f} s"
    epoch = dt.datetime(1970, 1, 1, tzinfo=dt.UTC)
    begin, end = (epoch + dt.timedelta(microseconds=at) for at in (first, last))
    return f"{begin:%Y-%m-%d %H:%M} to {end:%Y-%m-%d %H:%M} UTC"
