"""The words of a fit to a frame: summary, explanation, short form."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from leakage.estimation.identifiability import Excitation
from leakage.estimation.model_verdict import StructuredMisfit, model_verdict, verdict_in_words
from leakage.estimation.residual_analysis import ResidualAnalysis
from leakage.estimation.validation import Agreement, is_poor

IN_WORDS = {"m3": "m³", "l_per_min": "l/min", "1": ""}
HEADINGS = ("coefficient", "value", "unit", "95 % interval", "total ±", "verdict")


@dataclass(frozen=True, slots=True)
class Words:
    """The figures of a fit that words are made of."""

    motor_type: str
    columns: Mapping[str, list[Any]]
    structured: StructuredMisfit | None
    agreements: Mapping[str, Agreement]
    tests: Mapping[str, ResidualAnalysis]
    n: int
    n_left_out: int
    ends_us: NDArray[np.int64]
    on_clock: bool
    memory_s: float
    excitation: Excitation

    def rows(self) -> Iterator[dict[str, Any]]:
        """The coefficients, one after the other."""
        for values in zip(*self.columns.values(), strict=True):
            yield dict(zip(self.columns, values, strict=True))


@dataclass(frozen=True, slots=True)
class Summary:
    """A summary as text, and as HTML in a notebook.

    Attributes
    ----------
    title
        Motor, samples and times.
    warnings
        What to know before a figure is used.
    table
        Headings, then a row a coefficient.
    notes
        Fit, residuals and model, a line each.
    """

    title: str
    warnings: tuple[str, ...]
    table: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...]

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

    def _repr_html_(self) -> str:
        def cells(row: tuple[str, ...], tag: str) -> str:
            return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in row) + "</tr>"

        warnings = "".join(f"<li><strong>{escape(one)}</strong></li>" for one in self.warnings)
        notes = "".join(f"<li>{escape(one)}</li>" for one in self.notes)
        return (
            f"<p>{escape(self.title)}</p>"
            + (f"<ul>{warnings}</ul>" if warnings else "")
            + f"<table><thead>{cells(self.table[0], 'th')}</thead><tbody>"
            + "".join(cells(row, "td") for row in self.table[1:])
            + f"</tbody></table><ul>{notes}</ul>"
        )


def summary(words: Words) -> Summary:
    """Summary of a fit."""
    return Summary(
        f"{words.motor_type}: {words.n} samples, {_span(words)}",
        tuple(_warnings(words)),
        (HEADINGS, *(_row(row) for row in words.rows())),
        (*_fits(words), *_residuals(words), _model(words)),
    )


def explanation(words: Words) -> str:
    """Explanation of a fit: the answer first, then what it rests on."""
    seen = words.excitation
    lines = [
        f"{words.motor_type}: fitted to {words.n} samples, {_span(words)}",
        f"seen: {_range(seen.pressure_bar)} bar, {_range(seen.temperature_c)} °C, "
        f"{_range(seen.speed_rpm)} rpm",
        "",
        "Paths",
    ]
    for row in words.rows():
        text = f"  {row['parameter']}: {row['verdict'].replace('_', ' ')}"
        if row["lower"] is not None:
            unit = IN_WORDS.get(row["unit"], row["unit"])
            text += f", {row['value']:.4g} [{row['lower']:.4g}, {row['upper']:.4g}] {unit}".rstrip()
        lines.append(f"{text}; {row['reason']}" if row["reason"] else text)
    lines += ["", "Fit", *(f"  {line}" for line in (*_fits(words), _model(words)))]
    lines += ["", "Errors of the fit", *(f"  {line}" for line in _residuals(words))]
    if words.memory_s:
        lines.append(
            f"  errors remember about {words.memory_s / 60:.0f} minutes; intervals are wider"
        )
    return "\n".join(lines)


def short_form(
    motor_type: str, columns: Mapping[str, list[Any]], training: Agreement, validation: Agreement
) -> str:
    """One line that tells a fit from another."""
    verdicts = columns["verdict"]
    return (
        f"<FrameFit {motor_type}: {verdicts.count('identified')} of {len(verdicts)} identified, "
        f"training {_percent(training)}, validation {_percent(validation)}>"
    )


def _warnings(words: Words) -> Iterator[str]:
    if words.n_left_out:
        yield f"{words.n_left_out} rows lack a value and are left out"
    for row in words.rows():
        if row["verdict"] not in ("identified", "fixed"):
            yield f"{row['parameter']}: {row['verdict'].replace('_', ' ')}: {row['reason']}"
    for part, judged in words.agreements.items():
        if is_poor(judged.fit_percent):
            yield f"{part}: the model is worse than a constant flow"
    if not words.agreements["validation"].n:
        yield "no samples validate this fit"
    if words.structured is not None and model_verdict(words.structured) == "disproved":
        yield f"the model is disproved: {verdict_in_words(words.structured)}"


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


def _fits(words: Words) -> Iterator[str]:
    for part, judged in words.agreements.items():
        if judged.n:
            yield (
                f"{part}: fit {_percent(judged)}, rmse {judged.rmse_l_per_min:.3g} l/min, mean "
                f"error {judged.mean_error_l_per_min:+.2g} l/min, {judged.n} samples"
            )


def _residuals(words: Words) -> Iterator[str]:
    for part, found in words.tests.items():
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


def _model(words: Words) -> str:
    if words.structured is None:
        return "model: too few blocks to judge it"
    verdict = model_verdict(words.structured)
    if verdict is None:
        noise = 100 * words.structured.noise_share
        return f"model: these samples cannot tell; noise alone looks like a misfit of {noise:.1f} %"
    return f"model: {verdict}: {verdict_in_words(words.structured)}"


def _percent(judged: Agreement) -> str:
    return "-" if judged.fit_percent is None else f"{judged.fit_percent:.1f} %"


def _range(ends: tuple[float, float]) -> str:
    return f"{ends[0]:.0f} to {ends[1]:.0f}"


def _span(words: Words) -> str:
    first, last = words.ends_us.tolist()
    if not words.on_clock:
        return f"{first / 1e6:.0f} to {last / 1e6:.0f} s"
    epoch = dt.datetime(1970, 1, 1, tzinfo=dt.UTC)
    begin, end = (epoch + dt.timedelta(microseconds=at) for at in (first, last))
    return f"{begin:%Y-%m-%d %H:%M} to {end:%Y-%m-%d %H:%M} UTC"
