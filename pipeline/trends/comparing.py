"""A motor before and after a date that somebody names: from its stored blocks, no log is read."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from leakage import EstimationError
from leakage.watch import Comparison, compare
from pipeline.config import MotorSpec
from pipeline.errors import UsageError
from pipeline.logs.processed import as_published, read_settings
from pipeline.schema import BLOCKS
from pipeline.store.state import read_state_file
from pipeline.store.tables import nights_back
from pipeline.trends.course import watch_settings
from pipeline.trends.nights import read_blocks
from pipeline.trends.sentences import MOST_CANDIDATES, cause_words, day, percent, relative_change
from pipeline.trends.watch_columns import WatchColumns

# Below this probability nothing is said of a cause.
EVEN = 0.5


def compare_nights(
    output: Path, spec: MotorSpec, at: dt.date, most: int
) -> tuple[dict[str, Any], list[str]]:
    """Compare a motor's nights from a date on with those before, as plain data and in lines.

    At most so many on each side, none beyond another event.

    Raises
    ------
    UsageError
        If there are too few nights on a side.
    StoreError
        If a table file is damaged.
    """
    with read_state_file(output) as state:
        spec = as_published(spec, read_settings(state).get(spec.motor_id))
    borders = [event.date for event in spec.file.changes if event.date != at]
    first = max((border for border in borders if border < at), default=dt.date.min)
    end = min((border for border in borders if border > at), default=dt.date.max)
    nights = [night for night in nights_back(output, BLOCKS) if first <= night < end]
    earlier = [night for night in nights if night < at][:most]
    later = [night for night in nights if night >= at][-most:]
    watch_columns = WatchColumns.of(spec, at)
    before, after = (read_blocks(output, spec, watch_columns, some) for some in (earlier, later))
    try:
        machine = watch_columns.machine(spec, min(earlier, default=at))
        comparison = compare(machine, before, after, watch_settings(spec))
    except EstimationError as error:
        raise UsageError("compare_nights", f"{spec.motor_id}, {at}: {error.message}") from None
    of_before, of_after = (
        [dt.date.fromordinal(night.day) for night in some] for some in (before, after)
    )
    record = {
        "motor_id": spec.motor_id,
        "before": list(map(str, of_before)),
        "after": list(map(str, of_after)),
        "change": comparison.change.value,
        "change_lower": comparison.change.lower,
        "change_upper": comparison.change.upper,
        "probability": comparison.probability,
        "cause": comparison.cause,
        "cause_probability": comparison.cause_probability,
        "candidates": dict(comparison.candidates),
        "lack_of_fit": comparison.lack_of_fit,
        "is_other_duty": comparison.operates_otherwise,
    }
    return record, list(_lines(spec.motor_id, of_before, of_after, comparison))


def _lines(
    motor_id: str, before: Sequence[dt.date], after: Sequence[dt.date], comparison: Comparison
) -> Iterator[str]:
    """Yield what is reported of a comparison."""
    yield f"{motor_id}: {_nights(after)} against {_nights(before)}"
    yield (
        f"case drain flow at the same conditions {relative_change(comparison.change)}; "
        f"probability of a change {percent(comparison.probability)}"
    )
    if comparison.probability > EVEN:
        likeliest = sorted(comparison.candidates.items(), key=lambda pair: -pair[1])
        causes = [f"{cause_words(name)} {percent(p)}" for name, p in likeliest[:MOST_CANDIDATES]]
        yield f"cause: {', '.join(causes)}"
    if comparison.operates_otherwise:
        yield "load or speed are others than before: the interval is wider by that"
    yield f"the model misses {100 * comparison.lack_of_fit:.1f} % of the flow before"


def _nights(nights: Sequence[dt.date]) -> str:
    return f"{len(nights)} nights ({day(nights[0])} to {day(nights[-1])})"
