"""What a field path leads to, as the schema of a message says, whatever the schema's language."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Protocol

from pipeline.config.field_paths import FieldPath, path_text
from pipeline.errors import LogError
from pipeline.ingest.mcap_payloads import NANOSECONDS, SECONDS

_MOST_NAMES = 40
_DEEPEST = 6


class Place(Protocol):
    """A place in a message: a number, a text, an array, a map or a message."""

    @property
    def number(self) -> str | None:
        """NumPy's name of the type of the number that is here, "?" for a truth value; or None."""

    @property
    def what(self) -> str:
        """What is here, in words."""

    def steps(self) -> Iterable[str | int]:
        """The steps inwards: fields, or an array's first position."""

    def inside(self, step: str | int) -> Place | None:
        """What is one step further inwards; None where that leads nowhere."""


def number_kind(path: Path, topic: str, root: Place, wanted: FieldPath) -> str:
    """NumPy's name of the type of a field.

    Parameters
    ----------
    path, topic
        For messages of errors.
    root
        The message.
    wanted
        The field.

    Raises
    ------
    LogError
        ``log_column_missing`` or ``log_type``: the path leads nowhere, or to no number.
    """
    place = _at(root, wanted)
    if place is None:
        there = ", ".join(repr(path_text(one)) for one in _numbers(root, ())[:_MOST_NAMES])
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


def stamp_parts(root: Place, stamp: FieldPath) -> list[FieldPath]:
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


def _numbers(place: Place, path: FieldPath) -> list[FieldPath]:
    """Paths to the first numbers; a message of Protobuf may hold itself."""
    if place.number is not None:
        return [path]
    found: list[FieldPath] = []
    for step in place.steps() if len(path) < _DEEPEST else ():
        inner = place.inside(step)
        if inner is not None and len(found) < _MOST_NAMES:
            found += _numbers(inner, (*path, step))
    return found
