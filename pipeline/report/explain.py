"""The figures of a motor's night, or their absence, in words, from the published tables.

And what the thesis adds on request: its search from several points, which shows that it ends at the
proven minimum, and how little its gap heights and eccentricities mean.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from leakage import Motor
from leakage.estimation.blocks import merge, with_free_known
from leakage.estimation.proven_minimum import Search, coefficients_at, free_parameters, search
from pipeline.config import Fleet, MotorSpec
from pipeline.errors import UsageError
from pipeline.messages import counted, figure, plain, statement
from pipeline.night.fit import scale_of
from pipeline.night.rows import coefficient_names, explain_warm_up
from pipeline.night.statistics import BLOCK_COLUMNS, StoredBlocks
from pipeline.schema import (
    BLOCKS,
    ERROR_BUDGET,
    FITS,
    LEAST_GAIN_PERCENT,
    LOG_FILES,
    NIGHTS,
    OK,
    PARAMETERS,
    PREDICTIONS,
    QUALITY,
    QUALITY_REASONS,
    RESIDUAL_TESTS,
    Row,
    model_verdict,
)
from pipeline.store.tables import read_rows
from pipeline.trends.motor_states import FITS_OF_A_NIGHT, fit_words

Paragraph = tuple[str, list[str]]  # a title and its lines; the headline has none
# Tables that the words on a night are made from.
EXPLAINED = (
    *(NIGHTS, FITS, PARAMETERS, ERROR_BUDGET),
    *(RESIDUAL_TESTS, PREDICTIONS, QUALITY, LOG_FILES),
)
# A rule that refused less than this is not worth a line.
LEAST_REFUSED = 0.005
LARGEST_EFFECTS = 5
UNITS = {
    "m3": "m³",
    "um": "µm",
    "l_per_min": "l/min",
    "1": "",
    "percent": "%",
}


def explain(output: Path, motor_id: str, night: dt.date) -> list[str]:
    """Explain a motor's night in words, line by line: the answer first, then what it rests on.

    Raises UsageError if there is no row of that motor and night, StoreError if a table is damaged.
    """
    rows = {
        table.name: read_rows(output, table, [motor_id], nights=[night])
        .filter(night=night)
        .to_dicts()
        for table in EXPLAINED
    }
    if not rows["nights"]:
        raise UsageError(
            "unknown_night", f"no row of motor {motor_id} in the night of {night}; run fit-fleet"
        )
    (_, headline), *others = paragraphs(rows)
    lines = [
        line for title, texts in others for line in ("", title, *(f"  {text}" for text in texts))
    ]
    return [*headline, *lines]


def paragraphs(rows: Mapping[str, list[Row]]) -> list[Paragraph]:
    """Return paragraphs on a motor's night from its rows by table, the headline first."""
    (own,) = rows["nights"]
    data = [*_files(rows["log_files"], own["reason"]), *_refusals(rows["quality"])]
    if own["status"] != OK:
        # Without a baseline it would but repeat why there is no fit.
        known = list(_state(own)) if own["evidence_limit"] is not None else []
        parts = [("", [_headline(own, None)]), ("State", known), ("Data", data)]
        return [part for part in parts if part[1]]
    fits = rows["fits"]
    fit = next(row for row in fits if row["is_primary"])
    parameters, effects, tests, predictions = (
        [row for row in rows[table.name] if row["flushing_mode"] == fit["flushing_mode"]]
        for table in (PARAMETERS, ERROR_BUDGET, RESIDUAL_TESTS, PREDICTIONS)
    )
    samples = (
        f"kept {own['kept_percent']:.0f} % of the running motor's samples; "
        f"{fit['n_training']} train, {fit['n_validation']} validate"
    )
    parts = [
        ("", [_headline(own, fit)]),
        ("Leakage", list(_leakages(own, fit))),
        ("State", list(_state(own))),
        ("Paths", list(_verdicts(parameters))),
        ("Systematic errors", list(_budget(fit, effects))),
        ("Fit", list(_fit(own, fit, fits))),
        ("Errors of the fit", [*explain_residuals(fit, tests), *explain_warm_up(predictions)]),
        ("Data", [samples, *data]),
    ]
    return [part for part in parts if part[1]]


def _headline(own: Row, fit: Row | None) -> str:
    motor_id, night = own["motor_id"], own["night"]
    if fit is not None:
        window = f"{fit['window_start']:%Y-%m-%d %H:%M} to {fit['window_end']:%Y-%m-%d %H:%M} UTC"
        return f"{motor_id}, night of {night}: fitted, {window}, flushing {fit['flushing_mode']}"
    failure = f" ({own['error_code']})" if own["error_code"] else ""
    return f"{motor_id}, night of {night}: {own['status']}{failure}: {own['reason']}"


def _files(rows: list[Row], reason: str | None) -> Iterator[str]:
    for row in rows:
        # What failed the night stands in the headline.
        message = f"; {row['message']}" if row["message"] not in (None, reason) else ""
        size = "" if row["rows"] is None else f", {counted(row['rows'], 'row')}"
        yield f"log {row['path']}: {row['status']}{size}{message}"


def _refusals(rows: list[Row]) -> Iterator[str]:
    """Yield a line for each channel, the rule that refused most first."""
    notable = [
        row
        for row in rows
        if row["reason"] not in ("any", "incomplete")
        and row["n_refused"] > LEAST_REFUSED * max(row["n_samples"], 1)
    ]
    of_channel: dict[str, list[str]] = {}
    for row in sorted(notable, key=lambda row: -row["n_refused"] / row["n_samples"]):
        share = 100 * row["n_refused"] / row["n_samples"]
        words = f"{refusal(row['reason'])} {share:.1f} %"
        of_channel.setdefault(row["channel"], []).append(words)
    for channel, parts in of_channel.items():
        yield f"excluded samples of {plain(channel)}: {', '.join(parts)}"


def refusal(code: str) -> str:
    """Return words of a rule that refuses samples."""
    reason = QUALITY_REASONS.get(code)
    return plain(code) if reason is None else reason.words


def _state(own: Row) -> Iterator[str]:
    """Yield state of the night, and what it rests on."""
    if own["state"] is None:
        return
    yield f"{plain(own['state'])}: {statement(own['sentence'], own['advice'])}"
    if own["evidence_limit"] is not None:
        error = own["model_error_percent"]
        yield f"model: {of_model(error)}, model error {error:.1f} % of the flow"
        evidence = "none" if own["evidence"] is None else f"ln R {own['evidence']:.1f}"
        limit = f"a change is detected above {own['evidence_limit']:.1f}"
        yield f"evidence of a change: {evidence}; {limit}"


def of_model(model_error_percent: float) -> str:
    """Return the verdict on a model by what it misses of the flow."""
    return model_verdict(model_error_percent / 100.0)


def _fit(own: Row, fit: Row, fits: list[Row]) -> Iterator[str]:
    parts = [
        fit_words(name, own[column])
        for column, name in FITS_OF_A_NIGHT.items()
        if own[column] is not None
    ]
    yield f"fit: {', '.join(parts) or 'the flow has no shape to fit'}"
    yield from lag_words(own["drain_delay_s"], fit)
    status = fit["interval_status"]
    if status != "ok":
        is_ok = status.startswith("ok: ")
        yield status.removeprefix("ok: ") if is_ok else f"no intervals: {status}"
    known = {
        row["flushing_mode"]: row["validation_fit_percent"]
        for row in fits
        if row["validation_fit_percent"] is not None
    }
    if len(fits) > 1:
        modes = ", ".join(fit_words(mode, percent) for mode, percent in known.items())
        best = [mode for mode, percent in known.items() if percent == max(known.values())]
        yield f"modes of flushing on validation: {modes}; best: {', '.join(best) or 'none'}"


def lag_words(paired_s: float, fit: Row) -> Iterator[str]:
    """Yield how the drain flow is paired with its inputs, and what the night itself says of it."""
    lag_s, gain = fit["drain_lag_s"], fit["drain_lag_gain_percent"]
    gains = lag_s is not None and gain >= LEAST_GAIN_PERCENT
    if not (paired_s or gains):
        return
    own = "this night has no lag of its own"
    if gains:
        own = f"by this night it lags {lag_s:.1f} s, which explains {gain:.0f} % more of it"
    yield f"drain flow paired with inputs {paired_s:.1f} s before: {own}"


def _leakages(own: Row, fit: Row) -> Iterator[str]:
    """Yield the two leakages with their conditions, or why there is none."""
    why = f"none without a baseline: {own['sentence'] or own['leakage_reason']}"
    at = f", {_conditions(own, 'own')}" if own["own_pressure_bar"] is not None else ""
    places = {
        "own": f"at its usual operating point (that of its baseline{at})",
        "reference": f"at the reference ({_conditions(fit, 'reference')})",
    }
    for name, place in places.items():
        if own[f"{name}_leakage_l_per_min"] is None:
            yield f"{place}: {why if own['baseline_start'] is None else own['leakage_reason']}"
        else:
            ends = ("l_per_min", "lower", "upper")
            value, lower, upper = (own[f"{name}_leakage_{end}"] for end in ends)
            yield f"{place}: {value:#.4g} l/min [{lower:#.4g}, {upper:#.4g}]"
    if fit["fitted_leakage_l_per_min"] is None:
        yield f"at the reference by the night's own fit: none, {fit['fitted_leakage_reason']}"
    else:
        yield f"at the reference by the night's own fit: {_figure(fit)}"


def _conditions(row: Row, kind: str) -> str:
    """Return conditions of a leakage; `kind` is how their columns begin."""
    return conditions(
        *(row[f"{kind}_{quantity}"] for quantity in ("pressure_bar", "temperature_c", "speed_rpm"))
    )


def conditions(
    pressure_bar: float | None, temperature_c: float | None, speed_rpm: float | None
) -> str:
    """Return conditions of a leakage in words."""
    return f"{figure(pressure_bar)} bar, {figure(temperature_c)} °C, {figure(speed_rpm)} rpm"


def _figure(fit: Row) -> str:
    """Return leakage by the night's own fit with interval and total ±, as far as there are any."""
    name = "fitted_leakage"
    text = f"{fit[f'{name}_l_per_min']:#.4g} l/min"
    if fit[f"{name}_lower"] is not None:
        text += f" [{fit[f'{name}_lower']:#.4g}, {fit[f'{name}_upper']:#.4g}]"
    if fit[f"{name}_total_l_per_min"] is not None:
        text += f", in all ± {fit[f'{name}_total_l_per_min']:.2g}"
    if fit[f"{name}_verdict"] not in ("identified", "fixed"):
        text += f"; {fit[f'{name}_verdict']}: {fit[f'{name}_reason']}"
    return text


def _verdicts(rows: list[Row]) -> Iterator[str]:
    for row in rows:
        if not row["parameter"].startswith(("K_", "C_", "scale_")):
            continue
        unit = f" {UNITS.get(row['unit'], row['unit'])}".rstrip()
        text = f"{row['parameter']}: {plain(row['verdict'])}"
        if row["verdict"] in ("identified", "uncertain"):
            text += f", {row['value']:.4g} [{row['lower']:.4g}, {row['upper']:.4g}]{unit}"
        yield f"{text}; {row['reason']}" if row["reason"] else text


def _budget(fit: Row, rows: list[Row]) -> Iterator[str]:
    """Yield systematic errors of the leakage at the reference, and the largest of them."""
    leakage = fit["fitted_leakage_l_per_min"]
    effects = [row for row in rows if row["indicator"] == "fitted_leakage" and row["effect"]]
    if not effects or not leakage:
        return
    if stated := [row["effect"] for row in effects if not row["is_assumed"]]:
        yield (
            f"leakage at the reference ± {math.hypot(*stated):.2g} l/min from "
            "stated tolerances; what constants do alike on all nights is not in the ± above"
        )
    for row in sorted(effects, key=lambda row: -abs(row["effect"]))[:LARGEST_EFFECTS]:
        percent = 100.0 * row["effect"] / leakage
        yield f"{plain(row['source'])} of {_tolerance(row)}: {percent:+z.1f} %"


def _tolerance(row: Row) -> str:
    assumed = " (assumed by the kind of sensor)" if row["is_assumed"] else ""
    if row["tolerance_unit"] == "1":
        return f"{100 * row['tolerance']:g} %{assumed}"
    unit = UNITS.get(row["tolerance_unit"], row["tolerance_unit"])
    return f"{row['tolerance']:g} {unit}{assumed}"


def explain_residuals(fit: Row, tests: list[Row]) -> Iterator[str]:
    """Yield lines on the errors of training and of validation."""
    for part in ("training", "validation"):
        rows = [row for row in tests if row["part"] == part]
        if rows:
            yield f"{part} errors: {_size(fit, part)}"
            yield f"{part} errors: {_tests(rows)}"


def _size(fit: Row, part: str) -> str:
    rmse, mean = fit[f"{part}_rmse_l_per_min"], fit[f"{part}_mean_error_l_per_min"]
    if rmse is None or mean is None:
        return "no samples"
    n_effective = fit[f"n_{part}_effective"]
    text = f"{rmse:.3g} l/min (root mean square), {round(mean, 6):+z.2g} on average"
    if n_effective is None:
        return text
    return f"{text}; {fit[f'n_{part}']} samples ({n_effective:.0f} effective)"


def _tests(rows: list[Row]) -> str:
    """Return what the tests of whiteness and of independence from each input say."""
    (white,) = [row for row in rows if row["test"] == "whiteness"]
    if white["verdict"] == "not_tested":
        return f"not tested, {white['reason']}"
    inputs = {plain(row["input"]): row["verdict"] for row in rows if row["test"] == "independence"}
    reach_s = max(lag for row in rows for lag in row["lags_s"])
    words = {
        "failed": "depend on {}",
        "passed": f"independent of {{}} within {reach_s:g} s",
        "not_tested": "not tested against {}",
    }
    against = [
        text.format(", ".join(names))
        for verdict, text in words.items()
        if (names := [name for name, of in inputs.items() if of == verdict])
    ]
    pairs = zip(white["correlations"], white["bounds"], strict=True)
    outside = [abs(value) > bound for value, bound in pairs if None not in (value, bound)]
    memory = "not autocorrelated"
    if white["verdict"] != "passed":
        memory = f"autocorrelated, {sum(outside)} of {len(outside)} lags outside the 99 % band"
    return "; ".join((memory, *against))


def audit(fleet: Fleet, motor_id: str, night: dt.date) -> list[str]:
    """Return the audit of a motor's fits of a night, in lines; none without a fit."""
    spec = fleet.motor(motor_id)
    fits, blocks = (
        read_rows(fleet.output, table, [motor_id], columns, [night])
        for table, columns in ((FITS, ()), (BLOCKS, BLOCK_COLUMNS))
    )
    rows, blocks = fits.filter(pl.col("coefficients").is_not_null()), blocks.sort("block_start")
    return [line for row in rows.to_dicts() for line in ("", *_lines(spec, row, blocks))]


def _lines(spec: MotorSpec, row: dict[str, Any], blocks: pl.DataFrame) -> Iterator[str]:
    mode = row["flushing_mode"]
    motor = spec.stated.motor(row["night"], mode)
    stored = StoredBlocks.of(spec, blocks, motor.columns)
    if stored is None:
        return
    factors = stored.factors
    if coefficient_names(motor) != row["coefficient_names"]:
        factors = with_free_known(factors, *scale_of(motor))
        motor = motor.with_free_standard()
    # The search of the thesis over all samples, with the same draws for the same motor and night.
    text = f"1|{spec.motor_id}|{row['night']}|{mode}"
    seed = int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")
    outcome = search(merge(factors), motor, np.random.default_rng(seed))
    yield f"Audit, flushing {mode}"
    if outcome.starts:
        gap = "" if outcome.gap is None else f", the best {outcome.gap:+.1e}"
        yield (
            f"  search: {len(outcome.at_minimum)} of {len(outcome.starts)} starts end at the "
            f"proven minimum{gap}"
        )
        yield from (f"  {line}" for line in _spreads(motor, outcome))
    if row["fpe"] is not None and row["aicc"] is not None:
        yield (
            f"  FPE {row['fpe']:.4g} (l/min)², AIC {row['aic']:.1f}, AICc {row['aicc']:.1f}, "
            f"BIC {row['bic']:.1f}: {row['n_training']} training samples"
        )


def _spreads(motor: Motor, outcome: Search) -> Iterator[str]:
    """Yield the ends of each parameter and coefficient over starts at the minimum."""
    if not outcome.at_minimum:
        return
    finals = np.array([start.final for start in outcome.at_minimum])
    thetas = coefficients_at(motor, finals)
    named = [
        (parameter.name, parameter.unit, of)
        for parameter, of in zip(free_parameters(motor), finals.T, strict=True)
    ]
    named += [
        (path.coefficient_name, path.coefficient_unit, of)
        for path, of in zip(motor.coefficient_paths, thetas.T, strict=True)
        if path is not None and path.is_free and len(path.parameters) > 1
    ]
    for name, unit, values in named:
        yield f"{name}: {values.min():.6g} to {values.max():.6g} {unit} over these starts"
