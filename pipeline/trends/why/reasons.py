"""Reasons for an indicator's state, in plain words with figures, and the path that is named."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from leakage.course.alarms import sudden_nights
from leakage.course.hypotheses import Posterior
from leakage.course.monitoring import NIGHTS_OF_SIZE, weights_of_now
from pipeline.trends.baselines.duty import UNCERTAIN, duty_words
from pipeline.trends.figures.indicators import DEVIATION, OWN_REFERENCE, REFERENCE
from pipeline.trends.nights.records import BALANCED, FLUSHING, OUTSIDE
from pipeline.trends.states.standing import CHANGED, RAISED, Standing
from pipeline.trends.states.words import FALL, day, name_of, size_words
from pipeline.trends.why.explanation_words import why_words

Array = NDArray[np.float64]


def why_state(standing: Standing, name: str, place: int, behind: Posterior | None) -> str:
    """Reason why an indicator with a baseline is not ok in a night; drifting sensors first."""
    state = standing.states[name][place]
    watched = standing.watched[name]
    if state == "duty_outside":
        return _outside_words(standing, place)
    if state == "stale":
        nights = int(watched.found.since_good[place])
        return f"no trusted figure for {nights} nights: {why_gated(standing, name, place)}"
    parts = [sensors_words(standing, place)]
    sudden = standing.sudden_at(place)
    has_risen, beyond = watched.found.severity[place] > 0, watched.found.limit_severity[place] > 0
    if beyond:
        parts.append(_beyond_limit(standing, name, place))
    if has_risen:
        parts += _sizes(standing, name, place)
    if state in RAISED and (has_risen or beyond):
        parts += _moved_with_it(standing, name, place)
    if has_risen:
        begin = standing.earliest_onset(place)
        parts.append(_cause(standing, place, begin, behind, watched.indicator.path))
    if sudden is not None and (has_risen or beyond or name == DEVIATION):
        parts.append(sudden.words)
        if not has_risen:
            behind = standing.why.at(place, sudden.place)
            parts.append(_cause(standing, place, sudden.place, behind))
    return "; ".join(part for part in parts if part)


def _cause(
    standing: Standing, place: int, begin: int, found: Posterior | None, own: str = ""
) -> str:
    """Cause of a change since a place, or why none is named; empty if nothing can be said."""
    why = "" if found is None else why_not_named(standing, place, found)
    return why or why_words(standing.history, place, begin, found, own)


def why_gated(standing: Standing, name: str, place: int) -> str:
    """Reason why a night of an indicator does not count; empty where it does."""
    watched = standing.watched[name]
    if not np.isnan(watched.series[place]) or watched.indicator.gated[place]:
        return watched.indicator.gated[place]
    return duty_words(standing.history, standing.era(place), place) or UNCERTAIN


def _outside_words(standing: Standing, place: int) -> str:
    """Duty that the baseline has not seen; where it lasts, the proposal of a new baseline."""
    history, era = standing.history, standing.era(place)
    words = duty_words(history, era, place)
    known = era.segment.first + np.flatnonzero(history.fitted[era.segment.first : place + 1])
    inside = known[~standing.is_outside[known]]
    since = known[known > inside[-1]]
    if len(since) < history.spec.settings.alarms.stale_after_nights:
        return words
    return (
        f"{words}; so for {len(since)} nights: if this duty is to stay, begin a new baseline from "
        f"{standing.label(int(since[0]))} (`motor-leakage baseline reset`)"
    )


def good_nights(standing: Standing, name: str, place: int) -> tuple[int, int]:
    """Good nights towards an indicator's first baseline, and how many it needs."""
    watched = standing.watched[name]
    here = slice(watched.segment(place).first, place + 1)
    counts = np.isfinite(watched.series[here])
    if not watched.indicator.told[here].any() and name in (DEVIATION, OWN_REFERENCE):
        counts = standing.history.fitted[here]
    return int(counts.sum()), watched.settings.baseline.provisional_nights


def why_no_baseline(standing: Standing, name: str, place: int) -> str:
    """Reason why there is no baseline yet, with the good nights so far."""
    good, needed = good_nights(standing, name, place)
    if good >= needed:
        return f"the mean of {needed} good nights is not above 0: nothing to be relative to"
    begins = standing.watched[name].segment(place).reason
    parts = [f"{good} of {needed} good nights for a baseline ({begins})"]
    sudden = standing.sudden_at(place)
    return "; ".join(parts if sudden is None else [*parts, sudden.words])


def sensors_words(standing: Standing, place: int) -> str:
    """Sensors that have drifted, and their drift, in words; empty if none has."""
    told = [one.words(place) for one in standing.zeros.values()]
    return "; ".join(words for words in (*told, standing.temperature.words(place)) if words)


def way_of(standing: Standing, name: str, place: int) -> str:
    """The way into a warning or an alarm: level, change, both, sudden or jump."""
    watched = standing.watched[name]
    found = watched.found
    if not found.severity[place] and not found.limit_severity[place]:
        return "jump"
    levels, sd = watched.settings.levels, standing.relative_sd(name, place)
    if sudden_nights(found.deviation[watched.segment(place).first : place + 1], sd, levels)[-1]:
        return "sudden"
    by_sum = bool(found.onset[place] >= 0)
    warning, _ = levels.in_effect(sd)
    by_level = bool(found.deviation[place] >= warning) or bool(found.limit_severity[place])
    return "both" if by_sum and by_level else "change" if by_sum else "level"


def _sizes(standing: Standing, name: str, place: int) -> list[str]:
    """Rise of an indicator and its date, in words, and of every other path in the same state."""
    state = standing.states[name][place]
    others = [
        one
        for one, watched in standing.watched.items()
        if one != name and watched.indicator.path and standing.states[one][place] == state
    ]
    sizes = {
        one: size
        for one in [name, *(others if state in RAISED else [])]
        if (size := standing.rise(one, place)) is not None
    }
    words = [
        size_words(one, size, standing.label(standing.history.place_of(size.since_night)))
        for one, size in sorted(
            sizes.items(), key=lambda item: (item[0] != name, -item[1].relative)
        )
    ]
    has_fallen = any(size.relative <= 0.0 for size in sizes.values())
    return [*words, FALL] if has_fallen and standing.sudden_at(place) is None else words


def _beyond_limit(standing: Standing, name: str, place: int) -> str:
    """That an indicator lies above a limit of its motor type."""
    watched = standing.watched[name]
    values = watched.series[watched.segment(place).first : place + 1]
    known = values[np.isfinite(values)]
    value = (float(known[-1]) if len(known) else 0.0) - watched.indicator.shift
    limits, unit = watched.settings.limits, watched.indicator.unit
    limit = limits.alarm if watched.found.limit_severity[place] > 1 else limits.warning
    told = f"{name_of(name)} {value:.3g} {unit}"
    return f"{told}, and the limit of the motor type is {limit:g} {unit}"


def _moved_with_it(standing: Standing, name: str, place: int) -> list[str]:
    """Change of the reference leakage with an indicator, and of the flushing if it changed."""
    references = {REFERENCE: (), OWN_REFERENCE: (REFERENCE,)}.get(name, (REFERENCE, OWN_REFERENCE))
    told = [_moved(standing, one, name, place) for one in references]
    # The first that is known now, else the first that ever was.
    words = [max(told, key=lambda one: one[0])[1]] if told else []
    flushing = standing.states.get(FLUSHING)
    if name == DEVIATION and flushing is not None and flushing[place] in CHANGED:
        words.append(_moved(standing, FLUSHING, name, place)[1])
    return words


def _moved(standing: Standing, other: str, name: str, place: int) -> tuple[int, str]:
    """Rank and words of how another indicator changed since the change of one.

    Rank 2: known in nights since that change, the last of them recent. Rank 1: known only before,
    or not recently. Rank 0: never known.
    """
    watched, history = standing.watched[other], standing.history
    first, deviation = watched.segment(place).first, watched.found.deviation
    known = first + np.flatnonzero(np.isfinite(deviation[first : place + 1]))
    if not len(known):
        return 0, ""
    last, begin = int(known[-1]), standing.change_start(name, place) or 0
    silent = history.numbers[place] - history.numbers[last]
    if last < begin or silent > watched.settings.stale_nights:
        return 1, f"{name_of(other)} not known since {day(standing.label(last))}"
    now = known[known >= begin][-NIGHTS_OF_SIZE:]
    weights = weights_of_now(history.numbers[now])
    percent = 100.0 * float(weights @ deviation[now])
    told = "unchanged" if abs(percent) < 0.5 else f"{percent:+.0f} %"
    return 2, f"{name_of(other)} {told}"


def path_behind(standing: Standing, name: str, place: int) -> Posterior | None:
    """Explanation of the change that an indicator reports as a rise.

    None without a reported rise or after a fall, for the sensors' zeros, and if the cause cannot be
    determined; for the flushing, unless the gaps moved against it.
    """
    if name in standing.by_own_rules or standing.has_fallen(name, place):
        return None
    if standing.told[name][place] not in CHANGED:
        return None
    found = standing.explained(place)
    return None if name == FLUSHING and not (found and found.taken_back) else found


def why_not_named(standing: Standing, place: int, found: Posterior) -> str:
    """Reason why no path may be named in a night, in words; empty where one may.

    Duty first, then a common change, then the model.
    """
    duty = standing.history.records["duty"][place]
    if duty == OUTSIDE:
        return duty_words(standing.history, standing.era(place), place)
    if found.verdict == "common" or found.taken_back:
        return ""
    if standing.model.state[place] == "warning" and not _is_of_factor(standing, place, found):
        return f"no path is named: {standing.model.words(place)}"
    if duty != BALANCED:
        return ""
    elsewhere = "at another duty than the baseline's"
    if words := standing.model.words(place):
        return f"no path is named {elsewhere}: {words}"
    raised = {
        one.indicator.path
        for name, one in standing.watched.items()
        if standing.told[name][place] in CHANGED
    }
    if set(found.named) - raised:
        return f"which path cannot be told {elsewhere}"
    return ""


def _is_of_factor(standing: Standing, place: int, found: Posterior) -> bool:
    """True if a common factor explains the model's misfit: the rollers are held as stated in it."""
    misfit = standing.model.at(place)
    return found.is_common and misfit is not None and misfit.kinds == ("speed",)


def path_named(standing: Standing, name: str, place: int, found: Posterior | None) -> str | None:
    """The paths behind a state; None where none can be named.

    A loss factor speaks for its own path alone.
    """
    if found is None or why_not_named(standing, place, found):
        return None
    own = standing.watched[name].indicator.path
    named = [one for one in found.named if not own or one == own]
    return " and ".join(named) or None
