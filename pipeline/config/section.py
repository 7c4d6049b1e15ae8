"""Base of the tables of config files: types that several use, and what a change makes anew.

Faults are named in a reader's words: file, key, what stands there, what was expected.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from difflib import get_close_matches
from enum import Flag, auto
from functools import cache
from typing import Annotated, Any, ClassVar, Self, get_args
from zoneinfo import ZoneInfo

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    model_validator,
)
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
    """A fault of a config file."""

    file: str
    key: str
    message: str

    def __str__(self) -> str:
        return one_line(": ".join(part for part in (self.file, self.key, self.message) if part))


class ConfigError(MotorLeakageError):
    """Everything that is wrong in a fleet's config, in a single error; exit code 2."""

    def __init__(self, faults: Iterable[Fault]) -> None:
        self.faults = tuple(dict.fromkeys(faults))
        lines = "\n".join(f"  {fault}" for fault in self.faults)
        super().__init__("config", f"{counted(len(self.faults), 'config fault')}\n{lines}")


def fault_at(file: str, place: Place, message: str, given: object) -> Fault:
    """Return a fault at a key: what stands there, and what was expected."""
    return Fault(file, ".".join(map(str, place)), _quote(given) + message)


def fault_of(detail: ErrorDetails, file: str, document: object) -> Fault:
    """Return a finding of pydantic's about a file."""
    place, kind = detail["loc"], detail["type"]
    key = _key((*place, "law") if kind.startswith("union_tag") else place, document)
    given = "" if UNQUOTED.intersection(place) else _quote(detail["input"])
    message = given + re.sub(r"^\w+ should (be|have|match) ", "expected ", detail["msg"])
    if kind in ("missing", "union_tag_not_found"):
        message = "is missing"
    elif kind == "extra_forbidden":
        message = f"is no key of this table; {_meant(str(place[-1]))}, or delete it"
    return Fault(file, key, message.replace("Value error, ", "", 1))


def _meant(key: str) -> str:
    """Return in words the key of any table that is spelled nearly so."""
    models = [Section]
    for model in models:
        models += model.__subclasses__()
    known = {name for model in models for name in model.model_fields}
    if key in known:
        return "move it to the table that it is of"
    near = get_close_matches(key, known, 1)
    return f"check its spelling (did you mean {near[0]}?)" if near else "check its spelling"


def _key(place: Place, document: object) -> str:
    """Return a place as people find it: ``path "piston_ring" count`` for the table of that name.

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
    """Return value in the file, unless there is none, it is long, or may hold a secret."""
    text = json.dumps(given, default=str, ensure_ascii=False)
    long = isinstance(given, Mapping | list | tuple) and len(text) > LONGEST_QUOTE
    secret = isinstance(given, Mapping) and any(f'"{key}"' in text for key in UNQUOTED)
    return "" if given is None or long or secret else f"got {text}; "


# Tables


class Stage(Flag):
    """What a change of a setting makes anew; each setting names it in its own place."""

    NOTHING = 0
    READING = auto()  # samples, as a log has them
    BLOCKS = auto()  # statistics of samples; blocks before and after a change never merge
    NIGHT = auto()  # what else is judged by the samples of a night
    SCALE = auto()  # a path's coefficient: figures, and blocks only where the path is fixed
    FIGURES = auto()  # what is fitted to the statistics
    TRENDS = auto()  # states, alarms, and what is reported of a motor


def known_zone(name: str) -> str:
    """Return the name of a time zone. Raises ValueError if there is none of it."""
    with suppress(KeyError, ValueError, OSError):
        ZoneInfo(name)
        # The folders `posix` and `right` hold all zones again, `right` with leap seconds.
        if not name.startswith(("posix", "right")):
            return name
    raise ValueError("expected the name of an IANA time zone, such as Europe/Oslo")


def _as_the_file(own: str, info: ValidationInfo) -> str:
    stem = (info.context or {}).get("stem", own)
    if own != stem:
        raise ValueError(f'expected "{stem}", as the file')
    return own


def name_of(folder: str) -> AfterValidator:
    """Check of a name of a file in a folder of the fleet, where the context has its names."""

    def known(name: str, info: ValidationInfo) -> str:
        names = (info.context or {}).get(folder)
        if names is not None and name not in names:
            choice = ", ".join(sorted(names)) or "those in its folder, which has none"
            raise ValueError(f"expected one of {choice}")
        return name

    return AfterValidator(known)


Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Seconds = Annotated[float, Field(ge=0, le=31_536_000)]
TimeZone = Annotated[str, AfterValidator(known_zone)]
Id = Annotated[
    str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"), AfterValidator(_as_the_file)
]
"""An id that is its file's name, too."""
OilName = Annotated[str, name_of("oils")]


class Section(BaseModel):
    """A table of a config file: unknown keys, infinities and NaN are errors, nothing is coerced.

    The text below a key is its meaning; ``docs/config.md`` is made from these texts.
    """

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        strict=True,
        allow_inf_nan=False,
        # The validator of a file holds those of its tables: these need none of their own.
        defer_build=True,
    )

    shapes: ClassVar[Stage]
    """Stage of the keys that name none; not there where a table is part of no hash."""

    def misfits(self) -> Iterable[Misfit]:
        """Return keys that do not go together."""
        return ()

    def at(self, key: str, message: str) -> Misfit:
        """Return a misfit at a key: what was expected, and what stands there."""
        return (key,), message, getattr(self, key)

    @model_validator(mode="after")
    def _goes_together(self) -> Self:
        details = [
            InitErrorDetails(
                type=PydanticCustomError("fault", "{words}", {"words": words}),
                loc=place,
                input=given,
            )
            for place, words, given in self.misfits()
        ]
        if details:
            raise ValidationError.from_exception_data("faults", details)
        return self

    @classmethod
    @cache
    def keys_of(cls, stage: Stage) -> Mapping[str, bool]:
        """Return keys that are of a stage, or may hold tables, with whether they are of it.

        A key is of the stage that it names, else of its table's.
        """
        keys = {}
        for key, field in cls.model_fields.items():
            own = next((own for own in field.metadata if isinstance(own, Stage)), cls.shapes)
            if own & stage or _holds_tables(field.annotation):
                keys[key] = bool(own & stage)
        return keys

    def shaping(self, stage: Stage) -> dict[str, Any]:
        """Return all settings of a stage, by key; of tables, the keys that are of it."""
        values: dict[str, Any] = {}
        for key, is_of_it in self.keys_of(stage).items():
            value = getattr(self, key)
            if isinstance(value, Section):
                part = value.shaping(stage)
                values |= {key: part} if part else {}
            elif isinstance(value, tuple) and value and isinstance(value[0], Section):
                parts = [section.shaping(stage) for section in value]
                values |= {key: parts} if any(parts) else {}
            elif isinstance(value, dict) and isinstance(next(iter(value.values()), None), Section):
                values[key] = {name: section.shaping(stage) for name, section in value.items()}
            elif is_of_it:
                values[key] = value
        return values


def _holds_tables(kind: Any) -> bool:
    parts = get_args(kind)
    return any(map(_holds_tables, parts)) or (isinstance(kind, type) and issubclass(kind, Section))


def left_out() -> Any:
    """Return default of a table that a file may leave out: its keys have theirs."""
    return Field({}, validate_default=True)
