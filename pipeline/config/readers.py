"""Names of the formats that logs can have: the built-in ones, and those of installed packages.

A package gives a reader by an entry point of the group `GROUP`, under the name of its format.
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Annotated

from pydantic import AfterValidator

GROUP = "motor_leakage.readers"
BUILT_IN = {name: f"pipeline.ingest.{name}:READER" for name in ("csv", "mcap", "parquet")}


def reader_entry(name: str) -> EntryPoint:
    """Return entry point of a format's reader; nothing is imported.

    Raises ValueError if no package has this name, or several have.
    """
    if name in BUILT_IN:
        return EntryPoint(name, BUILT_IN[name], GROUP)
    found = [entry for entry in installed() if entry.name == name]
    if not found:
        names = ", ".join((*BUILT_IN, *sorted({entry.name for entry in installed()})))
        raise ValueError(f"expected one of the formats that are built in or installed: {names}")
    if len(found) > 1:
        packages = " and ".join(sorted(map(reader_version, found)))
        raise ValueError(f"expected a format of one package: {packages} both have a reader of it")
    return found[0]


def reader_version(entry: EntryPoint) -> str:
    """Return package and version of an installed reader; empty for a built-in one."""
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else ""


FormatName = Annotated[str, AfterValidator(lambda name: reader_entry(name).name)]
"""Name of a format that a reader is there for."""


@cache
def installed() -> tuple[EntryPoint, ...]:
    """Return entry points of readers of installed packages."""
    return tuple(entry_points(group=GROUP))
