"""The path that an indicator's change comes from, as named in `trends` and `alarms`."""

from __future__ import annotations

from leakage.hypotheses import Posterior
from pipeline.trends.night_records import FLUSHING
from pipeline.trends.standing import CHANGED, Standing


def path_behind(standing: Standing, name: str, place: int) -> Posterior | None:
    """Explanation of the change that an indicator reports as a rise.

    None without a reported rise or after a fall, for the flushing and the sensors' zeros, and if
    the cause cannot be determined.
    """
    if name == FLUSHING or name not in standing.watched or standing.has_fallen(name, place):
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
