"""Base of the tables of config files, and types that several of them use."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from typing import Annotated, Any, Self
from zoneinfo import ZoneInfo

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from pipeline.config.faults import Misfit, refuse


def _known_zone(name: str) -> str:
    with suppress(KeyError, ValueError, OSError):
        ZoneInfo(name)
        # The folders `posix` and `right` hold all zones again, `right` with leap seconds.
        if not name.startswith(("posix", "right")):
            return name
    raise ValueError("expected the name of an IANA time zone, such as Europe/Oslo")


Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(gt=0, le=1)]
TimeZone = Annotated[str, AfterValidator(_known_zone)]
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

    def misfits(self) -> Iterable[Misfit]:
        """Keys that do not go together."""
        return ()

    @model_validator(mode="after")
    def _goes_together(self) -> Self:
        refuse(self.misfits())
        return self


def left_out() -> Any:
    """Default of a table that a file may leave out: its keys have theirs."""
    return Field({}, validate_default=True)
