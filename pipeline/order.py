"""Cells of a channel in the order of time, and which of them are samples."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pipeline.arrays import Mask
from pipeline.channel_rules import ChannelRules
from pipeline.clocks import backward_time, duplicate_time, stray_time, written_late
from pipeline.ingest import RawChannel
from pipeline.masks import missing_sample


@dataclass(frozen=True, slots=True)
class Disorder:
    """Samples, blank cells aside, that were out of order."""

    n_put_back: int
    n_backward: int
    n_duplicate: int


def in_order(raw: RawChannel, rules: ChannelRules) -> tuple[RawChannel, Disorder]:
    """Cells in strict order of their corrected time, and what it took."""
    if bool((raw.time_us[1:] > raw.time_us[:-1]).all()):
        return _corrected(raw, rules), Disorder(0, 0, 0)
    backward = backward_time(raw.time_us)
    late = np.zeros(len(backward), dtype=np.bool_)
    if rules.puts_in_order:
        late = written_late(raw.time_us, backward)
    backward = (backward & ~late) | stray_time(raw.time_us, late)
    rows = np.flatnonzero(~backward)
    if late.any():
        rows = rows[np.argsort(raw.time_us[rows], kind="stable")]
    repeated = duplicate_time(raw.time_us[rows], np.zeros(len(rows), dtype=np.bool_))
    disorder = Disorder(
        int((late & ~raw.missing).sum()),
        int((backward & ~raw.missing).sum()),
        int((repeated & ~raw.missing[rows]).sum()),
    )
    return _corrected(raw.rows(rows[~repeated]), rules), disorder


def _corrected(raw: RawChannel, rules: ChannelRules) -> RawChannel:
    """Samples at the times at which they hold."""
    if not rules.sampling.shift_us:
        return raw
    return replace(raw, time_us=raw.time_us + rules.sampling.shift_us)


def samples_of(cells: RawChannel, rules: ChannelRules, period_us: float | None) -> RawChannel:
    """Cells in order without the blank ones that are no sample."""
    if rules.sampling.on_change:
        return cells.rows(_says_something(cells, rules))
    if not cells.missing.any():
        return cells
    missing = missing_sample(cells.time_us, cells.missing, period_us)
    return cells.rows(~cells.missing | missing)


def _says_something(cells: RawChannel, rules: ChannelRules) -> Mask:
    """Cells of an on-change channel that hold a value, or say that there is none."""
    if rules.has_rows_of_its_own:
        return np.ones(len(cells.time_us), dtype=np.bool_)
    says: Mask = ~cells.missing
    return says if cells.bad_quality is None else says | cells.bad_quality


def carried_over(early: RawChannel, rules: ChannelRules, earliest_us: float) -> RawChannel:
    """The last sample of an on-change channel before the night, if it may hold into it; or none."""
    says = _says_something(early, rules) & (early.time_us >= earliest_us)
    rows = np.flatnonzero(says) if rules.sampling.on_change else np.empty(0, np.intp)
    # Of two at one time the first one counts, as within the night.
    last = rows[[np.argmax(early.time_us[rows])]] if len(rows) else rows
    return _corrected(early.rows(last), rules)
