"""Records of nights from the rows of `fits`, `parameters`, `operation` and `block_statistics`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate
from typing import Any, TypeAlias

import numpy as np
import polars as pl
from numpy.typing import NDArray

from leakage.course.night_filter import night_information
from leakage.estimation.block_statistics import merge
from leakage.estimation.identifiability import OUTSIDE as OUTSIDE_THE_SAMPLES
from leakage.estimation.identifiability import TOLD
from leakage.estimation.model_verdict import MISFIT_NUMBERS
from pipeline.config import MotorSpec
from pipeline.night.rows import upper_triangle
from pipeline.schema.fits import OK
from pipeline.trends.nights.history import History
from pipeline.trends.nights.records import (
    BINS,
    HISTOGRAMS,
    OPERATED,
    SINGLE,
    Layout,
    NightWords,
    Records,
    blank_records,
    symmetric_matrix,
    triangle,
    triangle_places,
    whole_matrix,
)

Array = NDArray[np.float64]

# A night alone tells a leakage where its statistical half-width is no wider; else the filter does.
WIDEST_ALONE = 0.02
REFERENCE = "reference_leakage_l_per_min", "reference_leakage_lower", "reference_leakage_upper"
REFERENCE_CONDITIONS = "reference_pressure_bar", "reference_temperature_c", "reference_speed_rpm"
OWN = "own_pressure_bar", "own_temperature_c", "own_speed_rpm"
KEY = ("motor_id", "night")
FITTED = ("is_primary", "status", "reason", "flushing_mode", "interval_status", "model_hash")
COVARIANCE, ROOT = "coefficient_covariance", "coefficient_covariance_root"
STATISTICS = ("columns", "coefficients", ROOT, COVARIANCE, "coefficient_response")
VERDICTS = ("reference_verdict", "reference_reason", "model_misfit_statistics")
AT_REFERENCE = (*REFERENCE, *REFERENCE_CONDITIONS, *OWN, *SINGLE.values())
FIT_COLUMNS = (*KEY, *FITTED, *STATISTICS, "night_factor", *VERDICTS, *AT_REFERENCE)
FIGURE = ("parameter", "value", "lower", "upper", "verdict", "reason")
PARAMETER_COLUMNS = (*KEY, "flushing_mode", *FIGURE)
OPERATION_COLUMNS = (*KEY, "kept_hours", *OPERATED, *HISTOGRAMS)
# Value, ends, verdict and reason of a coefficient, by motor, night, mode and name.
Figures: TypeAlias = Mapping[tuple[Any, ...], tuple[Any, ...]]
NOTHING_SAID = (None,) * 5


def rows_by_night(
    specs: Sequence[MotorSpec],
    layouts: Mapping[str, Layout],
    fits: pl.DataFrame,
    parameters: pl.DataFrame,
    operation: pl.DataFrame,
) -> dict[str, History]:
    """Histories of some motors from rows of `fits`, `parameters` and `operation`, by motor.

    They have no nights without a row. The layouts are by motor.
    """
    fits = fits.filter("is_primary").sort(KEY)
    rows = Columns(fits.join(operation, on=KEY, how="left", maintain_order="left"))
    told = parameters.select(PARAMETER_COLUMNS).drop_nulls("flushing_mode")
    figures = {row[:4]: row[4:] for row in told.iter_rows()}
    nights = Counter(rows.values("motor_id"))
    ends = dict(zip(nights, accumulate(nights.values()), strict=True))
    found = {}
    for spec in specs:
        if (n := nights[spec.motor_id]) == 0:
            continue
        layout, end = layouts[spec.motor_id], ends[spec.motor_id]
        records, words = records_of(spec, layout, rows.between(end - n, end), figures)
        found[spec.motor_id] = History(spec, layout, records, dict(enumerate(words)))
    return found


@dataclass(frozen=True, slots=True)
class Columns:
    """Columns of rows as arrays, each made once for the rows of all motors; some of the rows.

    An expression of Polars takes longer than all else for the one row that a motor has of tonight.
    """

    rows: pl.DataFrame
    here: slice = field(default_factory=lambda: slice(None))
    # By kind and name of a column.
    _made: dict[tuple[str, str], Any] = field(default_factory=dict)

    def between(self, first: int, end: int) -> Columns:
        """Those of some rows."""
        return replace(self, here=slice(first, end))

    def numbers(self, name: str) -> Array:
        """A column, nan where it is null."""
        if (key := ("numbers", name)) not in self._made:
            self._made[key] = np.asarray(self.rows[name].to_numpy(), dtype=np.float64)
        numbers: Array = self._made[key][self.here]
        return numbers

    def values(self, name: str) -> list[Any]:
        """A column as Python has it."""
        if (key := ("values", name)) not in self._made:
            self._made[key] = self.rows[name].to_list()
        values: list[Any] = self._made[key][self.here]
        return values

    def texts(self, name: str) -> list[str]:
        """A column, empty where it is null."""
        return [text or "" for text in self.values(name)]

    def vectors(self, name: str, size: int) -> Array:
        """A column of lists as an array, nan where a list is absent or of another length."""
        if (key := ("vectors", name)) not in self._made:
            lengths = self.rows[name].list.len().fill_null(0)
            numbers = self.rows[name].filter(lengths > 0).explode().to_numpy()
            sizes = lengths.to_numpy().astype(np.intp)
            self._made[key] = np.cumsum(sizes) - sizes, sizes, numbers
        begins, sizes, numbers = self._made[key]
        whole = sizes[self.here] == size
        result = np.full((len(whole), size), np.nan)
        result[whole] = numbers[begins[self.here][whole, None] + np.arange(size)]
        return result


def records_of(
    spec: MotorSpec, layout: Layout, rows: Columns, figures: Figures
) -> tuple[Records, list[NightWords]]:
    """Records of a motor's nights, from their rows and the published figures of coefficients."""
    records = blank_records(layout, rows.values("night"))
    records["fitted"] = [
        status == OK and interval.startswith(OK)
        for status, interval in zip(
            rows.values("status"), rows.texts("interval_status"), strict=True
        )
    ]
    records["mode"], records["model"] = rows.texts("flushing_mode"), rows.texts("model_hash")
    for name in ("kept_hours", *OPERATED):
        records[name] = rows.numbers(name)
    for name, column in SINGLE.items():
        records[name] = rows.numbers(column)
    for name, bins in zip(HISTOGRAMS, BINS, strict=True):
        records[name] = np.nan_to_num(rows.vectors(name, bins))
    records["own"] = np.column_stack([rows.numbers(column) for column in OWN])
    records["misfit"] = rows.vectors("model_misfit_statistics", MISFIT_NUMBERS)
    expected, theta = list(layout.columns), len(layout.free)
    same = np.array([columns == expected for columns in rows.values("columns")], dtype=np.bool_)
    for name, column, size in (
        ("theta", "coefficients", theta),
        ("response", "coefficient_response", theta),
        ("factor", "night_factor", triangle(len(expected))),
    ):
        records[name] = np.where(same[:, None], rows.vectors(column, size), np.nan)
    records["root"] = np.where(same[:, None], _roots(rows, theta), np.nan)
    # Nights of before have none.
    records["response"] = np.nan_to_num(records["response"])
    _fill_noise(layout, records)
    statuses = _status_words(rows)
    reference = _fill_reference(spec, records, rows)
    coefficients = _fill_figures(layout, records, rows, figures)
    words = [
        NightWords(status, status or why, tuple(status or one for one in each))
        for status, why, each in zip(statuses, reference, coefficients, strict=True)
    ]
    return records, words


def _roots(rows: Columns, size: int) -> Array:
    """U of each night; of nights of before that nothing is left to refit from, of its U'U."""
    root, covariance = (rows.vectors(name, triangle(size)) for name in (ROOT, COVARIANCE))
    lacks = np.isnan(root).any(axis=1) & np.isfinite(covariance).all(axis=1)
    if lacks.any():
        whole = symmetric_matrix(covariance[lacks], size)
        errors = np.sqrt(np.einsum("nii->ni", whole))
        unit = np.where(errors > 0.0, errors, 1.0)
        values, vectors = np.linalg.eigh(whole / (unit[:, :, None] * unit[:, None]))
        turned = np.sqrt(np.maximum(values, 0.0))[:, :, None] * vectors.swapaxes(1, 2)
        upper = np.asarray(np.linalg.qr(turned * errors[:, None], mode="r"))
        first, second = triangle_places(size)
        root[lacks] = upper[:, first, second]
    return root


def _fill_noise(layout: Layout, records: Records) -> None:
    """Errors of fitted nights from their covariance: V = U'U = S⁻¹MS⁻¹, λ_j = M_jj / S_jj."""
    size, free = len(layout.free), np.array(layout.free)
    columns = whole_matrix(records["factor"], size + 2)[:, :, :-2]
    root = whole_matrix(records["root"], size)
    # Through the columns, not their Gram: V is huge where they look alike, and US is not.
    scores = (root @ columns.swapaxes(1, 2)) @ columns
    # A coefficient at its bound has no variance, and its night tells no error.
    known = records["fitted"] & (np.abs(root).max(axis=1)[:, free] > 0.0).all(axis=1)
    squares = (np.sum(one**2, axis=1) for one in (scores, columns))
    records["noise"][known] = np.divide(*squares)[known]
    records["freedom"][known] = 1.0


def _status_words(rows: Columns) -> list[str]:
    """Reason why a night has no usable fit, by night; empty where it has one."""
    words = []
    columns = (rows.values(name) for name in ("status", "reason", "interval_status"))
    for status, reason, interval in zip(*columns, strict=True):
        if status == OK:
            words.append("" if interval == OK else interval or "no intervals")
        else:
            words.append(": ".join(one for one in (status.replace("_", " "), reason) if one))
    return words


def _fill_reference(spec: MotorSpec, records: Records, rows: Columns) -> list[str]:
    """Leakage at the reference conditions, where it can be trusted; otherwise why not."""
    asked = spec.settings.reference
    now = (asked.pressure_bar, asked.temperature_c, asked.speed_rpm)
    before = np.column_stack([rows.numbers(name) for name in REFERENCE_CONDITIONS])
    elsewhere = np.isfinite(before).all(axis=1) & (before != now).any(axis=1)
    verdicts, reasons = rows.texts("reference_verdict"), rows.texts("reference_reason")
    records["outside"] = [verdict in OUTSIDE_THE_SAMPLES for verdict in verdicts]
    records["reference"] = np.column_stack([rows.numbers(name) for name in REFERENCE])
    value, low, high = records["reference"].T
    words = []
    for verdict, reason, other, half in zip(
        verdicts, reasons, elsewhere.tolist(), ((high - low) / (2 * value)).tolist(), strict=True
    ):
        if other:
            words.append("fitted for other reference conditions, and its statistics are not there")
        elif half > WIDEST_ALONE:
            words.append(too_wide(half))
        else:
            words.append(_gate(verdict, reason))
    trusted = records["fitted"] & np.array([not one for one in words], dtype=np.bool_)
    records["reference"][~trusted] = np.nan
    return words


def too_wide(half: float) -> str:
    """Words for a leakage that a night alone does not tell well enough, by its relative ±."""
    return f"known to ± {100 * half:.1f} % only; {100 * WIDEST_ALONE:.0f} % are needed"


def _fill_figures(
    layout: Layout, records: Records, rows: Columns, figures: Figures
) -> list[tuple[str, ...]]:
    """Each coefficient where it is identified; otherwise why not."""
    columns = []
    keys = list(zip(*map(rows.values, (*KEY, "flushing_mode")), strict=True))
    for place, name in enumerate(layout.coefficients):
        found = [figures.get((*key, name), NOTHING_SAID) for key in keys]
        values = np.array([one[:3] for one in found], dtype=np.float64)
        records["figures"][:, place] = values.reshape(-1, 3)
        verdicts, reasons = ([one[end] or "" for one in found] for end in (3, 4))
        # Nothing was estimated where a coefficient is held fixed.
        words = [
            _gate("" if verdict == "fixed" else verdict, reason)
            for verdict, reason in zip(verdicts, reasons, strict=True)
        ]
        trusted = records["fitted"] & np.array([not one for one in words], dtype=np.bool_)
        records["figures"][~trusted, place] = np.nan
        columns.append(words)
    return list(zip(*columns, strict=True)) if columns else [()] * len(keys)


def _gate(verdict: str, reason: str) -> str:
    """Reason why a figure does not count, from its verdict; empty if it counts."""
    if verdict in TOLD:
        return ""
    return reason or verdict.replace("_", " ") or "no figure"


def add_blocks(spec: MotorSpec, layout: Layout, records: Records, blocks: pl.DataFrame) -> None:
    """Put what the blocks of nights without a fit tell into their records."""
    free = np.array(layout.free)
    nights = records["night"].tolist()
    poor = {nights[place]: place for place in np.flatnonzero(~records["fitted"]).tolist()}
    for (label,), rows in blocks.partition_by("night", as_dict=True).items():
        if label not in poor:
            continue
        record = records[poor[label]]
        hashes = set(rows["model_hash"].to_list())
        stored = layout.blocks(spec, rows)
        if len(hashes) != 1 or stored is None:
            continue
        record["model"], record["own"] = hashes.pop(), stored.means()
        record["factor"] = upper_triangle(merge(stored.factors))
        if stored.viscosity_ratio is not None:
            record["viscosity"] = stored.viscosity_ratio
        told = night_information(stored.factors, np.array(layout.configured), free)
        record["noise"][free], record["freedom"][free] = told.noise, told.freedom
