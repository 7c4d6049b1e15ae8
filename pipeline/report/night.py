"""Payload of one night for each motor, from that night's rows.

Samples are already thinned in `predictions`; nothing is computed here but sums and shares of what
the tables hold. Every step is done for all motors at once: a fleet's year has 36 500 nights.
Tables are sorted by their keys, so the rows of a motor, and of a series, lie together, in order.
"""

from __future__ import annotations

import datetime as dt
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import polars as pl

from leakage.estimation.sample_blocks import GUARD, TRAINING, VALIDATION
from pipeline.report.encoding import numbers, whole_numbers
from pipeline.report.tables import Read
from pipeline.schema import PRESSURE_EDGES_BAR, SPEED_EDGES_RPM, TEMPERATURE_EDGES_C

Payload = dict[str, Any]
ByMotor = dict[str, Any]
Row = tuple[Any, ...]

# Neither shown nor needed beside the rows that the page is of.
LEFT_OUT_OF_FITS = {
    "motor_id",
    "night",
    "run_id",
    "model_hash",
    "model_misfit_statistics",
    "singular_values",
}
MODE_COLUMNS = ("flushing_mode", "is_primary", "validation_fit_percent")
FILE_COLUMNS = ("path", "format", "status", "rows", "first_time", "last_time", "message")
RULE_COLUMNS = ("channel", "reason", "n_samples", "n_refused", "n_noted")
PARAMETER_FIGURES = ("value", "lower", "upper", "total_half_width", "feasible_min", "feasible_max")
PARAMETER_COLUMNS = ("parameter", "unit", *PARAMETER_FIGURES, "verdict", "reason", "placeholder")
BUDGET_COLUMNS = ("indicator", "source", "tolerance", "tolerance_unit", "effect", "unit")
TEST_KEY = ("part", "smoothed", "test", "input")
VERDICT_COLUMNS = (
    *TEST_KEY,
    "verdict",
    "reason",
    "n_lags",
    "n_outside",
    "n_expected_outside",
    "p_value",
    "largest_value",
    "largest_lag_s",
)
SAMPLE_COLUMNS = {
    "pressure": "pressure_difference_bar",
    "temperature": "oil_temperature_c",
    "speed": "speed_rpm",
    "measured": "measured_l_per_min",
    "predicted": "predicted_l_per_min",
}
PART_LETTERS = {TRAINING: "t", VALIDATION: "v", GUARD: "g"}
# Channel of the coverage, the unit in its columns, and the edges of its bins.
COVERED = (
    ("pressure", "bar", PRESSURE_EDGES_BAR),
    ("temperature", "c", TEMPERATURE_EDGES_C),
    ("speed", "rpm", SPEED_EDGES_RPM),
)


def night_payloads(night: dt.date, read: Mapping[str, Read]) -> Iterator[tuple[str, Payload]]:
    """A payload for every motor that has a primary row in `fits` of a night."""
    faults = [fault for part in read.values() for fault in part.faults]
    parts = {
        name: make(_in_epoch_ms(read[table].rows)) if table in read else {}
        for name, (table, make, _) in PARTS.items()
    }
    for motor_id in sorted(parts["fit"]):
        payload = {"night": night.isoformat(), "faults": faults}
        for name, (_, _, absent) in PARTS.items():
            payload[name] = parts[name].get(motor_id, absent)
        yield motor_id, payload


def _in_epoch_ms(rows: pl.DataFrame) -> pl.DataFrame:
    """Times as milliseconds since 1970, as scripts count them."""
    times = [name for name, kind in rows.schema.items() if isinstance(kind, pl.Datetime)]
    return rows.with_columns(pl.col(name).dt.epoch("ms") for name in times)


def _slices(rows: pl.DataFrame) -> Iterator[tuple[str, slice]]:
    """The rows of each motor; they lie together."""
    begin = 0
    for n, motor_id in rows["motor_id"].rle().struct.unnest().iter_rows():
        yield motor_id, slice(begin, begin + n)
        begin += n


def _grouped(rows: pl.DataFrame, columns: tuple[str, ...]) -> dict[str, list[Row]]:
    """The rows' values by motor."""
    values = rows.select(columns).rows()
    return {motor_id: values[own] for motor_id, own in _slices(rows)}


def _named(rows: pl.DataFrame, columns: tuple[str, ...]) -> ByMotor:
    """The rows as dicts without what is absent, by motor."""
    return {
        motor_id: [
            {name: value for name, value in zip(columns, row, strict=True) if value is not None}
            for row in group
        ]
        for motor_id, group in _grouped(rows, columns).items()
    }


def _fit(rows: pl.DataFrame) -> ByMotor:
    shown = tuple(name for name in rows.columns if name not in LEFT_OUT_OF_FITS)
    primary = rows.filter("is_primary")
    return {motor_id: found[0] for motor_id, found in _named(primary, shown).items()}


def _modes(rows: pl.DataFrame) -> ByMotor:
    """All modes of flushing that were fitted, where there is more than one."""
    several = rows.filter(pl.len().over("motor_id") > 1)
    return _named(several, MODE_COLUMNS)


def _files(rows: pl.DataFrame) -> ByMotor:
    # One that is of no night stands under another's.
    return _named(rows.filter(pl.col("night").is_not_null()), FILE_COLUMNS)


def _quality(rows: pl.DataFrame) -> ByMotor:
    """Rules that refused or noted anything, and each channel's total."""
    noted = pl.col("n_noted").fill_null(0) > 0
    told = (pl.col("n_refused") > 0) | noted | (pl.col("reason") == "any")
    return _grouped(rows.filter(told), RULE_COLUMNS)


def _parameters(rows: pl.DataFrame) -> ByMotor:
    """Parameters; of those that rest on a placeholder no figures."""
    made_up = _rests_on_a_placeholder()
    shown = rows.with_columns(
        made_up.alias("placeholder"),
        *(pl.when(~made_up).then(pl.col(name)).alias(name) for name in PARAMETER_FIGURES),
    )
    return _named(shown, PARAMETER_COLUMNS)


def _rests_on_a_placeholder() -> pl.Expr:
    """Figures made from the geometry, unless it is known to be none; older rows do not know."""
    of_geometry = pl.col("parameter").str.contains("^(h|e|film_thickness_ratio)_")
    return of_geometry & pl.col("geometry_is_placeholder").fill_null(value=True)


def _budget(rows: pl.DataFrame) -> ByMotor:
    """Sources by indicator, the largest effect first."""
    by = ["motor_id", "indicator", pl.col("effect").abs(), "source"]
    descending = [False, False, True, False]
    ranked = rows.sort(by, descending=descending, nulls_last=True)
    budgets: dict[str, dict[str, list[Any]]] = {}
    for motor_id, group in _grouped(ranked, BUDGET_COLUMNS).items():
        budgets[motor_id] = defaultdict(list)
        for indicator, *values in group:
            budgets[motor_id][indicator].append(values)
    return budgets


def _samples(rows: pl.DataFrame) -> ByMotor:
    """The thinned samples: inputs, measured and predicted flow, and which part each is of."""
    time = rows["time"].to_numpy()
    letters = _letters(rows["part"])
    columns = {name: rows[column].to_numpy() for name, column in SAMPLE_COLUMNS.items()}
    return {
        motor_id: {
            "start": int(time[own.start]),
            "after_ms": whole_numbers(time[own] - time[own.start]),
            "part": letters[own],
            **{name: numbers(values[own]) for name, values in columns.items()},
        }
        for motor_id, own in _slices(rows)
    }


def _letters(parts: pl.Series) -> str:
    """A letter for the part of each row, in one text."""
    letters = parts.replace_strict(PART_LETTERS, default=PART_LETTERS[GUARD])
    return "".join(letters.to_list())


def _coverage(rows: pl.DataFrame) -> ByMotor:
    """Samples by bin of each input, for the training and the validation part, and blocks' means."""
    letters = _letters(rows["part"])
    part = rows["part"].to_numpy()
    n = rows["n"].to_numpy()
    counts = {
        channel: rows[f"{channel}_histogram"].explode().to_numpy().reshape(len(n), len(edges) - 1)
        for channel, _, edges in COVERED
    }
    values = {
        channel: [
            rows[f"{kind}_{channel}_{unit}"].to_numpy() for kind in ("mean", "minimum", "maximum")
        ]
        for channel, unit, _ in COVERED
    }
    found = {}
    for motor_id, own in _slices(rows):
        chosen = {name: part[own] == name for name in (TRAINING, VALIDATION)}
        sizes = {name: int(n[own][mask].sum()) for name, mask in chosen.items()}
        coverage: Payload = {"n": sizes, "block_parts": letters[own]}
        for channel, _, edges in COVERED:
            mean, smallest, largest = (figures[own] for figures in values[channel])
            coverage[channel] = {
                "edges": edges,
                "minimum": float(smallest.min()),
                "maximum": float(largest.max()),
                "blocks": numbers(mean),
                **{
                    name: counts[channel][own][mask].sum(axis=0).tolist()
                    for name, mask in chosen.items()
                },
            }
        found[motor_id] = coverage
    return found


def _residuals(rows: pl.DataFrame) -> ByMotor:
    """Each residual test as one series over its lags."""
    series: dict[str, list[Payload]] = defaultdict(list)
    lags, seconds = rows["lag"].to_list(), rows["lag_s"].to_list()
    value, bound = (rows[name].cast(pl.Float64).to_numpy() for name in ("value", "bound"))
    begin = 0
    keys = rows.select(pl.struct("motor_id", *TEST_KEY).rle().struct.unnest())
    for n, key in keys.iter_rows():
        own = slice(begin, begin + n)
        begin += n
        motor_id = key.pop("motor_id")
        series[motor_id].append(
            key
            | {
                "lag": lags[own],
                "longest_s": seconds[own][-1],
                "value": numbers(value[own]),
                "bound": numbers(bound[own]),
            }
        )
    return series


# Part of a payload: the table it is made from, how, and what stands for it where it is absent.
PARTS: Mapping[str, tuple[str, Callable[[pl.DataFrame], ByMotor], Any]] = {
    "fit": ("fits", _fit, None),
    "modes": ("fits", _modes, []),
    "files": ("input_files", _files, []),
    "quality": ("quality", _quality, []),
    "parameters": ("parameters", _parameters, []),
    "budget": ("sensitivities", _budget, {}),
    "samples": ("predictions", _samples, None),
    "coverage": ("block_statistics", _coverage, None),
    "residuals": ("residual_tests", _residuals, []),
    "verdicts": ("residual_verdicts", partial(_named, columns=VERDICT_COLUMNS), []),
}
