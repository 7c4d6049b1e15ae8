"""One motor's look: new samples to blocks, blocks to changes of state, and the nights' verdicts."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from pipeline.arrays import SECOND_US
from pipeline.clock import utc
from pipeline.config import MotorSpec
from pipeline.config.nights import night as night_labelled
from pipeline.config.nights import night_of
from pipeline.ingest import RawLog
from pipeline.logs.files import reaches_us, slice_night
from pipeline.look.comparison import SUDDEN, Blocks, NightsBefore, block_us, blocks_within
from pipeline.look.reading import News, newest_us_of, read_news
from pipeline.look.state import BLIND, NOT_READY, LookState, Rise
from pipeline.schema import WATCH
from pipeline.store.tables import read_rows
from pipeline.trends.rows.motor_states import CLEAR, LOOK_NOW

# Blocks before the first new one whose samples are cleaned with it, and the wait for the samples
# behind it that the rules look at.
BLOCKS_BEFORE, SETTLE_US = 2, 30 * SECOND_US
# Longest way back: what is older is left to the nights.
LONGEST_WAY_BACK = dt.timedelta(days=2)
# The night so far is judged once in so many blocks: what is told hangs on no look's hour.
JUDGED_EVERY = 2
# Latest blocks that are judged by themselves, so that a break is not lost in a long day.
LATEST_BLOCKS = (5, 15)
# Share of a rise below which it has ended.
SHARE_OF_END = 0.5
NOTHING = "nothing to judge since then"


Row = dict[str, Any]
Looked = tuple[LookState, list[Row]]


def _row(
    time_us: int,
    before: str,
    after: str,
    reason: str,
    rise: Rise | None = None,
    verdict: str | None = None,
    night: dt.date | None = None,
) -> Row:
    """A row of `looks` but for its motor: a change of state, or a night's verdict on a rise."""
    row: Row = {"time": utc(time_us), "from_state": before, "to_state": after, "reason": reason}
    row |= {"verdict": verdict, "confirmed_by": night}
    if rise is not None:
        value, half = 100.0 * rise.change, 100.0 * rise.half_width
        row |= {"since": utc(rise.began_us), "change_percent": value}
        row |= {"change_lower": value - half, "change_upper": value + half}
    return row


def looked_at(
    spec: MotorSpec, before: NightsBefore, state: LookState, now_us: int, latest_us: int
) -> Looked:
    """Take up what is new in a motor's logs: the state after it, and its changes in order.

    A first look begins behind the last published night; samples after `latest_us` are refused.
    """
    state, changes = _begun(spec, before, state, now_us)
    reach_us = max(reaches_us(spec).values(), default=0)
    needed_us = state.next_us - BLOCKS_BEFORE * block_us(spec) - reach_us
    news = read_news(spec, state.files, needed_us, latest_us)
    if news is not None:
        state, found = _taken_up(spec, before, state, news)
        changes += found
    return _silent(spec, state, now_us, changes), changes


def _begun(spec: MotorSpec, before: NightsBefore, state: LookState, now_us: int) -> Looked:
    nights = spec.settings.nights
    begin_us = night_labelled(night_of(now_us, nights) - LONGEST_WAY_BACK, nights).start_us
    begin_us = max(begin_us, night_labelled(before.last_night, nights).end_us)
    if state.next_us:
        is_behind = state.next_us < begin_us
        return (replace(state, next_us=begin_us, blocks=()) if is_behind else state), []
    return moved(replace(state, next_us=begin_us), begin_us, BLIND, "nothing was judged yet")


def _taken_up(spec: MotorSpec, before: NightsBefore, state: LookState, news: News) -> Looked:
    """Take up all blocks whose samples are there, some at a time."""
    changes: list[Row] = []
    newest_us = max((one.newest_us for one in news.files.values()), default=0)
    cause = news.fault or state.cause
    state = replace(state, files=news.files, newest_us=newest_us, cause=cause)
    nights, step_us = spec.settings.nights, JUDGED_EVERY * block_us(spec)
    while True:
        night = night_labelled(night_of(state.next_us, nights), nights)
        end_us = _ready_us(spec, news, state.next_us)
        end_us = min(end_us - (end_us - night.start_us) % step_us, night.end_us)
        if end_us <= state.next_us:
            return state, changes
        blocks, cause = _blocks(spec, news.logs, state.next_us, end_us)
        if not len(blocks.start_us) and cause:
            state = replace(state, cause=cause)
        step = (blocks.start_us - night.start_us) // step_us
        for one in np.unique(step):
            state, found = _judged(spec, before, state, blocks.only(step == one), night.date)
            changes += found
        # The blocks are those of one night.
        is_over = end_us == night.end_us
        state = replace(state, next_us=end_us, blocks=() if is_over else state.blocks)


def _ready_us(spec: MotorSpec, news: News, next_us: int) -> int:
    """Time up to which blocks are whole.

    The channel that lags most says it, unless it is silent for longer than a block.
    """
    lasts: dict[str, int] = {}
    for log in news.logs:
        for name, channel in log.channels.items():
            if len(channel.time_us):
                lasts[name] = max(lasts.get(name, 0), newest_us_of(channel))
    if not lasts:
        return next_us
    channels = spec.file.channels.items()
    periodic = [lasts.get(name, 0) for name, one in channels if one.sampling != "on_change"]
    first = min(periodic, default=0)
    return max(first, max(lasts.values()) - block_us(spec)) - SETTLE_US


def _blocks(
    spec: MotorSpec, logs: Sequence[RawLog], first_us: int, end_us: int
) -> tuple[Blocks, str]:
    nights = spec.settings.nights
    night = night_labelled(night_of(first_us, nights), nights)
    before_us = max(first_us - BLOCKS_BEFORE * block_us(spec), night.start_us)
    window = replace(night, start_us=before_us, end_us=min(end_us + SETTLE_US, night.end_us))
    channels = slice_night(logs, window, reaches_us(spec))
    if not any((channel.time_us >= first_us).any() for channel in channels.values()):
        return Blocks.none(), ""
    return blocks_within(spec, night, channels, first_us, end_us)


def _judged(
    spec: MotorSpec, before: NightsBefore, state: LookState, blocks: Blocks, night: dt.date
) -> Looked:
    """Take up the warm ones of some blocks, and judge the night so far."""
    length, warm = block_us(spec), list[int]()
    warm_us = round(spec.settings.look.warm_up_minutes * 60 * SECOND_US)
    changes: list[Row] = []
    for place, start_us in enumerate(blocks.start_us.tolist()):
        state, went = _went_blind(spec, state, start_us)
        changes += went
        if start_us - state.block_end_us >= warm_us:
            state = replace(state, warm_from_us=start_us + warm_us)
        state = replace(state, block_end_us=start_us + length)
        if start_us >= state.warm_from_us:
            warm.append(place)
    if not warm:
        return replace(state, cause="the motor is warming up"), changes
    rows = [*state.blocks, *(blocks.rows[place] for place in warm)]
    end_us = int(rows[-1][0]) + length
    judged = replace(state, blocks=tuple(rows), judged_us=end_us, cause="")
    judged, found = _told(before, judged, Blocks.of_rows(rows), night)
    if abs(judged.latest) > SUDDEN:
        why = before.columns_changed(spec, Blocks.of_rows(rows[-len(warm) :]))
        if why is not None:  # no change of the flow, and no block to judge the next ones with
            judged, found = replace(state, cause=why), []
            if state.state == CLEAR:
                judged, found = moved(judged, end_us, BLIND, why)
    return judged, changes + found


def _told(before: NightsBefore, state: LookState, sofar: Blocks, night: dt.date) -> Looked:
    """Tell a rise of the night so far, or of its latest blocks, or that it is over."""
    end_us = state.judged_us
    if len(sofar.start_us) < LATEST_BLOCKS[0]:
        return state, []
    windows = [sofar.only(slice(-n, None)) for n in LATEST_BLOCKS]
    rises = [before.rise(blocks, night)[0] for blocks in windows]
    state = replace(state, latest=rises[0].value)
    if state.state == LOOK_NOW:
        assert state.rise is not None
        if rises[0].upper >= SHARE_OF_END * state.rise.change:
            return state, []
        words = f"the drain flow is back within {100 * SHARE_OF_END:.0f} % of the rise, or the "
        return moved(state, end_us, CLEAR, f"{words}nights have taken it up", state.rise)
    all_day, is_told = before.rise(sofar.merged(before.merged), night)
    for blocks, rise in zip((*windows, sofar), (*rises, all_day), strict=True):
        is_new = is_told and blocks is sofar
        if rise.value > 0.0 and (is_new or before.is_sudden(rise)):
            began_us, half = int(blocks.start_us[0]), rise.upper - rise.value
            told = Rise(began_us, end_us, rise.value, half, before.level.value)
            return moved(state, end_us, LOOK_NOW, "", told)
    if state.state != CLEAR:
        return moved(state, end_us, CLEAR, "the drain flow is as expected")
    return state, []


def moved(
    state: LookState, time_us: int, after: str, reason: str, rise: Rise | None = None
) -> Looked:
    """Go into another state."""
    told = after == LOOK_NOW
    row = _row(time_us, state.state, after, reason, rise, "told" if told else None)
    state = replace(
        state, state=after, since_us=time_us, reason=reason, rise=rise if told else None
    )
    if told and rise is not None:
        state = replace(state, waiting=(*state.waiting, rise))
    return state, [row]


def _went_blind(spec: MotorSpec, state: LookState, until_us: int) -> Looked:
    """Go blind where nothing was judged for long; a rise that is told stands."""
    blind_us = state.judged_us + round(spec.settings.look.blind_after_minutes * 60 * SECOND_US)
    if state.state != CLEAR or until_us <= blind_us:
        return state, []
    return moved(state, blind_us, BLIND, f"{NOTHING}: {state.cause or 'no new samples'}")


def _silent(spec: MotorSpec, state: LookState, now_us: int, changes: list[Row]) -> LookState:
    """The state by the clock, where the logs say nothing new."""
    if state.newest_us <= state.judged_us + JUDGED_EVERY * block_us(spec):
        state = replace(state, cause="no new samples")
    state, found = _went_blind(spec, state, now_us)
    changes += found
    if state.state == BLIND and state.cause:
        state = replace(state, reason=f"{NOTHING}: {state.cause}")
    return state


def without_watch(state: LookState, why: str) -> Looked:
    """The state of a motor that has no watch."""
    if state.state == NOT_READY:
        return replace(state, reason=why), []
    state, changes = moved(state, max(state.judged_us, state.since_us), NOT_READY, why, state.rise)
    return replace(state, next_us=0, blocks=()), changes


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
            state, change = _by_night(spec, state, rise, *found)
            changes.append(change)
        elif first + dt.timedelta(days=MOST_NIGHTS) <= nights.last_night:
            state = _settled(state, rise)
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
    told = rows.filter(pl.col("n_blocks") > 0)
    for label, change in told.sort("night").select("night", "tonight_change").iter_rows():
        if change is not None:
            return label, (1.0 + change) / (1.0 + rise.level) - 1.0
    return None


def _by_night(
    spec: MotorSpec, state: LookState, rise: Rise, label: dt.date, found: float
) -> tuple[LookState, Row]:
    is_so = found >= SHARE_OF_END * rise.change
    verdict = "confirmed" if is_so else "withdrawn"
    end_us = night_labelled(label, spec.settings.nights).end_us
    words = (
        f"{verdict} by the night of {label}: drain flow {100 * found:+z.0f} % against before, told "
        f"was {100 * rise.change:+.0f} %"
    )
    before = state.state
    after = CLEAR if not is_so and before == LOOK_NOW and state.rise == rise else before
    state = _settled(state, rise)
    if after != before:
        state = replace(state, state=after, since_us=end_us, reason=words, rise=None)
    return state, _row(end_us, before, after, words, rise, verdict, label)


def _settled(state: LookState, rise: Rise) -> LookState:
    """The state in which a rise waits for no night any more."""
    return replace(state, waiting=tuple(one for one in state.waiting if one != rise))
