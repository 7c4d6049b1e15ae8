"""Faults of config files, in a reader's words: file, key, what stands there, what was expected."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError

from pipeline.errors import MotorLeakageError, one_line
from pipeline.messages import counted

# Stands in the place of a fault for a key itself.
KEY_MARK = "[key]"
LONGEST_QUOTE = 80
# Keys whose values may hold a secret: nothing of them is quoted.
UNQUOTED = frozenset({"webhook_url", "webhook_headers", "webhook_secret", "password", "connection"})

Place = tuple[str | int, ...]
Misfit = tuple[Place, str, object]
"""Key within a table, what was expected, and what stands there."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing wrong in one config file."""

    file: str
    key: str
    message: str

    def __str__(self) -> str:
        return one_line(": ".join(part for part in (self.file, self.key, self.message) if part))


class ConfigError(MotorLeakageError):
    """Everything that is wrong in a fleet's config, in one error; exit code 2."""

    def __init__(self, faults: Iterable[Fault]) -> None:
        self.faults = tuple(dict.fromkeys(faults))
        lines = "\n".join(f"  {fault}" for fault in self.faults)
        super().__init__("config", f"{counted(len(self.faults), 'config fault')}\n{lines}")


def refuse(found: Iterable[Misfit]) -> None:
    """Let a validator report several faults, each at its own key.

    Raises pydantic.ValidationError if there is any.
    """
    details = [
        InitErrorDetails(
            type=PydanticCustomError("fault", "{message}", {"message": message}),
            loc=place,
            input=given,
        )
        for place, message, given in found
    ]
    if details:
        raise ValidationError.from_exception_data("faults", details)


def faults_of(
    error: ValidationError, file: str, prefix: str = "", document: object = None
) -> list[Fault]:
    """All findings of pydantic's about a file."""
    return [_fault(detail, file, prefix, document) for detail in error.errors()]


def fault_at(file: str, place: Place, message: str, given: object) -> Fault:
    """A fault at a key: what stands there, and what was expected."""
    return Fault(file, ".".join(map(str, place)), _quote(given) + message)


def _fault(detail: ErrorDetails, file: str, prefix: str, document: object) -> Fault:
    place, kind = detail["loc"], detail["type"]
    key = prefix + _key((*place, "law") if kind.startswith("union_tag") else place, document)
    given = "" if UNQUOTED.intersection(place) else _quote(detail["input"])
    message = given + re.sub(r"^\w+ should (be|have|match) ", "expected ", detail["msg"])
    if kind in ("missing", "union_tag_not_found"):
        message = "is missing"
    elif kind == "extra_forbidden":
        message = "is no key of this table; check its spelling, or delete it"
    return Fault(file, key.rstrip("."), message.replace("Value error, ", "", 1))


def _key(place: Place, document: object) -> str:
    """A place as people find it: ``path "piston_ring" count`` for the table of that name.

    Left out is what pydantic adds and no file has: marks of a key, the law of a path.
    """
    key, between = "", ""
    for part in place:
        below = _below(document, part)
        if part == KEY_MARK or (below is None and part == _below(document, "law")):
            continue
        name = _below(below, "name")
        if isinstance(part, int) and isinstance(name, str):
            key, between = f'{key} "{name}"', " "
        else:
            key, between = f"{key}{between}{part}", "."
        document = below
    return key


def _below(document: Any, part: str | int) -> Any:
    try:
        return document[part]
    except (TypeError, LookupError):
        return None


def _quote(given: object) -> str:
    """Value in the file, unless there is none, it is long, or may hold a secret."""
    text = json.dumps(given, default=str, ensure_ascii=False)
    long = isinstance(given, Mapping | list | tuple) and len(text) > LONGEST_QUOTE
    secret = isinstance(given, Mapping) and any(f'"{key}"' in text for key in UNQUOTED)
    return "" if given is None or long or secret else f"got {text}; "
