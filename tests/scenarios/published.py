"""Published tables by the names of the design; what is called otherwise today stands here alone.

Issue 47 gives the tables the design's names: this file is then a plain `read_parquet`.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Final

import polars as pl

Row = dict[str, Any]

# By the design's table, today's.
TABLES: Final = {
    "blocks": "block_statistics",
    "intraday": "looks",
    "log_files": "input_files",
    "run_motors": "motor_outcomes",
    "error_budget": "sensitivities",
}
# By the design's column, today's: shares become percent.
PERCENT: Final = {
    "leakage_change_percent": "tonight_change",
    "mean_change_percent": "present_change",
    "gap_change_percent": "gap_growth",
}
PERCENT_ALONE: Final = {
    "detection_limit_percent": "smallest_change",
    "model_error_percent": "lack_of_fit",
    "kept_percent": "kept_share",
    "reversed_percent": "share_reversed",
}
NAMES: Final = {
    "onset": "since",
    "onset_earliest": "since_lower",
    "onset_latest": "since_upper",
    "detected_on": "told_on",
    "still_rising": "goes_on",
    "mean_drain_flow_l_per_min": "mean_flow_l_per_min",
    "leakage_change_percent": "deviation_percent",  # of `alarms` alone: before PERCENT
    "first_sample": "window_start",
    "last_sample": "window_end",
}


def table(output: Path, name: str) -> pl.DataFrame:
    """A published table; without rows where nothing is published of it."""
    if name == "nights":
        return _nights(output)
    return _renamed(_read(output, TABLES.get(name, name)))


def _nights(output: Path) -> pl.DataFrame:
    rows, key = _read(output, "fits"), ["motor_id", "night"]
    if not rows.height:
        return rows
    rows = rows.filter("is_primary")
    for other in (_read(output, "watch"), _read(output, "operation")):
        if other.height:
            twice = [name for name in other.columns if name in rows.columns and name not in key]
            # The motor's own conditions and leakage are those of the watch, not of the night's fit.
            rows = rows.drop(twice).join(other, key, "left")
    return _renamed(rows).sort(key)


def _read(output: Path, name: str) -> pl.DataFrame:
    files = sorted((output / "tables" / name).rglob("*.parquet"))
    if not files:
        return pl.DataFrame()
    return pl.concat([pl.read_parquet(file) for file in files], how="diagonal")


def _renamed(rows: pl.DataFrame) -> pl.DataFrame:
    have = set(rows.columns)
    if "candidates" in have and rows.schema["candidates"] == pl.String:
        rows = rows.with_columns(pl.Series("candidates", map(_candidates, rows["candidates"])))
    percent = dict(PERCENT_ALONE)
    for new, old in PERCENT.items():
        percent |= {new: old, **{f"{new[:-8]}_{end}": f"{old}_{end}" for end in ("lower", "upper")}}
    for new, old in percent.items():
        if old in have:
            rows = rows.with_columns((100.0 * pl.col(old)).alias(new))
    return rows.rename(
        {old: new for new, old in NAMES.items() if old in have and new not in rows.columns}
    )


def _candidates(text: str | None) -> list[dict[str, Any]] | None:
    """Causes with their probability."""
    if text is None:
        return None
    pairs = re.findall(r"([^;]+?) ([0-9.]+)(?:; |$)", text)
    return [{"cause": cause, "probability": float(probability)} for cause, probability in pairs]
