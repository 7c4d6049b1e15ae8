"""Paths to a field within a message: keys, and positions in arrays."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import AfterValidator

FieldPath = tuple[str | int, ...]
"""Keys and array positions, from the message inwards."""

_KEY = r"(?:\\.|[^\\.\[\]])+"
_STEP = re.compile(rf"({_KEY})((?:\[\d{{1,9}}\])*)")
_WHOLE = re.compile(rf"{_STEP.pattern}(?:\.{_STEP.pattern})*", re.DOTALL)


def field_path(field: str, topic: str = "") -> FieldPath:
    r"""Return keys and positions that lead to a field.

    They are written as keys with dots between them and positions, counted from 0, in brackets; a
    dot, bracket or backslash within a key has a backslash before it. A leading slash is dropped,
    and so is the topic of the message where it stands before the path.

    Raises ValueError if it is no path.
    """
    if topic.startswith("/") and field.startswith(topic + "."):
        inner = field[len(topic) + 1 :]
    else:
        inner = field.removeprefix("/")
    if not _WHOLE.fullmatch(inner):
        raise ValueError(
            f"field {field!r} is no path such as 'pressure.a' or 'pressures[0].value'; a dot or "
            "bracket within a key is written with a backslash before it"
        )
    path: list[str | int] = []
    for key, positions in _STEP.findall(inner):
        path.append(re.sub(r"\\(.)", r"\1", key, flags=re.DOTALL))
        path.extend(int(position) for position in re.findall(r"\d+", positions))
    return tuple(path)


def _field_text(text: str) -> str:
    if text:
        field_path(text)
    return text


FieldText = Annotated[str, AfterValidator(_field_text)]
"""A path as it is written in a config; empty: none."""


def path_text(path: FieldPath) -> str:
    """Return a path as it is written in a config."""
    written = [
        f"[{step}]" if isinstance(step, int) else "." + re.sub(r"([\\.\[\]])", r"\\\1", step)
        for step in path
    ]
    return "".join(written).removeprefix(".")
