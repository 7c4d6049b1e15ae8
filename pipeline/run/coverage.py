"""How much of a night its rows were made from: what has less of it replaces nothing."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

Row = Mapping[str, Any]
RowsByTable = Mapping[str, Sequence[Row]]

NO_LOG = "no log covers it any more"
# Refused by these, a row of a log is none of its samples.
NO_SAMPLES = ("missing", "duplicate_time")
# First and last sample that are kept may differ by so much: rules at the ends decide on them, too.
CLOSE = dt.timedelta(minutes=1)


def samples_of(quality: Iterable[Row]) -> int:
    """Return the number of different samples of all channels, by a night's rows of `quality`."""
    logged: dict[str, int] = {}
    absent = 0
    for row in quality:
        if row["channel"] != "time_base":
            # A rule on pairs of samples looks at fewer.
            logged[row["channel"]] = max(logged.get(row["channel"], 0), row["n_samples"])
            absent += row["n_refused"] if row["reason"] in NO_SAMPLES else 0
    return sum(logged.values()) - absent


def why_less(made: RowsByTable, published: RowsByTable) -> str | None:
    """Return why a night is made of less than its published rows, in words; None: it is not."""
    now, before = (samples_of(rows.get("quality", ())) for rows in (made, published))
    if now < before:
        return f"its logs hold {now} samples now, and held {before}" if now else NO_LOG
    (new,), (old,) = made["nights"], published["nights"]
    for name, at, sign in (("first_sample", "begin", -1), ("last_sample", "end", 1)):
        if old[name] is None:
            continue
        if new[name] is None:
            return "no sample of its logs is kept"
        if sign * (old[name] - new[name]) > CLOSE:
            return f"its logs {at} at {new[name]:%H:%M} UTC now, and at {old[name]:%H:%M} before"
    return None
