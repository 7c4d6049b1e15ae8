"""Frozen baseline of a motor's looks: model, errors of its blocks, limit, and conditions seen.

It is made from the nights that the nightly run has published, kept beside the looks, and made anew
only when those nights or the model have changed.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from leakage.course.baseline import Baseline
from leakage.course.monitoring import monitor
from leakage.course.step_detection import (
    BlockErrors,
    StepWatch,
    advance,
    block_errors,
    limit_of_maxima,
)
from leakage.course.temperature_correction import TemperatureCorrection
from pipeline.arrays import SECOND_US, Array
from pipeline.config import MotorSpec
from pipeline.config.hashes import hash_of, model_hash
from pipeline.config.nights import night as night_labelled
from pipeline.logs.ledger import as_published
from pipeline.look.blocks import Blocks, block_us, is_warm, stored_blocks
from pipeline.night.stored_blocks import BLOCK_COLUMNS, StoredBlocks
from pipeline.schema import BLOCK_STATISTICS
from pipeline.store.sealed import put_sealed, read_if_whole, unseal
from pipeline.store.tables import read_rows
from pipeline.trends.baselines.eras import eras_of
from pipeline.trends.baselines.leakages import indicators_of
from pipeline.trends.figures.indicators import DEVIATION, Indicator
from pipeline.trends.figures.temperature import NIGHTS
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.nights.history import History
from pipeline.trends.nights.reading import read_nights
from pipeline.trends.nights.segments import segments
from pipeline.trends.nights.tonight import Tonight
from pipeline.trends.nights.trend_record import Record, resets_of
from pipeline.trends.states.watch import monitor_settings

# Raise it when the same nights give another baseline.
VERSION = 1
# Blocks beyond these shares of the baseline's are outside its conditions.
SEEN_PERCENTILES = (0.1, 99.9)
# Blocks that tell the errors of others.
LEAST_BLOCKS = 100
# Nights of whose deviations the median is the level of now.
NIGHTS_OF_LEVEL = 5


@dataclass(frozen=True, slots=True)
class LookBaseline:
    """Frozen baseline."""

    key: str  # hash of all that it is made from
    first_night: dt.date
    last_night: dt.date
    model_hash: str  # of its statistics; new blocks of another are not compared with it
    theta: tuple[float, ...]  # coefficients; the last is the flushing
    # per_kelvin, reference_c: change of the loss factors with temperature [1/K], 0 where none is
    # certain, around [°C].
    per_kelvin: float
    reference_c: float
    errors: BlockErrors
    limit: float
    # lowest, highest: temperature [°C], pressure difference [bar] and speed [rpm] that it has seen.
    lowest: tuple[float, ...]
    highest: tuple[float, ...]
    # Deviation of the latest nights from it [-]: what they have told is no step of today.
    level: float = 0.0
    # Known flow of its model over the stated one where the rollers' scale is free, and then it
    # changes with temperature as all flows do; None where it is fixed.
    known_scale: float | None = None

    def flows(self, blocks: Blocks) -> tuple[Array, Array]:
        """Measured and expected flow of some blocks without the flushing [l/min], shape (b,)."""
        theta = np.array(self.theta)
        ones, known, measured = (blocks.means[:, column] for column in (-3, -2, -1))
        factor = 1.0 + self.per_kelvin * (blocks.conditions[:, 0] - self.reference_c)
        paths = blocks.means[:, : len(theta) - 1] @ theta[:-1]
        if self.known_scale is None:
            expected = known + factor * paths
        else:
            expected = factor * (self.known_scale * known + paths)
        return measured - theta[-1] * ones, (1.0 + self.level) * expected

    def has_seen(self, blocks: Blocks) -> NDArray[np.bool_]:
        """Blocks within its conditions, shape (b,)."""
        seen: NDArray[np.bool_] = np.all(
            (blocks.conditions >= self.lowest) & (blocks.conditions <= self.highest), axis=1
        )
        return seen


def baseline_of(
    output: Path, spec: MotorSpec, record: Record | None, decisions: Sequence[Decision]
) -> LookBaseline | str:
    """The motor's baseline, or why there is none.

    Raises StoreError if a published table is damaged, or the baseline cannot be kept.
    """
    if record is None:
        return "the nightly run has not published a night yet"
    path = output / "look" / spec.motor_id / "baseline.json"
    kept = read_if_whole(path, unseal) or {}
    stamp = hash_of(
        {
            "version": VERSION,
            "trends": asdict(record),
            "resets": resets_of(decisions),
            "look": spec.settings.look.model_dump(),
        }
    )
    if kept.get("stamp") != stamp:
        made = _made(output, spec, record, decisions, _decoded(kept))
        kept = {"why": made} if isinstance(made, str) else asdict(made)
        kept["stamp"] = stamp
        put_sealed(path, kept)
    found = _decoded(kept)
    if found is None:
        return str(kept.get("why") or "its baseline cannot be read")
    return _outdated(spec, found, decisions, record) or found


def _decoded(document: Mapping[str, Any]) -> LookBaseline | None:
    try:
        return TypeAdapter(LookBaseline).validate_python(document)
    except ValidationError:
        return None


def _outdated(
    spec: MotorSpec, found: LookBaseline, decisions: Sequence[Decision], record: Record
) -> str:
    """Why a baseline no longer holds for the night after the last one; empty where it does."""
    tonight = record.last_night + dt.timedelta(days=1)
    if found.model_hash != model_hash(spec, spec.motor(tonight, spec.file.flushing.mode), tonight):
        return "other settings than those of its baseline: the nightly run makes its nights anew"
    begins = [one.date for one in spec.file.events]
    # One of the drain flow alone keeps its model: the level of the latest nights has taken it up.
    begins += [one.night for one in decisions if one.kind == "baseline_reset" and not one.indicator]
    if any(found.last_night < date <= tonight for date in begins):
        return "a new baseline begins"
    return ""


def _made(
    output: Path,
    spec: MotorSpec,
    record: Record,
    decisions: Sequence[Decision],
    kept: LookBaseline | None,
) -> LookBaseline | str:
    motor_id = spec.motor_id
    fitted = as_published(output, spec)
    nights = read_nights(output, [fitted], {motor_id: decisions}, {}, Tonight(record.last_night))[
        motor_id
    ]
    if nights.history is None:
        return "the nightly run has not published a night yet"
    history = nights.history
    eras = eras_of(history)
    era = eras[-1]
    places = era.segment.first + np.flatnonzero(history.fitted[era.segment.first :])
    flow = indicators_of(history, eras)
    baseline = _watched_baseline(history, flow)
    if era.model is None or baseline is None or len(places) < NIGHTS[0]:
        return (
            f"{len(places)} of {NIGHTS[0]} good nights for a baseline: whether the leakage changes "
            "with temperature is not known"
        )
    # Those of the nightly alarms: wear must not become its own baseline.
    places = places[: baseline.n]
    labels = [history.nights[place] for place in places]
    correction = era.temperature
    warming = correction is not None and correction.is_certain
    key = hash_of(
        {
            "version": VERSION,
            "nights": labels,
            "factors": history.records["factor"][places].tobytes().hex(),
            "theta": era.model.tolist(),
            "temperature": asdict(correction) if warming and correction is not None else None,
            "look": spec.settings.look.model_dump(),
        }
    )
    latest = flow[DEVIATION].value[places[-1] + 1 :]
    latest = latest[np.isfinite(latest)][-NIGHTS_OF_LEVEL:]
    level = float(np.median(latest)) if len(latest) else 0.0
    if kept is not None and kept.key == key:
        return replace(kept, level=level)
    blocks = _blocks(output, spec, labels, history.layout.stated_columns)
    if blocks is None:
        return "the blocks of its baseline are not published"
    theta, known_scale = era.model, None
    if history.layout.standard is not None:
        place, coefficient = history.layout.standard
        theta, known_scale = np.delete(theta, place), float(theta[place] / coefficient)
    certain = correction if warming else None
    found = calibrated(spec, blocks, key, labels, theta, certain, known_scale)
    return found if isinstance(found, str) else replace(found, level=level)


def _blocks(
    output: Path, spec: MotorSpec, labels: Sequence[dt.date], columns: Sequence[str]
) -> Blocks | None:
    """Blocks of some nights; None where there are none, or some are of another model."""
    rows = read_rows(output, BLOCK_STATISTICS, [spec.motor_id], BLOCK_COLUMNS, nights=labels)
    parts = []
    for night in rows.sort("night", "block_start").partition_by("night", maintain_order=True):
        stored = StoredBlocks.of(spec, night, columns)
        if stored is None:
            return None
        parts.append(stored_blocks(spec, stored))
    return Blocks.joined(parts) if parts else None


def _watched_baseline(history: History, indicators: Mapping[str, Indicator]) -> Baseline | None:
    """Baseline of the drain flow that serves the alarms of the last night."""
    segment = segments(history, DEVIATION)[-1]
    settings = monitor_settings(history.spec, indicators[DEVIATION], len(indicators))
    series = indicators[DEVIATION].watched[segment.here]
    followed = monitor(history.numbers[segment.here], series, settings)
    return followed.baselines[-1] if followed.baselines else None


def calibrated(
    spec: MotorSpec,
    blocks: Blocks,
    key: str,
    nights: Sequence[dt.date],
    theta: Array,
    correction: TemperatureCorrection | None,
    known_scale: float | None = None,
) -> LookBaseline | str:
    """Baseline from the blocks of its nights; the limit from the largest statistic of each."""
    low, high = np.percentile(blocks.conditions, SEEN_PERCENTILES, axis=0)
    motor = spec.motor(nights[-1], spec.file.flushing.mode)
    found = LookBaseline(
        key,
        nights[0],
        nights[-1],
        model_hash(spec, motor, nights[-1]),
        tuple(theta.tolist()),
        0.0 if correction is None else correction.per_kelvin,
        0.0 if correction is None else correction.reference_c,
        BlockErrors(0.0, 0.0, 1.0),
        0.0,
        tuple(low.tolist()),
        tuple(high.tolist()),
        known_scale=known_scale,
    )
    length = block_us(spec)
    warm_us = spec.settings.look.warm_up_minutes * 60 * SECOND_US
    blocks = blocks.only(is_warm(blocks.start_us, length, warm_us) & found.has_seen(blocks))
    measured, expected = found.flows(blocks)
    good = expected > 0.0
    if np.count_nonzero(good) < LEAST_BLOCKS:
        return f"{np.count_nonzero(good)} of {LEAST_BLOCKS} blocks of a baseline"
    number, error = blocks.start_us[good] // length, (measured - expected)[good]
    errors = block_errors(number, expected[good], error)
    maxima = _maxima(spec, nights, blocks.start_us[good], errors, expected[good], error)
    return replace(found, errors=errors, limit=limit_of_maxima(maxima))


def _maxima(
    spec: MotorSpec,
    nights: Sequence[dt.date],
    start_us: NDArray[np.int64],
    errors: BlockErrors,
    expected: Array,
    error: Array,
) -> Array:
    """Largest statistic of each night, each watched on its own, shape (m,)."""
    length = block_us(spec)
    begins = np.array([night_labelled(label, spec.settings.nights).start_us for label in nights])
    night = np.searchsorted(begins, start_us, side="right") - 1
    place = (start_us - begins[night]) // length
    flows = np.full((2, len(nights), int(place.max()) + 1), np.nan)
    flows[:, night, place] = expected, error
    state = StepWatch.begin(errors, (len(nights),))
    largest = np.zeros(len(nights))
    for at in np.unique(place).tolist():
        state, found = advance(
            state, errors, np.full(len(nights), at), flows[0, :, at], flows[1, :, at]
        )
        largest = np.maximum(largest, found.statistic)
    return largest
