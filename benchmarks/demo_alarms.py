"""The demo fleet's watch against its truth: what wears, when it was told, and what it is called.

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
RAISED = ("warning", "alarm", "common_cause")
NONE = "–"
TEXT = (
    "Six motors, 75 nights; the logs' simulation left the truth beside them, which the program "
    "never reads."
)

Row = dict[str, Any]


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
        for words in (("demo", demo), ("fit-fleet", demo / "configs" / "fleet.toml")):
            subprocess.run([COMMAND, *map(str, words)], check=True, capture_output=True)
        compare(demo)


def compare(demo: Path) -> None:
    """Write the comparison of what was told of one demo with its truth."""
    truth = json.loads((demo / "demo" / "truth.json").read_text("utf-8"))["motors"]
    files = (demo / "out" / "tables" / "watch").rglob("*.parquet")
    rows = pl.concat(map(pl.read_parquet, sorted(files)), how="diagonal").sort("night")
    nights = {motor_id: rows.filter(motor_id=motor_id).to_dicts() for motor_id in truth}
    each = Part(
        "Motor by motor",
        "Nights are counted from the first night of wear, which is night 0; leakage is the true "
        "rise of the reference leakage when it was told first. Cause, begin and reference leakage "
        "[l/min] are those of the last night. "
        "A name is right if it has the paths that wear and none else. *False*: nights of warning "
        "or alarm before the wear began, or of a motor that does not wear.",
        "motor | truth | first night | told | nights | alarm | nights | leakage by then | cause | "
        "name | since | reference leakage | true | false",
        [_row(motor_id, facts, nights[motor_id]) for motor_id, facts in truth.items()],
    )
    said = Part(
        "What was said",
        "The sentence of each night on which another change was told or the state rose.",
        "motor | night | state | sentence",
        [
            [motor_id, str(one["night"]), one["state"], one["sentence"]]
            for motor_id in truth
            for before, one in zip([{}, *nights[motor_id]], nights[motor_id], strict=False)
            if one["state"] in RAISED
            and (before.get("state"), before.get("told_on")) != (one["state"], one["told_on"])
        ],
    )
    write_parts("demo_alarms", "The demo fleet's watch against its truth", TEXT, [each, said])


def _row(motor_id: str, facts: Row, nights: Sequence[Row]) -> list[str]:
    began = facts["first_night_of_wear"]
    first = dt.date.max if began is None else dt.date.fromisoformat(began)
    raised = [one for one in nights if one["state"] in RAISED]
    true = [one for one in raised if one["night"] >= first]
    alarm = next((one for one in true if one["state"] == "alarm"), None)
    told, last = (true[0] if true else None), nights[-1]
    return [
        motor_id,
        facts["wear"] if facts["worn_paths"] else "healthy",
        began or NONE,
        *_when(told, first),
        *_when(alarm, first),
        _risen(facts, told),
        last["cause"] or NONE,
        _verdict(set(facts["worn_paths"]), last["cause"]),
        f"{last['since']} ({last['since_lower']} to {last['since_upper']})"
        if last["cause"]
        else NONE,
        "{:.3f} ({:.3f} to {:.3f})".format(
            *(last[f"reference_leakage{end}"] for end in ("_l_per_min", "_lower", "_upper"))
        ),
        f"{facts['nights'][str(last['night'])]['reference_leakage_l_per_min']:.3f}",
        str(len(raised) - len(true)),
    ]


def _when(one: Row | None, first: dt.date) -> tuple[str, str]:
    """The night, and how many after the first of the wear."""
    return (NONE, NONE) if one is None else (str(one["night"]), str((one["night"] - first).days))


def _risen(facts: Row, one: Row | None) -> str:
    """True rise of the reference leakage up to a night."""
    if one is None:
        return NONE
    nights, name = facts["nights"], "reference_leakage_l_per_min"
    return f"{100 * (nights[str(one['night'])][name] / nights[min(nights)][name] - 1):+.1f} %"


def _verdict(worn: set[str], cause: str | None) -> str:
    if cause is None:
        return "right: none" if not worn else "none"
    if cause in ("cannot_be_told", "all_gaps", "all_flows") and worn:
        return "said that it cannot be told"
    return "right" if set(cause.split(" and ")) == worn else "wrong"
