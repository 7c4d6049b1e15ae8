"""Faults of config files, in a reader's words: file, key, what stands there, what was expected."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from pydantic import ValidationError
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError

from pipeline.errors import MotorLeakageError, one_line
from pipeline.messages import counted

# Stands in the place of a fault for a key itself.
KEY_MARK = "[key]"
LONGEST_QUOTE = 80
# Keys whose values may hold a secret: nothing of them is quoted.
UNQUOTED = frozenset({"webhook_url", "webhook_headers", "webhook_secret", "password", "connection"})
OPENINGS = {
    "Input should be ": "expected ",
    "String should match pattern ": "expected text that matches ",
    "Tuple should have ": "expected ",
    "String should have ": "expected ",
    "Value error, ": "",
}

Place = tuple[str | int, ...]
Misfit = tuple[Place, str, object]
"""Key within a table, what was expected, and what stands there."""


# Keys of earlier versions, and what is said of them.
ONE_WATCH = "is gone: one test watches the whole flow of a motor"
GONE = {
    "trend.provisional_nights": f"{ONE_WATCH}, from its baseline_nights on; delete it",
    "trend.false_discovery_rate": f"{ONE_WATCH}, and slopes are shown only; delete it",
    "alarms.warning_percent": f"{ONE_WATCH}, and any change that it tells is a warning; delete it",
    "alarms.on_nights": f"{ONE_WATCH}, at alarms.false_alarms_per_year; delete it",
    "alarms.off_nights": f"{ONE_WATCH}, until the flow is back where it was; delete it",
    "alarms.deadband_percent": f"{ONE_WATCH}, until the flow is back where it was; delete it",
    "estimation.gradient_type": "is gone: the audit takes differences; delete it",
    "estimation.search_every_nights": "is gone: `fit` alone searches; delete it",
    "estimation.bootstrap_resamples": "is gone: intervals are those of the blocks; delete it",
}


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
    place = _in_file(detail["loc"], document)
    kind = detail["type"]
    if kind.startswith("union_tag"):
        place.append("law")
    key = (prefix + _key(place, document)).rstrip(".")
    if kind in ("missing", "union_tag_not_found"):
        return Fault(file, key, "is missing")
    if kind == "extra_forbidden":
        gone = next((why for one, why in GONE.items() if key.endswith(one)), None)
        return Fault(file, key, gone or "is no key of this table; check its spelling")
    if kind == "union_tag_invalid":
        context = detail["ctx"]
        message = f'got "{context["tag"]}"; expected one of {context["expected_tags"]}'
        return Fault(file, key, message)
    given = "" if UNQUOTED.intersection(detail["loc"]) else _quote(detail["input"])
    return Fault(file, key, given + _expected(detail["msg"]))


def _key(place: Iterable[str | int], document: object) -> str:
    """A place as people find it: ``path "piston_ring" count`` for the table of that name."""
    key, between = "", ""
    for part in place:
        document = _below(document, part)
        name = document.get("name") if isinstance(document, Mapping) else None
        if isinstance(part, int) and isinstance(name, str):
            key, between = f'{key} "{name}"', " "
        else:
            key, between = f"{key}{between}{part}", "."
    return key


def _in_file(place: Iterable[str | int], document: object) -> list[str | int]:
    """A place without what pydantic adds and no file has: marks of a key, the law of a path."""
    found = []
    for part in place:
        if part == KEY_MARK or (part == _below(document, "law") and _below(document, part) is None):
            continue
        found.append(part)
        document = _below(document, part)
    return found


def _below(document: object, part: str | int) -> object:
    if isinstance(document, Mapping):
        return document.get(part)
    is_there = isinstance(document, list) and isinstance(part, int) and part < len(document)
    return document[part] if is_there else None  # type: ignore[index]


def _quote(given: object) -> str:
    """Value in the file, unless there is none, it is long, or may hold a secret."""
    text = json.dumps(given, default=str, ensure_ascii=False)
    long = isinstance(given, Mapping | list | tuple) and len(text) > LONGEST_QUOTE
    secret = isinstance(given, Mapping) and any(f'"{key}"' in text for key in UNQUOTED)
    return "" if given is None or long or secret else f"got {text}; "


def _expected(message: str) -> str:
    for opening, ours in OPENINGS.items():
        if message.startswith(opening):
            return ours + message.removeprefix(opening)
    return message
