"""Verdicts of the published nights on rises that looks have told."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from pathlib import Path

import polars as pl

from pipeline.config import MotorSpec
from pipeline.config.nights import night as night_labelled
from pipeline.config.nights import night_of
from pipeline.look.before import NightsBefore
from pipeline.look.motor import SHARE_OF_END, Change, Looked
from pipeline.look.state import LookState, Rise
from pipeline.schema import WATCH
from pipeline.store.tables import read_rows
from pipeline.trends.rows.motor_states import CLEAR, LOOK_NOW

# Nights that are waited for one that says something.
MOST_NIGHTS = 7


def verdicts(output: Path, spec: MotorSpec, nights: NightsBefore, state: LookState) -> Looked:
    """Let published nights confirm or withdraw what was told.

    Raises StoreError if a published table is damaged.
    """
    changes = []
    for rise in state.waiting:
        first = night_of(rise.told_us, spec.settings.nights)
        found = _found(output, spec, nights, rise, first)
        if found is not None:
            state, change = _judged(spec, state, rise, *found)
            changes.append(change)
        elif first + dt.timedelta(days=MOST_NIGHTS) <= nights.last_night:
            state = _scored(state, rise)
    return state, changes


def _found(
    output: Path, spec: MotorSpec, nights: NightsBefore, rise: Rise, first: dt.date
) -> tuple[dt.date, float] | None:
    """A night that shows whether a rise was one, and how much; its own where it goes on in it."""
    if first == nights.last_night:
        flow = nights.flow_since(rise.began_us)
        return None if flow is None else (first, flow / (1.0 + rise.level) - 1.0)
    labels = [first + dt.timedelta(days=day) for day in range(1, MOST_NIGHTS + 1)]
    labels = [one for one in labels if one <= nights.last_night]
    if not labels:
        return None
    rows = read_rows(output, WATCH, [spec.motor_id], nights=labels)
    told = rows.filter(pl.col("night").is_in(labels), pl.col("n_blocks") > 0)
    for label, change in told.sort("night").select("night", "tonight_change").iter_rows():
        if change is not None:
            return label, (1.0 + change) / (1.0 + rise.level) - 1.0
    return None


def _judged(
    spec: MotorSpec, state: LookState, rise: Rise, label: dt.date, found: float
) -> tuple[LookState, Change]:
    is_so = found >= SHARE_OF_END * rise.change
    verdict = "confirmed" if is_so else "withdrawn"
    end_us = night_labelled(label, spec.settings.nights).end_us
    words = (
        f"{verdict} by the night of {label}: drain flow {100 * found:+.0f} % against before, told "
        f"was {100 * rise.change:+.0f} %"
    )
    before = state.state
    after = CLEAR if not is_so and before == LOOK_NOW and state.rise == rise else before
    state = _scored(state, rise, confirmed=int(is_so), withdrawn=int(not is_so))
    if after != before:
        state = replace(state, state=after, since_us=end_us, reason=words, rise=None)
    return state, Change(end_us, before, after, words, rise, verdict, label)


def _scored(state: LookState, rise: Rise, confirmed: int = 0, withdrawn: int = 0) -> LookState:
    """The state after the verdict of a night on a rise, or without one."""
    old = state.scores
    scores = replace(old, confirmed=old.confirmed + confirmed, withdrawn=old.withdrawn + withdrawn)
    return replace(state, scores=scores, waiting=tuple(one for one in state.waiting if one != rise))
