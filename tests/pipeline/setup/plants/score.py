"""Share of channels that a proposal maps right, maps wrong, or asks for."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from pipeline.setup.propose import propose
from tests.pipeline.setup.plants.plant import ASK, Mapped, Place, Plant

Proposed = Mapping[str, Mapping[str, Place]]
"""Places by motor and channel; what is asked is left out, and a unit that is asked is None."""


def score_of(plant: Plant, folder: Path) -> Counter[str]:
    """Score of what `init` proposes for a plant's files, without an answer."""
    proposed = {
        motor.motor_id: {
            channel: Place(one.column.keys["source"], one.unit, one.quality)
            for channel, one in motor.channels.items()
        }
        for motor in propose(plant.write(folder), {}).motors
    }
    return score(plant, proposed)


def score(plant: Plant, proposed: Proposed) -> Counter[str]:
    """Number of channels that are right, wrong and asked.

    A question is right where the log does not say it. A channel or motor too many is wrong.
    """
    left = dict(proposed)
    counts: Counter[str] = Counter()
    for expected in plant.motors.values():
        best = max(left, key=lambda name: _shared(expected, left[name]), default=None)
        found = {} if best is None or not _shared(expected, left[best]) else left.pop(best)
        counts += _score_motor(expected, found)
    counts["wrong"] += sum(len(channels) for channels in left.values())
    return counts


def _shared(expected: Mapped, found: Mapping[str, Place]) -> int:
    sources = {place.source for place in found.values()}
    return sum(place is not None and place.source in sources for place in expected.values())


def _score_motor(expected: Mapped, found: Mapping[str, Place]) -> Counter[str]:
    counts = Counter({"wrong": len(found.keys() - expected.keys())})
    for name, place in expected.items():
        own = found.get(name)
        if own == place:
            counts["right"] += 1
        elif own is None or (place is not ASK and own == Place(place.source, None, place.quality)):
            counts["asked"] += 1
        else:
            counts["wrong"] += 1
    return counts
