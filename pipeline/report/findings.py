"""Parts named by alarms against the parts that inspections found worn or sound."""

from __future__ import annotations

import datetime as dt
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import polars as pl

from pipeline.trends.nights.decisions import Decision

# Nights up to the last one before the opening in which the newest alarm counts: a motor may stand
# for weeks before it is opened.
NIGHTS_BEFORE = 7
ALARMED = ("warning", "alarm")
COEFFICIENT = "K_"
COLUMNS = ("motor_id", "night", "state", "cause")
# Causes that leave open which part it is.
NO_PART = ("all_gaps", "all_flows", "cannot_be_told")


@dataclass(frozen=True, slots=True)
class Score:
    """Parts that inspections looked at."""

    # named_right, named_wrong: parts that an alarm named: worn, and sound.
    named_right: int = 0
    named_wrong: int = 0
    cannot_be_told: int = 0  # worn parts of a motor in alarm of which no part was named
    missed: int = 0  # worn parts that no alarm named, though it named others or there was none


def scores(
    decisions: Iterable[Decision], watch: pl.DataFrame, types: Mapping[str, str]
) -> dict[str, Score]:
    """Score of each motor type with an inspection, of the motors that `types` knows.

    Of several findings on a part of the same night the last counts. `watch` holds `COLUMNS`.
    """
    found: dict[str, Counter[str]] = {}
    inspected = {one: is_worn for said in decisions for one, is_worn in _parts(said)}
    for (motor_id, night, part), is_worn in sorted(inspected.items()):
        if motor_id in types:
            named = _named(watch.filter(motor_id=motor_id), night)
            counts = found.setdefault(types[motor_id], Counter())
            counts.update(_outcome(part, named, is_worn=is_worn))
    return {motor_type: Score(**counts) for motor_type, counts in sorted(found.items())}


def total(found: Iterable[Score]) -> Score:
    """The score of all motor types together."""
    parts = [(one.named_right, one.named_wrong, one.cannot_be_told, one.missed) for one in found]
    return Score(*(sum(column) for column in zip(*parts, strict=True)))


def _parts(said: Decision) -> list[tuple[tuple[str, dt.date, str], bool]]:
    """Parts of a finding, and whether each is worn; that on a loss factor is one on its path."""
    parts = [(part, True) for part in said.worn_parts] + [
        (part, False) for part in said.sound_parts
    ]
    if said.finding is not None and said.indicator.startswith(COEFFICIENT):
        parts.append((said.indicator.removeprefix(COEFFICIENT), said.finding == "confirmed"))
    return [((said.motor_id, said.night, part), is_worn) for part, is_worn in parts]


def _named(watch: pl.DataFrame, opened: dt.date) -> Sequence[str] | None:
    """Parts that a motor's newest alarm before its opening named; None: there was none."""
    nights = watch.filter(pl.col("night") <= opened)
    last = nights["night"].max()
    if not isinstance(last, dt.date):
        return None
    is_late = pl.col("night") > last - dt.timedelta(days=NIGHTS_BEFORE)
    before = nights.filter(is_late, pl.col("state").is_in(ALARMED))
    if before.is_empty():
        return None
    causes = before.filter(pl.col("night") == pl.col("night").max())["cause"].drop_nulls()
    return [part for cause in causes if cause not in NO_PART for part in cause.split(" and ")]


def _outcome(part: str, named: Sequence[str] | None, *, is_worn: bool) -> list[str]:
    if named is not None and part in named:
        return ["named_right" if is_worn else "named_wrong"]
    if not is_worn:
        return []
    return ["missed" if named is None or named else "cannot_be_told"]
