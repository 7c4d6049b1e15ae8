"""One motor's look: new samples to blocks, blocks to changes of state."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leakage.course.step_detection import StepWatch, advance
from pipeline.arrays import SECOND_US
from pipeline.config import MotorSpec
from pipeline.config.nights import night as night_labelled
from pipeline.config.nights import night_of
from pipeline.ingest import RawLog
from pipeline.logs.files import reaches_us, slice_night
from pipeline.look.baseline import LookBaseline
from pipeline.look.blocks import Blocks, block_us, blocks_within
from pipeline.look.reading import PASS_BYTES, News, newest_us_of, read_news
from pipeline.look.state import BLIND, MOST_RECENT, NOT_READY, LookState, Rise, Scores
from pipeline.trends.rows.motor_states import CLEAR, LOOK_NOW

# Blocks before the first new one whose samples are cleaned with it, and the wait for the samples
# behind it that the rules look at.
BLOCKS_BEFORE, SETTLE_US = 2, 30 * SECOND_US
# Longest way back: what is older is left to the nights.
LONGEST_WAY_BACK = dt.timedelta(days=2)
# Blocks in a row whose mean ends a rise, below this share of it.
BLOCKS_OF_END, SHARE_OF_END = 5, 0.5
NOTHING = "nothing to judge since then"
# Of a 95 % interval, in standard deviations.
TWO_SIDED_95 = 1.96


@dataclass(frozen=True, slots=True)
class Change:
    """A change of state, or the verdict of a night on a rise."""

    time_us: int  # when [µs since 1970]
    before: str
    after: str
    reason: str
    rise: Rise | None = None  # the rise that it tells or ends; None without one
    verdict: str = ""  # ``told``, ``confirmed`` or ``withdrawn``; empty without one
    night: dt.date | None = None  # night that gave the verdict


def looked_at(
    spec: MotorSpec,
    baseline: LookBaseline,
    state: LookState,
    last_night: dt.date,
    now_us: int,
    latest_us: int,
) -> tuple[LookState, list[Change]]:
    """Take up what is new in a motor's logs: the state after it, and its changes in order.

    A first look begins behind `last_night`, the last that is published; samples after `latest_us`
    are refused.
    """
    state, changes = _begun(spec, baseline, state, last_night, now_us)
    most_bytes = PASS_BYTES
    while (news := _news(spec, state, latest_us, most_bytes)) is not None:
        before = state.next_us
        state, found = _taken_up(spec, baseline, state, news)
        changes += found
        if news.is_all:
            break
        # A step that is not longer than what has to be read again leads nowhere.
        most_bytes = most_bytes if state.next_us > before else 2 * most_bytes
    return _silent(spec, state, now_us, changes), changes


def _begun(
    spec: MotorSpec,
    baseline: LookBaseline,
    state: LookState,
    last_night: dt.date,
    now_us: int,
) -> tuple[LookState, list[Change]]:
    """The state with a filter of this baseline, at a begin."""
    if state.baseline != baseline.key:
        watch = StepWatch.begin(baseline.errors)
        state = replace(state, baseline=baseline.key, watch=watch, recent=())
    nights = spec.settings.nights
    earliest = night_of(now_us, nights) - LONGEST_WAY_BACK
    if state.next_us:
        begin_us = night_labelled(earliest, nights).start_us
        return replace(state, next_us=max(state.next_us, begin_us)), []
    begin_us = max(
        night_labelled(last_night, nights).end_us, night_labelled(earliest, nights).start_us
    )
    return _moved(replace(state, next_us=begin_us), begin_us, BLIND, "nothing was judged yet")


def _news(spec: MotorSpec, state: LookState, latest_us: int, most_bytes: int) -> News | None:
    reach_us = max(reaches_us(spec).values(), default=0)
    needed_us = state.next_us - BLOCKS_BEFORE * block_us(spec) - reach_us
    return read_news(spec, state.files, needed_us, latest_us, most_bytes)


def _taken_up(
    spec: MotorSpec, baseline: LookBaseline, state: LookState, news: News
) -> tuple[LookState, list[Change]]:
    """Take up all blocks whose samples are there."""
    changes: list[Change] = []
    newest_us = max((one.newest_us for one in news.files.values()), default=0)
    state = replace(state, files=news.files, newest_us=newest_us)
    if news.fault:
        state = replace(state, cause=news.fault)
    while True:
        night = night_labelled(night_of(state.next_us, spec.settings.nights), spec.settings.nights)
        ready_us = _ready_us(spec, news, state.next_us)
        end_us = min(ready_us - (ready_us - night.start_us) % block_us(spec), night.end_us)
        if ready_us >= night.end_us:
            end_us = night.end_us
        if end_us <= state.next_us:
            return state, changes
        blocks, cause = _blocks(spec, news.logs, state.next_us, end_us)
        if len(blocks.start_us):
            state, found = judged(spec, baseline, state, blocks)
            changes += found
        elif cause:
            state = replace(state, cause=cause)
        state = replace(state, next_us=end_us)


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
    periodic = [
        lasts.get(name, 0)
        for name, channel in spec.file.channels.items()
        if channel.sampling != "on_change"
    ]
    first = min(periodic, default=0)
    if news.is_all:
        first = max(first, max(lasts.values()) - block_us(spec))
    return first - SETTLE_US


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


def judged(
    spec: MotorSpec, baseline: LookBaseline, state: LookState, blocks: Blocks
) -> tuple[LookState, list[Change]]:
    """Take up some blocks, in order."""
    measured, expected = baseline.flows(blocks)
    seen = baseline.has_seen(blocks) & (expected > 0.0)
    changes: list[Change] = []
    length = block_us(spec)
    warm_us = round(spec.settings.look.warm_up_minutes * 60 * SECOND_US)
    for place, start_us in enumerate(blocks.start_us.tolist()):
        state, went = _went_blind(spec, state, start_us)
        changes += went
        if start_us - state.block_end_us >= warm_us:
            state = replace(state, warm_from_us=start_us + warm_us)
        state = replace(state, block_end_us=start_us + length)
        if start_us < state.warm_from_us:
            state = replace(state, cause="the motor is warming up")
        elif not seen[place]:
            state = replace(state, cause=_beyond(baseline, blocks, place))
        else:
            error = float(measured[place] - expected[place])
            state, change = _advanced(
                baseline, state, start_us, length, float(expected[place]), error
            )
            changes += change
    return state, changes


def _beyond(baseline: LookBaseline, blocks: Blocks, place: int) -> str:
    """The condition of a block that the baseline has not seen, in words."""
    units = (("oil temperature", "°C"), ("pressure difference", "bar"), ("speed", "rpm"))
    for (name, unit), value, low, high in zip(
        units, blocks.conditions[place], baseline.lowest, baseline.highest, strict=True
    ):
        if not low <= value <= high:
            return (
                f"outside the baseline's conditions: {name} {value:.4g} {unit}, it has seen "
                f"{low:.4g} to {high:.4g}"
            )
    return "no flow is expected"


def _advanced(
    baseline: LookBaseline,
    state: LookState,
    start_us: int,
    length: int,
    expected: float,
    error: float,
) -> tuple[LookState, list[Change]]:
    """Take up a block that counts."""
    assert state.watch is not None
    end_us = start_us + length
    watch, found = advance(
        state.watch,
        baseline.errors,
        np.array(start_us // length),
        np.array(expected),
        np.array(error),
    )
    recent = (*state.recent, (end_us, expected, error))[-MOST_RECENT:]
    state = replace(state, watch=watch, recent=recent, judged_us=end_us, cause="")
    if state.state == LOOK_NOW:
        return _ended(state, end_us)
    if float(found.statistic) > baseline.limit:
        change = float(found.rise)
        half = TWO_SIDED_95 * float(found.rise_sd)
        began_us = int(found.began) * length + start_us % length
        rise = Rise(began_us, end_us, change, half, baseline.level)
        return _moved(state, end_us, LOOK_NOW, "", rise)
    if state.state != CLEAR:
        return _moved(state, end_us, CLEAR, "the drain flow is as expected")
    return state, []


def _ended(state: LookState, end_us: int) -> tuple[LookState, list[Change]]:
    """End a rise where the flow is back."""
    rise = state.rise
    assert rise is not None
    last = state.recent[-BLOCKS_OF_END:]
    change = change_within(state, max(rise.told_us, last[0][0] - 1), end_us, BLOCKS_OF_END)
    if change is None or change >= SHARE_OF_END * rise.change:
        return state, []
    words = f"the drain flow is back within {100 * SHARE_OF_END:.0f} % of the rise, or the nights "
    return _moved(state, end_us, CLEAR, words + "have taken it up", rise)


def _moved(
    state: LookState, time_us: int, after: str, reason: str, rise: Rise | None = None
) -> tuple[LookState, list[Change]]:
    """Go into another state."""
    told = after == LOOK_NOW
    change = Change(time_us, state.state, after, reason, rise, "told" if told else "")
    state = replace(
        state, state=after, since_us=time_us, reason=reason, rise=rise if told else None
    )
    if told and rise is not None:
        scores = replace(state.scores, told=state.scores.told + 1)
        state = replace(state, waiting=(*state.waiting, rise), scores=scores)
    return state, [change]


def _went_blind(spec: MotorSpec, state: LookState, until_us: int) -> tuple[LookState, list[Change]]:
    """Go blind where nothing was judged for long; a rise that is told stands."""
    after_us = round(spec.settings.look.blind_after_minutes * 60 * SECOND_US)
    blind_us = state.judged_us + after_us
    if state.state != CLEAR or until_us <= blind_us:
        return state, []
    why = state.cause or "no new samples"
    return _moved(state, blind_us, BLIND, f"{NOTHING}: {why}")


def _silent(spec: MotorSpec, state: LookState, now_us: int, changes: list[Change]) -> LookState:
    """The state by the clock, where the logs say nothing new."""
    if state.newest_us <= state.judged_us + block_us(spec):
        state = replace(state, cause="no new samples")
    state, found = _went_blind(spec, state, now_us)
    changes += found
    if state.state == BLIND and state.cause:
        state = replace(state, reason=f"{NOTHING}: {state.cause}")
    return state


def without_baseline(
    spec: MotorSpec, state: LookState, why: str, last_night: dt.date | None
) -> tuple[LookState, list[Change]]:
    """The state of a motor without a baseline."""
    if state.state == NOT_READY:
        return replace(state, reason=why), []
    time_us = 0
    if last_night is not None:
        time_us = night_labelled(last_night, spec.settings.nights).end_us
    state, changes = _moved(state, max(time_us, state.judged_us), NOT_READY, why, state.rise)
    return replace(state, next_us=0, baseline="", watch=None, recent=()), changes


def scored(state: LookState, verdict: str, rise: Rise) -> LookState:
    """The state after the verdict of a night on a rise."""
    old = state.scores
    scores = Scores(
        old.told, old.confirmed + (verdict == "confirmed"), old.withdrawn + (verdict == "withdrawn")
    )
    waiting = tuple(one for one in state.waiting if one != rise)
    return replace(state, scores=scores, waiting=waiting)


def change_within(state: LookState, first_us: int, end_us: int, least_blocks: int) -> float | None:
    """Relative error of the remembered blocks that end in some time; None for too few."""
    chosen = [one for one in state.recent if first_us < one[0] <= end_us]
    if len(chosen) < least_blocks:
        return None
    _, expected, error = np.sum(chosen, axis=0)
    return float(error / expected)
