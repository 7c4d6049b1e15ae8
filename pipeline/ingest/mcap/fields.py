"""Places that field paths lead to in a message, whatever the language of its schema."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Protocol

from pipeline.config.field_paths import FieldPath, path_text
from pipeline.errors import LogError
from pipeline.ingest.mcap.payloads import NANOSECONDS, SECONDS

_MOST_NAMES = 40
_DEEPEST = 8
_MOST_PLACES = 2**14


class Place(Protocol):
    """A place in a message: a number, a text, an array, a map or a message."""

    @property
    def number(self) -> str | None:
        """NumPy's name of the type of the number that is here, "?" for a truth value; or None."""

    @property
    def what(self) -> str:
        """The thing that is here, in words."""

    def steps(self) -> Iterable[str | int]:
        """The steps inwards: fields, or an array's first positions."""

    def inside(self, step: str | int) -> Place | None:
        """The place one step further inwards; None where that leads nowhere."""


def wanted_kinds(
    path: Path, topic: str, root: Place, fields: Sequence[FieldPath], stamp: FieldPath | None
) -> tuple[dict[FieldPath, str], list[FieldPath]]:
    """NumPy's names of the types of fields and of a stamp's parts, and these parts.

    Raises
    ------
    LogError
        ``log_column_missing`` or ``log_type``: a path leads nowhere, or to no number.
    """
    parts = [] if stamp is None else _stamp_parts(root, stamp)
    return {one: _number_kind(path, topic, root, one) for one in (*fields, *parts)}, parts


def number_paths(root: Place, most: int) -> list[FieldPath]:
    """Paths to the first numbers; a message of Protobuf may hold itself."""
    found: list[FieldPath] = []
    waiting: list[tuple[Place, FieldPath]] = [(root, ())]
    for _ in range(_MOST_PLACES):
        if not waiting or len(found) == most:
            break
        place, path = waiting.pop()
        if place.number is not None:
            found.append(path)
        elif len(path) < _DEEPEST:
            inner = ((place.inside(step), (*path, step)) for step in place.steps())
            waiting += reversed([(below, at) for below, at in inner if below is not None])
    return found


def _number_kind(path: Path, topic: str, root: Place, wanted: FieldPath) -> str:
    place = _at(root, wanted)
    if place is None:
        there = ", ".join(repr(path_text(one)) for one in number_paths(root, _MOST_NAMES))
        raise LogError(
            "log_column_missing",
            path,
            f"messages of topic {topic!r} have no field {path_text(wanted)!r}; there are {there}",
            topic,
        )
    if place.number is None:
        raise LogError(
            "log_type", path, f"field {path_text(wanted)!r} is no number but {place.what}", topic
        )
    return place.number


def _stamp_parts(root: Place, stamp: FieldPath) -> list[FieldPath]:
    """Paths to the seconds and nanoseconds of a stamp, or to the one number that it is."""
    place = _at(root, stamp)
    names = [] if place is None else list(place.steps())
    seconds = [(*stamp, name) for name in SECONDS if name in names]
    nanoseconds = [(*stamp, name) for name in NANOSECONDS if name in names]
    return [*seconds[:1], *nanoseconds[:1]] if seconds and nanoseconds else [stamp]


def _at(root: Place, path: FieldPath) -> Place | None:
    place: Place | None = root
    for step in path:
        place = None if place is None else place.inside(step)
    return place
