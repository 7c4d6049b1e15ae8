"""Why an indicator is in the state it is in, in plain words with figures and intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from leakage.attribution import Attribution
from leakage.monitoring import NIGHTS_OF_SIZE, Track, change_size, weights_of_now
from pipeline.trends.indicators import DEVIATION, OWN_REFERENCE, REFERENCE
from pipeline.trends.night_records import FLUSHING
from pipeline.trends.standing import CHANGED, RAISED, Standing
from pipeline.trends.words import limit_words, moved_words, path_words, size_words

Array = NDArray[np.float64]

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
    if found.own.limit_severity[inside]:
        parts.append(_beyond_limit(standing, name, place))
    if found.own.severity[inside]:
        parts.append(_size(standing, name, place))
    if state in RAISED and told:
        parts += _moved_with_it(standing, name, place)
        parts.append(_circuit(standing, name, place))
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
    warning, _ = standing.levels(name, place)
    by_level = bool(own.deviation[inside] >= warning) or bool(own.limit_severity[inside])
    return "both" if by_sum and by_level else "change" if by_sum else "level"


def _size(standing: Standing, name: str, place: int) -> str:
    """How far the indicator has risen, since when."""
    watched, history = standing.watched[name], standing.history
    segment, found, _ = watched.at(place)
    here = slice(segment.first, place + 1)
    inside = place - segment.first
    nights, series = history.numbers[here], watched.series[here]
    own = found.own
    if own.onset[inside] < 0:
        own = replace(own, onset=_onset_by_level(own, inside, watched.settings.levels.on_nights))
    size = change_size(nights, series, own, inside)
    since = None if size is None else standing.label(history.place_of(size.since_night))
    return size_words(name, 100.0 * _latest(own.deviation[: inside + 1]), size, since)


def _onset_by_level(own: Track, inside: int, needed: int) -> NDArray[np.int64]:
    """Where a step began that the levels tell and the sum does not: the nights that they count."""
    off = np.flatnonzero(own.severity[: inside + 1] == 0)
    went_on = int(off[-1]) + 1 if len(off) else 0
    good = np.flatnonzero(np.isfinite(own.deviation[: went_on + 1]))
    onset = np.full(len(own.onset), -1, dtype=np.int64)
    onset[inside] = good[-needed:][0] if len(good) else -1
    return onset


def _beyond_limit(standing: Standing, name: str, place: int) -> str:
    """That an indicator lies above a limit of its motor type."""
    watched = standing.watched[name]
    segment, found, _ = watched.at(place)
    value = _latest(watched.series[segment.first : place + 1]) - watched.indicator.shift
    limits = watched.settings.limits
    is_alarm = found.own.limit_severity[place - segment.first] > 1
    limit = limits.alarm if is_alarm else limits.warning
    return limit_words(name, value, float(limit or 0.0), watched.indicator.unit)


def _circuit(standing: Standing, name: str, place: int) -> str:
    """How far the other motors of the oil circuit have moved as well; empty where they have not."""
    moved = standing.circuit_moved(name, place)
    if moved is None:
        return ""
    return f"the other motors of the oil circuit {100 * moved:+.0f} %, which is taken off"


def _latest(values: Array) -> float:
    """The last value that there is; 0 without one."""
    known = values[np.isfinite(values)]
    return float(known[-1]) if len(known) else 0.0


def _moved_with_it(standing: Standing, name: str, place: int) -> list[str]:
    """How far the reference leakage moved with another indicator, and the flushing if it did."""
    begin = standing.earliest_onset(place)
    words = []
    for other in (REFERENCE, OWN_REFERENCE):
        if other == name:
            break
        percent = _rise_now(standing, other, begin, place)
        if percent is not None:
            words.append(moved_words(other, percent))
            break
    flushing = standing.states.get(FLUSHING)
    if name == DEVIATION and flushing is not None and flushing[place] in CHANGED:
        percent = _rise_now(standing, FLUSHING, begin, place)
        words += [] if percent is None else [moved_words(FLUSHING, percent)]
    return words


def _rise_now(standing: Standing, name: str, begin: int, place: int) -> float | None:
    """Deviation of an indicator from its baseline now, by the nights since one; None if unknown."""
    segment, found, _ = standing.watched[name].at(place)
    first = max(begin - segment.first, 0)
    deviation = found.own.deviation[first : place - segment.first + 1]
    good = np.flatnonzero(np.isfinite(deviation))[-NIGHTS_OF_SIZE:]
    if not len(good):
        return None
    nights = standing.history.numbers[segment.first + first + good]
    return 100.0 * float(weights_of_now(nights) @ deviation[good])
