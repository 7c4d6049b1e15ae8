"""The path that an indicator's change comes from, as named in `trends` and `alarms`."""

from __future__ import annotations

from leakage.course.hypotheses import Posterior
from pipeline.trends.baselines.duty import duty_words
from pipeline.trends.nights.records import BALANCED, FLUSHING, OUTSIDE
from pipeline.trends.states.standing import CHANGED, Standing


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
