"""`[defaults]` of the fleet file: what its motors' files have in common."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from pipeline.config.faults import Fault

NAME_MARK = "{name_in_log}"
"""Stands in texts of the defaults for the motor's name as its log writes it."""

Document = Mapping[str, Any]


def completed(own: Document, defaults: Document, name: str) -> dict[str, Any]:
    """A motor's file with the defaults where it says nothing; `name` is the file's.

    Tables are merged key by key; a channel's that names its source or a constant stands alone.

    Examples
    --------
    >>> completed({"oil": "vg46"}, {"oil": "vg68", "logs": {"files": ["{name_in_log}/*"]}}, "W1")
    {'oil': 'vg46', 'logs': {'files': ['W1/*']}}
    """
    named = own.get("name_in_log")
    return _merged(own, _named(defaults, named if isinstance(named, str) and named else name))


def _merged(own: Document, defaults: Document) -> dict[str, Any]:
    found = dict(defaults)
    for key, value in own.items():
        below = defaults.get(key)
        if isinstance(value, Mapping) and isinstance(below, Mapping) and not _is_whole(value):
            found[key] = _merged(value, below)
        else:
            found[key] = value
    return found


def _is_whole(value: Document) -> bool:
    """True for a channel's table that takes nothing from the defaults."""
    return bool({"source", "constant"} & value.keys())


def _named(value: Any, name: str) -> Any:
    """Texts of a table or list with a motor's name in the mark's place."""
    if isinstance(value, Mapping):
        return {key: _named(inner, name) for key, inner in value.items()}
    if isinstance(value, list):
        return [_named(inner, name) for inner in value]
    return value.replace(NAME_MARK, name) if isinstance(value, str) else value


def at_their_place(
    faults: Iterable[Fault], own: Mapping[str, Document], defaults: Document, fleet_file: str
) -> Iterator[Fault]:
    """Faults of motors' files, each told of the fleet file where the defaults have the key.

    `own` are the motors' files as they stand, by the name that faults have for them.
    """
    for fault in faults:
        parts = fault.key.split(".")
        here = _depth(own.get(fault.file, {}), parts)
        is_shared = fault.file in own and _depth(defaults, parts) > here
        yield Fault(fleet_file, f"defaults.{fault.key}", fault.message) if is_shared else fault


def _depth(document: Any, parts: list[str]) -> int:
    """Number of steps of a key that there are."""
    for depth, part in enumerate(parts):
        if not isinstance(document, Mapping) or part not in document:
            return depth
        document = document[part]
        if isinstance(document, Mapping) and _is_whole(document):
            return len(parts)  # what it lacks is not the defaults'
    return len(parts)
