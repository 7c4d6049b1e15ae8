"""Findings of the residual analysis of a fit, in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

Row = dict[str, Any]

NAMES = {
    "pressure_difference": "pressure",
    "oil_temperature": "oil temperature",
    "speed": "speed",
}


def explain_residuals(fit: Row, verdicts: Sequence[Row]) -> Iterator[str]:
    """Lines on the errors before smoothing, of training and of validation."""
    for part in ("training", "validation"):
        rows = [row for row in verdicts if row["part"] == part and not row["smoothed"]]
        if not rows:
            continue
        yield _size(fit, part)
        yield from (f"{part} errors: {text}" for text in _whiteness(rows))
        yield from (f"{part} errors: {text}" for text in _independence(rows))


def _size(fit: Row, part: str) -> str:
    rmse, mean = fit[f"{part}_rmse_l_per_min"], fit[f"{part}_mean_error_l_per_min"]
    if rmse is None or mean is None:
        return f"{part} errors: no samples"
    text = f"{part} errors: {rmse:.3g} l/min (root mean square), {mean:+.2g} on average"
    summed = "n_effective_summed" if part == "training" else "validation_n_effective_summed"
    count = fit[f"n_{part}"]
    if fit[summed] is not None:
        text += f"; {count} samples tell as much as {fit[summed]:.0f} independent ones"
    return text


def _whiteness(rows: Sequence[Row]) -> Iterator[str]:
    for row in rows:
        if row["test"] != "whiteness":
            continue
        if row["verdict"] == "not_tested":
            yield f"not tested: {row['reason']}"
        elif row["verdict"] == "passed":
            yield "white; none tells of a later one"
        else:
            yield (
                f"not white ({row['n_outside']} of {row['n_lags']} lags outside the 99 % band), "
                "as is usual of a model without memory"
            )


def _independence(rows: Sequence[Row]) -> Iterator[str]:
    tests = [row for row in rows if row["test"] == "independence"]
    passed = [NAMES[row["input"]] for row in tests if row["verdict"] == "passed"]
    if passed:
        yield f"independent of {' and '.join(passed) if len(passed) < 3 else 'all inputs'}"
    for row in tests:
        if row["verdict"] == "failed":
            yield _dependence(row)
    reasons = {row["reason"] for row in rows if row["test"] == "whiteness"}
    for row in tests:
        if row["verdict"] == "not_tested" and row["reason"] not in reasons:
            yield f"independence of {NAMES[row['input']]} not tested: {row['reason']}"


def _dependence(row: Row) -> str:
    name, lag = NAMES[row["input"]], row["largest_lag_s"]
    place = "at once" if not lag else f"{abs(lag):g} s {'earlier' if lag > 0 else 'later'}"
    text = (
        f"depend on {name} (p = {row['p_value']:.2g}, {row['n_outside']} of {row['n_lags']} lags "
        f"outside the 99 % band); the largest correlation is {row['largest_value']:+.2g}, with the "
        f"{name} {place}"
    )
    if not row["n_outside"]:
        text += "; it is in how the correlation changes with the lag, as a delay makes it"
    return text
