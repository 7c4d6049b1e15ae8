"""Base of the tables of config files: types that several use, and what a change makes anew."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from enum import Flag, auto
from functools import cache
from typing import Annotated, Any, ClassVar, Self
from zoneinfo import ZoneInfo

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from pipeline.config.faults import Misfit, refuse


class Stage(Flag):
    """What a change of a setting makes anew; each setting names it in its own place."""

    NOTHING = 0
    READING = auto()  # samples, as a log has them
    BLOCKS = auto()  # statistics of samples; blocks before and after a change never merge
    NIGHT = auto()  # what else is judged by the samples of a night
    SCALE = auto()  # a path's coefficient: figures, and blocks only where the path is fixed
    FIGURES = auto()  # what is fitted to the statistics
    TRENDS = auto()  # states, alarms, and what is told of a motor


def known_zone(name: str) -> str:
    """The name of a time zone. Raises ValueError if there is none of it."""
    with suppress(KeyError, ValueError, OSError):
        ZoneInfo(name)
        # The folders `posix` and `right` hold all zones again, `right` with leap seconds.
        if not name.startswith(("posix", "right")):
            return name
    raise ValueError("expected the name of an IANA time zone, such as Europe/Oslo")


Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(gt=0, le=1)]
Seconds = Annotated[float, Field(ge=0, le=31_536_000)]
TimeZone = Annotated[str, AfterValidator(known_zone)]
Id = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
"""An id that is a file's name, too."""


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

    shapes: ClassVar[Stage | None] = None
    """Stage of the keys that name none; None: that of the key that has this table."""

    def misfits(self) -> Iterable[Misfit]:
        """Keys that do not go together."""
        return ()

    def at(self, key: str, message: str) -> Misfit:
        """A misfit at a key: what was expected, and what stands there."""
        return (key,), message, getattr(self, key)

    @model_validator(mode="after")
    def _goes_together(self) -> Self:
        refuse(self.misfits())
        return self

    @classmethod
    @cache
    def stage_of(cls, key: str, inherited: Stage | None = None) -> Stage | None:
        """The stage that a key names, else its table's, else the one that is inherited."""
        own = (one for one in cls.model_fields[key].metadata if isinstance(one, Stage))
        return next(own, cls.shapes if cls.shapes is not None else inherited)

    def shaping(self, stage: Stage, inherited: Stage | None = None) -> dict[str, Any]:
        """All settings of a stage, by key."""
        return {
            key: found
            for key in type(self).model_fields
            for found in _shaping(getattr(self, key), stage, self.stage_of(key, inherited))
        }


def _shaping(value: Any, stage: Stage, own: Stage | None) -> Iterator[Any]:
    """The value, or what of a table is of the stage; nothing where it is of another."""
    if isinstance(value, Section):
        if found := value.shaping(stage, own):
            yield found
    elif isinstance(value, tuple) and value and isinstance(value[0], Section):
        if any(parts := [one.shaping(stage, own) for one in value]):
            yield parts
    elif isinstance(value, Mapping) and any(isinstance(one, Section) for one in value.values()):
        yield {key: one.shaping(stage, own) for key, one in value.items()}
    elif own and own & stage:
        yield value


def left_out() -> Any:
    """Default of a table that a file may leave out: its keys have theirs."""
    return Field({}, validate_default=True)
