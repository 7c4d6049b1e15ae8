"""Formats of time stamps, as `logs.time_format` names them."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated

from pydantic import AfterValidator

if TYPE_CHECKING:
    import polars as pl

EPOCH_UNITS = {"epoch_s": 1_000_000, "epoch_ms": 1_000, "epoch_us": 1, "epoch_ns": 1}
"""Microseconds in a unit of each epoch format (`epoch_ns` is divided by 1000 instead)."""

EXCEL_DAYS = "excel_days"
"""Days since 30 December 1899, a local time; kept to the millisecond, as spreadsheets keep it."""

_DIRECTIVES = frozenset("YymdHIMSfzpbBj%")


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
    fraction = "%f" not in time_format or re.search(r"[.,]%f", time_format)
    if not (day and hour and fraction):
        raise ValueError(
            f"time format {time_format!r} names no full day, hour and minute, or has %f without "
            "'.' or ',' before it"
        )
    import polars as pl

    try:
        parsed(pl.Series(["?"]), time_format)
    except pl.exceptions.PolarsError as error:
        raise ValueError(f"time format {time_format!r}: {error}") from error
    return time_format


TimeFormat = Annotated[str, AfterValidator(require_time_format)]


def parsed(texts: pl.Series, time_format: str) -> pl.Series:
    """Time stamps [µs] of text in a format of `time.strptime`; null where it does not fit."""
    # In the words of this parser %f stands for the dot as well, and only %#z knows "Z".
    dotted = time_format.replace(",", ".") if ",%f" in time_format else time_format
    its_format = dotted.replace(".%f", "%.f").replace("%z", "%#z")
    return texts.str.strip_chars().str.to_datetime(
        its_format, time_unit="us", strict=False, exact=True
    )
