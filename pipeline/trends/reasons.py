"""Why an indicator is in the state it is in, in plain words with figures and intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from leakage.attribution import Attribution
from leakage.monitoring import change_size
from pipeline.trends.indicators import DEVIATION, OWN_REFERENCE, REFERENCE
from pipeline.trends.night_records import FLUSHING
from pipeline.trends.standing import CHANGED, RAISED, Standing
from pipeline.trends.words import moved_words, path_words, size_words

# Good nights that say how far another indicator moved.
NIGHTS_OF_NOW = 10
COMMON_CAUSE = (
    "the other motors of the oil circuit moved alike: oil, temperature or charge pressure, not "
    "this motor"
)


def why_state(standing: Standing, name: str, place: int, path: Attribution | None) -> str:
    """Why an indicator with a baseline is not ok in a night; a sensor that drifts comes first."""
    state = standing.states[name][place]
    watched = standing.watched[name]
    segment, found, _ = watched.at(place)
    inside = place - segment.first
    if state == "stale":
        nights = int(found.own.since_good[inside])
        return f"no trusted figure for {nights} nights: {watched.indicator.gated[place]}"
    parts = [sensors_words(standing, place)]
    sudden = standing.sudden_at(place)
    told = found.own.severity[inside] > 0 or found.own.limit_severity[inside] > 0
    if told:
        parts.append(_size(standing, name, place))
    if state in RAISED and told:
        parts += _moved_with_it(standing, name, place)
        parts.append(path_words(path))
    if sudden is not None and (told or name == DEVIATION):
        parts.append(sudden.words)
    if state == "common_cause" and told:
        parts += [path_words(path), COMMON_CAUSE]
    return "; ".join(part for part in parts if part)


def why_no_baseline(standing: Standing, name: str, place: int) -> str:
    """What is missing for a baseline."""
    watched = standing.watched[name]
    segment, _, _ = watched.at(place)
    told = watched.indicator.told[segment.first : place + 1]
    counts = np.isfinite(watched.series[segment.first : place + 1])
    if not told.any() and name in (DEVIATION, OWN_REFERENCE):
        counts = standing.history.fitted[segment.first : place + 1]
    good, needed = int(counts.sum()), watched.settings.baseline.provisional_nights
    if good >= needed:
        return f"the mean of {needed} good nights is not above 0: nothing to be relative to"
    parts = [f"{good} of {needed} good nights for a baseline ({segment.reason})"]
    sudden = standing.sudden_at(place)
    return "; ".join(parts if sudden is None else [*parts, sudden.words])


def sensors_words(standing: Standing, place: int) -> str:
    """Which sensor has drifted, and how far; empty where none has."""
    return "; ".join(words for zero in standing.zeros.values() if (words := zero.words(place)))


def way_of(standing: Standing, name: str, place: int) -> str:
    """The way into a warning or an alarm: level, change, both or jump."""
    watched = standing.watched[name]
    segment, found, _ = watched.at(place)
    inside = place - segment.first
    own = found.own
    if not own.severity[inside] and not own.limit_severity[inside]:
        return "jump"
    by_sum = bool(own.onset[inside] >= 0)
    by_level = bool(own.deviation[inside] >= watched.settings.levels.warning)
    by_level |= bool(own.limit_severity[inside])
    return "both" if by_sum and by_level else "change" if by_sum else "level"


def _size(standing: Standing, name: str, place: int) -> str:
    """How far the indicator has risen, since when."""
    watched, history = standing.watched[name], standing.history
    segment, found, _ = watched.at(place)
    here = slice(segment.first, place + 1)
    inside = place - segment.first
    nights, series = history.numbers[here], watched.series[here]
    size = change_size(nights, series, found.own, inside)
    if size is None:
        # A step that the levels tell before the sum does: the nights that they count.
        good = np.flatnonzero(np.isfinite(series))
        first = good[-watched.settings.levels.on_nights :][:1]
        onset = np.full(len(found.own.onset), -1, dtype=np.int64)
        onset[inside] = first[0] if len(first) else -1
        size = change_size(nights, series, replace(found.own, onset=onset), inside)
    since = None if size is None else standing.label(history.place_of(size.since_night))
    recent = found.own.deviation[: inside + 1]
    recent = recent[np.isfinite(recent)]
    percent = 100.0 * float(recent[-1]) if len(recent) else 0.0
    return size_words(name, percent, size, since)


def _moved_with_it(standing: Standing, name: str, place: int) -> list[str]:
    """How far the reference leakage moved with another indicator, and the flushing if it did."""
    begin = standing.earliest_onset(place)
    words = []
    for other in (REFERENCE, OWN_REFERENCE):
        if other == name:
            break
        percent = _mean_rise(standing, other, begin, place)
        if percent is not None:
            words.append(moved_words(other, percent))
            break
    flushing = standing.states.get(FLUSHING)
    if name == DEVIATION and flushing is not None and flushing[place] in CHANGED:
        percent = _mean_rise(standing, FLUSHING, begin, place)
        words += [] if percent is None else [moved_words(FLUSHING, percent)]
    return words


def _mean_rise(standing: Standing, name: str, begin: int, place: int) -> float | None:
    """Mean deviation of an indicator from its baseline since a night, in %; None where unknown."""
    segment, found, baseline = standing.watched[name].at(place)
    if baseline is None:
        return None
    recent = found.own.deviation[max(begin - segment.first, 0) : place - segment.first + 1]
    recent = recent[np.isfinite(recent)][-NIGHTS_OF_NOW:]
    return 100.0 * float(np.mean(recent)) if len(recent) else None
