"""Nights too poor to say anything alone, fitted together from the statistics of their blocks.

Each night is used once, and the figure is of the last of them: a night's figures hang on no later
night. A night that says something alone ends the row, as what lies before it is older news.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from leakage import LeakageError
from leakage.block_statistics import merge
from leakage.identifiability import ONE_BLOCK, OUTSIDE
from pipeline.night.block_fit import BlockFit, fit_stored_blocks
from pipeline.night.rows import upper_triangle
from pipeline.night.stored_blocks import StoredBlocks
from pipeline.night.windows import TRAINING
from pipeline.trends.decisions import Decision
from pipeline.trends.history import History
from pipeline.trends.night_records import HISTOGRAMS, Array, NightWords, Records
from pipeline.trends.segments import segments

# Minutes of kept training samples at which nights together are fitted, and at least so many of the
# most that may be taken together.
LEAST_MINUTES_COEFFICIENT, LEAST_MINUTES_INTERVAL = 60.0, 30.0
BLOCKS_GONE = "statistics of their blocks are not there any more"
# Reads the blocks of a motor's nights, in order of time.
ReadBlocks = Callable[[Sequence[dt.date]], pl.DataFrame]


def with_poor_nights(
    history: History,
    decisions: Sequence[Decision],
    read_blocks: ReadBlocks,
    known: tuple[Records, dt.date] | None = None,
) -> History:
    """A history in which nights that are too poor alone are fitted together."""
    most = history.spec.settings.trend.merge_nights
    borders = {part.first for part in segments(history, decisions)}
    records, words = history.records.copy(), dict(history.words)
    begin = 0
    if known is not None:
        begin = _fill_known(records, *known)
    rows = _rows_of_poor(history, records, borders, begin)
    if most < 2 or not rows:
        return history if known is None else replace(history, records=records)
    poor = [place for row in rows for place in row]
    blocks = _Blocks(history, poor, read_blocks)
    for place in poor:
        if np.isnan(records["minutes"][place]):
            _describe(history, records, place, blocks.of(place))
    for row in rows:
        for group in groups_of(row, records["minutes"], records["kind"], most):
            last = group[-1]
            records["together_in"][list(group)] = records["night"][last]
            found = _fit(history, records, group, blocks)
            if isinstance(found, str):
                before = words.get(last)
                if before is not None:
                    words[last] = _together(before, f"{len(group)} nights together: {found}")
            else:
                records[last], words[last] = found
    return replace(history, records=records, words=words)


def groups_of(
    row: Sequence[int], minutes: Array, kinds: NDArray[np.bytes_], most: int
) -> list[tuple[int, ...]]:
    """Nights of a row of poor ones that are fitted together.

    Examples
    --------
    >>> kinds = np.array([b"a"] * 6)
    >>> groups_of(range(6), np.full(6, 25.0), kinds, 7)
    [(0, 1, 2), (3, 4, 5)]
    >>> groups_of(range(6), np.full(6, 12.0), kinds, 3)
    [(0, 1, 2), (3, 4, 5)]
    """
    groups: list[tuple[int, ...]] = []
    pool: list[int] = []
    for place in row:
        if not kinds[place]:
            continue
        if pool and kinds[place] != kinds[pool[-1]]:
            pool = []
        pool = [*pool, place][-most:]
        total = float(minutes[pool].sum())
        enough = LEAST_MINUTES_INTERVAL if len(pool) == most else LEAST_MINUTES_COEFFICIENT
        if len(pool) > 1 and total >= enough:
            groups.append(tuple(pool))
            pool = []
    return groups


def _fill_known(records: Records, known: Records, until: dt.date) -> int:
    """Put in what is known; returns from which place on nights are to be fitted together."""
    records[np.searchsorted(records["night"], known["night"])] = known
    settled = records["fitted"] | _used(records)
    settled &= records["night"] < np.datetime64(until)
    return int(np.flatnonzero(settled)[-1]) + 1 if settled.any() else 0


def _used(records: Records) -> NDArray[np.bool_]:
    """Nights that were fitted together with others, whatever came of it."""
    used: NDArray[np.bool_] = ~np.isnat(records["together_in"])
    return used


def _rows_of_poor(
    history: History, records: Records, borders: set[int], begin: int
) -> list[list[int]]:
    """Rows of two or more poor nights: with no fitted one, no event and no long silence between.

    A night that was used ends a row as well: what was left over before it had its turn.
    """
    numbers = history.numbers
    longest = history.spec.settings.alarms.stale_after_nights
    rows: list[list[int]] = [[]]
    ends = records["fitted"] | _used(records)
    for place in (begin + np.flatnonzero((ends | records["poor"])[begin:])).tolist():
        row = rows[-1]
        apart = bool(row) and (
            any(row[-1] < border <= place for border in borders)
            or numbers[place] - numbers[row[-1]] > longest
        )
        if ends[place] or apart:
            rows.append([])
        if not ends[place]:
            rows[-1].append(place)
    return [row for row in rows if len(row) > 1]


@dataclass(slots=True)
class _Blocks:
    """Blocks of a motor's poor nights, read once and only if one of them is needed."""

    history: History
    places: Sequence[int]
    read: ReadBlocks
    _nights: dict[object, pl.DataFrame] | None = None

    def of(self, place: int) -> pl.DataFrame:
        """Blocks of a night in order of time."""
        labels = [self.history.nights[one] for one in self.places]
        if self._nights is None:
            rows = self.read(labels).sort("block_start")
            by_night = rows.partition_by("night", as_dict=True, maintain_order=True)
            self._nights = dict.fromkeys(labels, rows.clear())
            self._nights |= {key[0]: part for key, part in by_night.items()}
        return self._nights[self.history.nights[place]]


def _describe(history: History, records: Records, place: int, blocks: pl.DataFrame) -> None:
    """Minutes and kind of a night that has no fit of its own."""
    hashes = set(blocks["model_hash"].to_list())
    stored = StoredBlocks.of(blocks, history.layout.columns)
    if len(hashes) != 1 or stored is None:
        records["minutes"][place] = 0.0
        return
    period = _period_s(records, place, stored.n_samples)
    records["minutes"][place] = stored.part(TRAINING).n_samples * period / 60.0
    records["kind"][place] = hashes.pop()


def _period_s(records: Records, place: int, n_kept: int) -> float:
    """Period of the time base in a night: the last known one, else by its samples and hours."""
    known = records["period_s"][: place + 1]
    known = known[np.isfinite(known)]
    if len(known):
        return float(known[-1])
    return 3600.0 * float(records["kept_hours"][place]) / n_kept


def _fit(
    history: History, records: Records, group: Sequence[int], blocks: _Blocks
) -> tuple[Any, NightWords] | str:
    """Record and words of the last night of a group, fitted together; a text where it cannot be."""
    parts = [blocks.of(place) for place in group]
    if not all(part.height for part in parts):
        return BLOCKS_GONE
    whole = StoredBlocks.of(pl.concat(parts), history.layout.columns)
    if whole is None:
        return BLOCKS_GONE
    spec, label = history.spec, history.nights[group[-1]]
    charge_bar = _last_known(records["charge"][: group[-1] + 1])
    try:
        found = fit_stored_blocks(
            spec,
            label,
            spec.file.flushing.mode,
            whole,
            charge_bar,
            float(np.nanmax([1.0, *records["inflation"][list(group)]])),
            search=False,
            bootstrap=False,
        )
    except LeakageError as error:
        return str(error)
    if found.identification.distribution is None:
        return ONE_BLOCK
    record = records[group[-1]].copy()
    _fill(record, found, charge_bar, float(records["minutes"][list(group)].sum()))
    record["n_nights"], record["mode"] = len(group), spec.file.flushing.mode
    record["model"] = records["kind"][group[-1]]
    record["factor"] = upper_triangle(merge(whole.factors))
    for name in HISTOGRAMS:
        record[name] = records[name][list(group)].sum(axis=0)
    return record, _words(found)


def _fill(record: Any, found: BlockFit, charge_bar: float | None, minutes: float) -> None:
    """What a fit says, into a record."""
    distribution = found.identification.distribution
    assert distribution is not None
    theta = found.fit.coefficients
    covariance = np.zeros((len(theta), len(theta)))
    covariance[np.ix_(distribution.active, distribution.active)] = distribution.covariance()
    record["fitted"], record["poor"] = True, False
    record["theta"], record["covariance"] = theta, upper_triangle(covariance)
    record["blocks"], record["minutes"] = found.identification.n_blocks, minutes
    record["own"] = found.own_means
    record["charge"] = np.nan if charge_bar is None else charge_bar
    record["outside"] = found.reference.verdict in OUTSIDE
    record["reference"], record["figures"] = np.nan, np.nan
    if found.reference.is_told:
        interval = found.reference.interval
        half = np.nan if interval is None else interval.half_width
        leakage = found.reference.leakage_l_per_min
        record["reference"] = leakage, leakage - half, leakage + half
    for place in range(len(record["figures"])):
        judgement = found.identification.coefficients[place]
        if judgement.verdict == "identified" and judgement.interval is not None:
            half = judgement.interval.half_width
            record["figures"][place] = theta[place], theta[place] - half, theta[place] + half


def _words(found: BlockFit) -> NightWords:
    """Why figures of a fit do not count."""
    reference = found.reference
    trusted = reference.is_told
    return NightWords(
        "",
        "" if trusted else reference.reason or reference.verdict.replace("_", " "),
        tuple(
            "" if one.verdict == "identified" else one.reason or one.verdict.replace("_", " ")
            for one in found.identification.coefficients
        ),
    )


def _together(words: NightWords, more: str) -> NightWords:
    """The words of a night that says nothing with others either."""

    def joined(one: str) -> str:
        return f"{one}; {more}"

    return NightWords(
        joined(words.status),
        joined(words.reference),
        tuple(joined(one) for one in words.coefficients),
    )


def _last_known(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(known[-1]) if len(known) else None
