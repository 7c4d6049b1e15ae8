"""How logs are written: names of their formats, forms of their stamps, paths to their fields.

A package gives a reader by an entry point of the group `GROUP`, under the name of its format.
"""

from __future__ import annotations

import re
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Annotated

from pydantic import AfterValidator

if TYPE_CHECKING:
    import polars as pl

GROUP = "motor_leakage.readers"
BUILT_IN = {name: f"pipeline.ingest.{name}:READER" for name in ("csv", "mcap", "parquet")}


def reader_entry(name: str) -> EntryPoint:
    """Return entry point of a format's reader; nothing is imported.

    Raises ValueError if no package has this name, or several have.
    """
    if name in BUILT_IN:
        return EntryPoint(name, BUILT_IN[name], GROUP)
    entries = [entry for entry in installed_readers() if entry.name == name]
    if not entries:
        names = ", ".join((*BUILT_IN, *sorted({entry.name for entry in installed_readers()})))
        raise ValueError(f"expected a format of those that are built in or installed: {names}")
    if len(entries) > 1:
        packages = " and ".join(sorted(map(reader_version, entries)))
        raise ValueError(f"expected a format of one package: {packages} both have a reader of it")
    return entries[0]


def reader_version(entry: EntryPoint) -> str:
    """Return package and version of an installed reader; empty for a built-in."""
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else ""


FormatName = Annotated[str, AfterValidator(lambda name: reader_entry(name).name)]
"""Name of a format that a reader is there for."""


@cache
def installed_readers() -> tuple[EntryPoint, ...]:
    """Return entry points of readers of installed packages."""
    return tuple(entry_points(group=GROUP))


EPOCH_UNITS = {"epoch_s": 1_000_000, "epoch_ms": 1_000, "epoch_us": 1, "epoch_ns": 1}
"""Microseconds in a unit of each epoch format (`epoch_ns` is divided by 1000 instead)."""

EXCEL_DAYS = "excel_days"
"""Days since 30 December 1899, a local time; kept to the millisecond, as spreadsheets keep it."""

_DIRECTIVES = frozenset("YymdHIMSfzpbBjaA%")


def require_time_format(time_format: str) -> str:
    """Return the format, if it has a day, hour and minute, and no directive that is not supported.

    Raises ValueError if it is none of the formats that can be read.
    """
    if time_format in ("iso8601", EXCEL_DAYS, *EPOCH_UNITS):
        return time_format
    directives = re.findall(r"%(.?)", time_format)
    if not set(directives) <= _DIRECTIVES:
        raise ValueError(
            f"time format {time_format!r}: iso8601, {', '.join(EPOCH_UNITS)}, "
            f"{EXCEL_DAYS}, or directives of {' '.join('%' + d for d in sorted(_DIRECTIVES))}"
        )
    has = set(directives).intersection
    day = has("Yy") and (has("j") or (has("mbB") and has("d")))
    hour = has("M") and (has("H") or (has("I") and has("p")))
    fraction = "%f" not in time_format or re.search(r"[.,]%f|%M:%S:%f", time_format)
    if not (day and hour and fraction):
        raise ValueError(
            f"time format {time_format!r} names no full day, hour and minute, or has %f without "
            "'.' or ',' before it, or %M:%S:"
        )
    import polars as pl

    try:
        parse_stamps(pl.Series(["?"]), time_format)
    except pl.exceptions.PolarsError as error:
        raise ValueError(f"time format {time_format!r}: {error}") from error
    return time_format


TimeFormat = Annotated[str, AfterValidator(require_time_format)]


def parse_stamps(texts: pl.Series, time_format: str) -> pl.Series:
    """Return time stamps [µs] of text in a format of `time.strptime`; null if it does not fit."""
    # In the words of this parser %f stands for the dot as well, and only %#z knows "Z".
    dotted = time_format.replace(",", ".") if ",%f" in time_format else time_format
    if "%S:%f" in time_format:
        texts = texts.str.replace(r"(:\d\d:\d\d):", "${1}.")
        dotted = time_format.replace("%S:%f", "%S.%f")
    its_format = dotted.replace(".%f", "%.f").replace("%z", "%#z")
    return texts.str.strip_chars().str.to_datetime(
        its_format, time_unit="us", strict=False, exact=True
    )


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


def path_text(path: FieldPath) -> str:
    """Return a path as it is written in a config."""
    written = [
        f"[{step}]" if isinstance(step, int) else "." + re.sub(r"([\\.\[\]])", r"\\\1", step)
        for step in path
    ]
    return "".join(written).removeprefix(".")
