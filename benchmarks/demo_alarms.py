"""The demo fleet's alarms against its truth: what wears, when it was told, and through which path.

`python -m benchmarks demo_alarms` makes the demo and fits it; with `--demo FOLDER` it takes the
demo in a folder, with the tables in `FOLDER/out`.
"""

from __future__ import annotations

import argparse
import datetime as dt
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import polars as pl

from benchmarks.results_file import Part, write_parts

COMMAND = Path(sys.executable).with_name("motor-leakage")
RAISED = ("warning", "alarm")
NONE = "–"

Alarm = dict[str, Any]


def main(options: Sequence[str] = ()) -> None:
    """Measure and write `benchmarks/results/demo_alarms.md`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks demo_alarms")
    parser.add_argument("--demo", type=Path)
    asked: Path | None = parser.parse_args(list(options)).demo
    if asked is not None:
        compare(asked)
        return
    with tempfile.TemporaryDirectory() as folder:
        demo = Path(folder) / "demo"
        for arguments in (["demo", demo], ["fit-fleet", demo / "configs" / "fleet.toml"]):
            subprocess.run([COMMAND, *arguments], check=True, capture_output=True)
        compare(demo)


def compare(demo: Path) -> None:
    """Write the comparison of one demo's alarms with its truth."""
    truth = json.loads((demo / "demo" / "truth.json").read_text("utf-8"))["motors"]
    files = sorted((demo / "out" / "tables" / "alarms").glob("*/*.parquet"))
    alarms = pl.concat(pl.read_parquet(path) for path in files).sort("night", "indicator")
    raised = {
        motor_id: alarms.filter(pl.col("to_state").is_in(RAISED), motor_id=motor_id).to_dicts()
        for motor_id in truth
    }
    write_parts(
        "demo_alarms",
        "The demo fleet's alarms against its truth",
        "Six motors, 75 nights; the logs' simulation left the truth beside them, which the program "
        "never reads. A provisional baseline takes 15 good nights, so the first night that can be "
        "told anything is the 16th.",
        [
            Part(
                "Motor by motor",
                "Nights are counted from the first night of wear, which is night 0. A path is "
                "named *rightly* if it is one that wears, and none other is; where the nights do "
                "not tell the coefficients of the paths, saying so is right. *False*: raised "
                "before the wear began, or of a motor that does not wear.",
                (
                    "motor | truth | first night | first warning | nights | first alarm | "
                    "nights | leakage by then | paths named | path | false"
                ),
                [_row(motor_id, facts, raised[motor_id]) for motor_id, facts in truth.items()],
            ),
            Part(
                "What was said",
                "Every warning and alarm, with its reason as it stands in `alarms`.",
                "motor | night | indicator | state | way | reason",
                [
                    [
                        motor_id,
                        str(one["night"]),
                        one["indicator"],
                        one["to_state"],
                        one["way"],
                        one["reason"],
                    ]
                    for motor_id in truth
                    for one in raised[motor_id]
                ],
            ),
        ],
    )


def _row(motor_id: str, facts: dict[str, Any], raised: list[Alarm]) -> list[str]:
    began = facts["first_night_of_wear"]
    first_night = None if began is None else dt.date.fromisoformat(began)
    true = [one for one in raised if first_night is not None and one["night"] >= first_night]
    named = {path for one in true if one["path"] for path in one["path"].split(" and ")}
    warning = true[0] if true else None
    alarm = next((one for one in true if one["to_state"] == "alarm"), None)
    return [
        motor_id,
        facts["wear"] if facts["worn_paths"] else "healthy",
        NONE if first_night is None else str(first_night),
        *_told(warning, first_night),
        *_told(alarm, first_night),
        _growth(facts, warning),
        ", ".join(sorted(named)) or NONE,
        _verdict(set(facts["worn_paths"]), named, true),
        str(len(raised) - len(true)),
    ]


def _told(one: Alarm | None, first_night: dt.date | None) -> tuple[str, str]:
    """Night and indicator, and how many nights after the first of the wear."""
    if one is None or first_night is None:
        return NONE, NONE
    return f"{one['night']}, {one['indicator']}", str((one["night"] - first_night).days)


def _growth(facts: dict[str, Any], warning: Alarm | None) -> str:
    """True rise of the reference leakage, and of the most worn path, up to the first warning."""
    if warning is None:
        return NONE
    nights = facts["nights"]
    first, then = nights[min(nights)], nights[str(warning["night"])]
    leakage = 100 * (then["reference_leakage_l_per_min"] / first["reference_leakage_l_per_min"] - 1)
    most = max(100 * (then["K_m3"][path] / first["K_m3"][path] - 1) for path in facts["worn_paths"])
    return f"{leakage:+.1f} % (K {most:+.0f} %)"


def _verdict(worn: set[str], named: set[str], raised: list[Alarm]) -> str:
    if not worn:
        return "right: none" if not raised else "wrong"
    if not named:
        told = [one for one in raised if "cannot be told" in one["reason"]]
        return "said that it cannot be told" if told else "not named"
    return "right" if named == worn else "right, in part" if named < worn else "wrong"
