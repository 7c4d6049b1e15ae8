"""`motor-leakage explain`: the figures of a motor's night, or their absence, in words.

All figures come from the published tables.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from pipeline.errors import UsageError
from pipeline.messages import counted
from pipeline.report.words import UNITS
from pipeline.schema import (
    FITS,
    INPUT_FILES,
    PARAMETERS,
    QUALITY,
    RESIDUAL_VERDICTS,
    SENSITIVITIES,
    WATCH,
    Table,
)
from pipeline.store.tables import read_rows
from pipeline.trends.rows.motor_states import FITS_OF_A_NIGHT, fit_words

Row = dict[str, Any]

# A rule that refused less than this is not worth a line.
WORTH_TELLING = 0.005
LARGEST_EFFECTS = 3
NAMES = {
    "pressure_difference": "pressure",
    "oil_temperature": "oil temperature",
    "speed": "speed",
}
PARTS_OF_A_TOTAL = {"samples": "statistical", "sensors": "sensor", "model": "model"}


def explain(output: Path, motor_id: str, night: dt.date) -> list[str]:
    """Explain a motor's night in words, line by line: the answer first, then what it rests on.

    Raises UsageError if there is no row of that motor and night, StoreError if a table is damaged.
    """
    fits = _rows(output, FITS, motor_id, night)
    if not fits:
        raise UsageError(
            "unknown_night", f"no row of motor {motor_id} in the night of {night}; run fit-fleet"
        )
    primary = next(row for row in fits if row["is_primary"])
    data = [
        *_files(_rows(output, INPUT_FILES, motor_id, night), primary["reason"]),
        *_refusals(_rows(output, QUALITY, motor_id, night)),
    ]
    lines = [_headline(motor_id, night, primary)]
    watched = list(_watched(_rows(output, WATCH, motor_id, night)))
    if primary["status"] != "ok":
        # Without a baseline it would but repeat why there is no fit.
        known = watched if len(watched) > 1 else []
        return [*lines, *_paragraph("State", known), *_paragraph("Data", data)]
    parameters = _of(primary, _rows(output, PARAMETERS, motor_id, night))
    effects = _of(primary, _rows(output, SENSITIVITIES, motor_id, night))
    tests = _of(primary, _rows(output, RESIDUAL_VERDICTS, motor_id, night))
    return [
        *lines,
        *_leakage(primary),
        *_paragraph("State", watched),
        *_paragraph("Paths", _verdicts(parameters)),
        *_paragraph("Systematic errors", _budget(primary, effects)),
        *_paragraph("Fit", (*_fit(primary), *_modes(fits))),
        *_paragraph("Errors of the fit", explain_residuals(primary, tests)),
        *_paragraph("Data", (*_kept(primary), *data)),
    ]


def _paragraph(title: str, lines: Iterable[str]) -> list[str]:
    """A title and its lines; nothing where there are none."""
    found = [f"  {line}" for line in lines]
    return ["", title, *found] if found else []


def _rows(output: Path, table: Table, motor_id: str, night: dt.date) -> list[Row]:
    rows = read_rows(output, table, [motor_id], nights=[night])
    return rows.filter(night=night).to_dicts()


def _of(fit: Row, rows: list[Row]) -> list[Row]:
    return [row for row in rows if row["flushing_mode"] == fit["flushing_mode"]]


def _headline(motor_id: str, night: dt.date, fit: Row) -> str:
    if fit["status"] == "ok":
        window = f"{fit['window_start']:%Y-%m-%d %H:%M} to {fit['window_end']:%Y-%m-%d %H:%M} UTC"
        return f"{motor_id}, night of {night}: fitted, {window}, flushing {fit['flushing_mode']}"
    failure = f" ({fit['error_code']})" if fit["error_code"] else ""
    return f"{motor_id}, night of {night}: {fit['status']}{failure}: {fit['reason']}"


def _files(rows: list[Row], told: str | None) -> Iterator[str]:
    for row in rows:
        # What failed the night stands in the headline.
        said = f"; {row['message']}" if row["message"] not in (None, told) else ""
        size = "" if row["rows"] is None else f", {counted(row['rows'], 'row')}"
        yield f"log {row['path']}: {row['status']}{size}{said}"


def _refusals(rows: list[Row]) -> Iterator[str]:
    """A line for each channel, the rule that refused most first."""
    told = [
        row
        for row in rows
        if row["reason"] not in ("any", "incomplete")
        and row["n_refused"] > WORTH_TELLING * max(row["n_samples"], 1)
    ]
    of_channel: dict[str, list[str]] = {}
    for row in sorted(told, key=lambda row: -row["n_refused"] / row["n_samples"]):
        share = 100 * row["n_refused"] / row["n_samples"]
        words = f"{row['reason'].replace('_', ' ')} {share:.1f} %"
        of_channel.setdefault(row["channel"], []).append(words)
    for channel, parts in of_channel.items():
        yield f"refused samples of {channel}: {', '.join(parts)}"


def _watched(rows: list[Row]) -> Iterator[str]:
    """What the watch says of the night."""
    for row in rows:
        yield f"{row['state'].replace('_', ' ')}: {row['sentence']}. {row['advice']}"
        if row["lack_of_fit"] is not None:
            yield (
                f"model: {row['model_verdict']}, lack of fit {100 * row['lack_of_fit']:.1f} % of "
                "the flow"
            )
        if row["evidence_limit"] is not None:
            evidence = "none" if row["evidence"] is None else f"ln R {row['evidence']:.1f}"
            yield f"evidence of a change: {evidence}; told from {row['evidence_limit']:.1f} on"


def _kept(fit: Row) -> Iterator[str]:
    yield (
        f"kept {100 * fit['kept_share']:.0f} % of the running motor's samples; "
        f"{fit['n_training']} train, {fit['n_validation']} validate"
    )


def _fit(fit: Row) -> Iterator[str]:
    parts = [
        fit_words(name, fit[column])
        for column, name in FITS_OF_A_NIGHT.items()
        if fit[column] is not None
    ]
    yield f"fit: {', '.join(parts) or 'the flow has no shape to fit'}"
    status = fit["interval_status"]
    if status.startswith("ok: "):
        yield status.removeprefix("ok: ")
    elif status != "ok":
        yield f"no intervals: {status}"


def _leakage(fit: Row) -> Iterator[str]:
    at = (
        f"{fit['reference_pressure_bar']:g} bar, {fit['reference_temperature_c']:g} °C, "
        f"{fit['reference_speed_rpm']:g} rpm"
    )
    if fit["reference_leakage_l_per_min"] is None:
        yield f"no reference leakage ({at}): {fit['reference_reason']}"
    else:
        yield f"reference leakage ({at}): {_figure(fit, 'reference_leakage')}"
    own = (
        f"{fit['own_pressure_bar']:.0f} bar, {fit['own_temperature_c']:.1f} °C, "
        f"{fit['own_speed_rpm']:.0f} rpm"
    )
    if fit["own_conditions_leakage_l_per_min"] is None:
        yield f"no leakage at the night's own mean ({own}): {fit['own_conditions_reason']}"
    else:
        yield f"leakage at the night's own mean ({own}): {_figure(fit, 'own_conditions_leakage')}"


def _figure(fit: Row, name: str) -> str:
    """Value with its interval and its total ±, as far as there are any."""
    text = f"{fit[f'{name}_l_per_min']:.4g} l/min"
    if fit[f"{name}_lower"] is not None:
        text += f" [{fit[f'{name}_lower']:.4g}, {fit[f'{name}_upper']:.4g}]"
    if fit[f"{name}_total_half_width"] is not None:
        parts = (
            f"{part} {fit[f'{name}_{column}_half_width']:.2g}"
            for part, column in PARTS_OF_A_TOTAL.items()
            if fit[f"{name}_{column}_half_width"] is not None
        )
        text += f", in all ± {fit[f'{name}_total_half_width']:.2g} ({', '.join(parts)})"
    stem = name.removesuffix("_leakage")
    verdict, reason = fit[f"{stem}_verdict"], fit[f"{stem}_reason"]
    if verdict not in ("identified", "fixed"):
        text += f"; {verdict}: {reason}"
    return text


def _verdicts(rows: list[Row]) -> Iterator[str]:
    for row in rows:
        if not row["parameter"].startswith(("K_", "C_", "scale_")):
            continue
        unit = f" {UNITS.get(row['unit'], row['unit'])}".rstrip()
        text = f"{row['parameter']}: {row['verdict'].replace('_', ' ')}"
        if row["verdict"] in ("identified", "uncertain"):
            text += f", {row['value']:.4g} [{row['lower']:.4g}, {row['upper']:.4g}]{unit}"
        yield f"{text}; {row['reason']}" if row["reason"] else text


def _budget(fit: Row, rows: list[Row]) -> Iterator[str]:
    """Systematic errors of the leakage that was published, and the largest of them."""
    known = fit["reference_leakage_l_per_min"] is not None
    name = "reference_leakage" if known else "own_conditions_leakage"
    effects = [row for row in rows if row["indicator"] == name]
    leakage = fit[f"{name}_l_per_min"]
    if not effects or not leakage:
        return
    if fit[f"{name}_systematic"] is not None:
        yield (
            f"{name.replace('_', ' ')} ± {fit[f'{name}_systematic']:.2g} l/min from stated "
            "tolerances; what constants do alike on all nights is not in the ± above"
        )
    largest = sorted(effects, key=lambda row: -abs(row["effect"]))[:LARGEST_EFFECTS]
    told = ", ".join(
        f"{row['source']} of {_tolerance(row)} {100 * row['effect'] / leakage:+.1f} %"
        for row in largest
    )
    yield f"largest: {told}"


def _tolerance(row: Row) -> str:
    assumed = f" (assumed: {row['assumed_sensor']})" if row["assumed_sensor"] else ""
    if row["tolerance_unit"] == "1":
        return f"{100 * row['tolerance']:g} %{assumed}"
    unit = UNITS.get(row["tolerance_unit"], row["tolerance_unit"])
    return f"{row['tolerance']:g} {unit}{assumed}"


def _modes(fits: list[Row]) -> Iterator[str]:
    if len(fits) < 2:
        return
    best = [row["flushing_mode"] for row in fits if row["is_best_on_validation"]]
    told = ", ".join(
        fit_words(row["flushing_mode"], row["validation_fit_percent"])
        for row in fits
        if row["validation_fit_percent"] is not None
    )
    yield f"modes of flushing on validation: {told}; best: {', '.join(best) or 'none'}"


def explain_residuals(fit: Row, verdicts: list[Row]) -> Iterator[str]:
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


def _whiteness(rows: list[Row]) -> Iterator[str]:
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


def _independence(rows: list[Row]) -> Iterator[str]:
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
