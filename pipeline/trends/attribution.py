"""Which path an indicator's change comes from, as `trends` and `alarms` name it."""

from __future__ import annotations

from leakage.hypotheses import Posterior
from pipeline.trends.night_records import FLUSHING
from pipeline.trends.standing import CHANGED, Standing


def path_behind(standing: Standing, name: str, place: int) -> Posterior | None:
    """Why the flows changed, of which an indicator tells a rise.

    None where it tells none, a fall, or a flow that no path leaks, and where nobody can say.
    """
    if name == FLUSHING or name in standing.zeros or standing.has_fallen(name, place):
        return None
    if standing.told[name][place] not in CHANGED:
        return None
    return standing.explained(place)


def path_named(standing: Standing, name: str, found: Posterior | None) -> str | None:
    """The paths behind a state; None where none can be named.

    A loss factor speaks for its own path alone.
    """
    if found is None:
        return None
    own = standing.watched[name].indicator.path
    named = [one for one in found.named if not own or one == own]
    return " and ".join(named) or None
