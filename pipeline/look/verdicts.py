"""Verdicts of the nightly run on rises that looks have told."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.config import MotorSpec
from pipeline.config.nights import night as night_labelled
from pipeline.config.nights import night_of
from pipeline.look.baseline import LookBaseline
from pipeline.look.blocks import stored_blocks
from pipeline.look.motor import SHARE_OF_END, Change, scored
from pipeline.look.state import LookState, Rise
from pipeline.night.stored_blocks import BLOCK_COLUMNS, StoredBlocks
from pipeline.schema import BLOCK_STATISTICS
from pipeline.store.tables import read_rows
from pipeline.trends.rows.motor_states import CLEAR, LOOK_NOW

# Blocks of a night that give a verdict, and nights that are waited for them.
LEAST_BLOCKS, MOST_NIGHTS = 5, 7


def verdicts(
    output: Path,
    spec: MotorSpec,
    baseline: LookBaseline,
    state: LookState,
    last_night: dt.date,
) -> tuple[LookState, list[Change]]:
    """Let published nights confirm or withdraw what was told.

    Raises StoreError if a published table is damaged.
    """
    changes = []
    for rise in state.waiting:
        first = night_of(rise.told_us, spec.settings.nights)
        labels = [first + dt.timedelta(days=day) for day in range(MOST_NIGHTS)]
        for label in (one for one in labels if one <= last_night):
            found = _change_in(output, spec, baseline, rise, label)
            if found is not None:
                state, change = _judged(spec, state, rise, label, found)
                changes.append(change)
                break
        else:
            if labels[-1] <= last_night:
                state = scored(state, "", rise)
    return state, changes


def _change_in(
    output: Path, spec: MotorSpec, baseline: LookBaseline, rise: Rise, label: dt.date
) -> float | None:
    """Relative change of the drain flow in a night since a rise began; None without blocks."""
    rows = read_rows(output, BLOCK_STATISTICS, [spec.motor_id], BLOCK_COLUMNS, nights=[label])
    columns = spec.motor(label, spec.file.flushing.mode).columns
    stored = StoredBlocks.of(spec, rows.sort("block_start"), columns)
    if stored is None or not rows.height:
        return None
    blocks = stored_blocks(spec, stored)
    blocks = blocks.only(blocks.start_us >= rise.began_us)
    measured, expected = baseline.flows(blocks)
    if len(expected) < LEAST_BLOCKS or np.sum(expected) <= 0.0:
        return None
    # Against the level of before: that of the nights may have risen since.
    ratio = float(np.sum(measured) / np.sum(expected))
    return ratio * (1.0 + baseline.level) / (1.0 + rise.level) - 1.0


def _judged(
    spec: MotorSpec, state: LookState, rise: Rise, label: dt.date, found: float
) -> tuple[LookState, Change]:
    is_so = found >= SHARE_OF_END * rise.change
    verdict = "confirmed" if is_so else "withdrawn"
    end_us = night_labelled(label, spec.settings.nights).end_us
    words = (
        f"{verdict} by the night of {label}: drain flow {100 * found:+.0f} % since then, told was "
        f"{100 * rise.change:+.0f} %"
    )
    before = state.state
    after = CLEAR if not is_so and before == LOOK_NOW and state.rise == rise else before
    state = scored(state, verdict, rise)
    if after != before:
        state = replace(state, state=after, since_us=end_us, reason=words, rise=None)
    return state, Change(end_us, before, after, words, rise, verdict, label)
