"""How long a fleet's first night takes, beside just reading the same logs.

Whole processes from outside: `fit-fleet` on a fleet of which nothing is known yet, everything
included, beside two fresh processes that read the same files into columns with the fastest reader
there is, each half of them. Cases take turns, and a ratio is one of medians of one run; absolute
times are of the machine that it ran on. Logs come from the page cache on both sides.

`--only PART,PART` measures some of the parts, `--repeats N` as many passes. The other parts stay as
they were stored (`speed.json`); some of these were measured once.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from benchmarks.day_fleets import DAY_MINUTES, MOTORS, add_nights, logs_of, make_fleet, write_day
from benchmarks.results_file import Part, store, stored, write_parts
from benchmarks.whole_runs import (
    Cost,
    elapsed,
    first_night,
    fit_command,
    interleaved,
    reading,
    worker_peak_mib,
)

READERS = {"parquet": "pyarrow_parquet", "csv": "pyarrow_csv", "mcap": "plain_mcap"}
GOALS = {"parquet": 9.0, "csv": 4.0, "mcap": 1.4}
# Motors of `motor_day` and of `hundred`, and the most passes over the hundred.
MORE, HUNDRED, HUNDRED_REPEATS = 12, 100, 3
SMALL_MINUTES, SMALL_NIGHTS = 20.0, 840
BARE = "import numpy, polars, pyarrow, scipy.special, pydantic"


def main(options: Sequence[str] = ()) -> None:
    """Measure, and write `benchmarks/results/speed.md`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks speed")
    parser.add_argument("--only", default=",".join(PARTS), help=f"of {', '.join(PARTS)}")
    parser.add_argument("--repeats", type=int, default=5)
    asked = parser.parse_args(list(options))
    for name in asked.only.split(","):
        load = os.getloadavg()[0]
        with tempfile.TemporaryDirectory() as folder:
            part = PARTS[name](Path(folder), asked.repeats)
        words = f"{part.text} Load before it began: {load:.1f}."
        store("speed", name, asdict(replace(part, text=words)))
    parts = [Part(**one) for one in stored("speed").values()]
    write_parts("speed", "As fast as reading the logs", __doc__ or "", parts)


def motor_day(folder: Path, repeats: int) -> Part:
    """Processor time of one more motor-day: without the start of the processes."""
    rows = []
    write_day(folder / "day", DAY_MINUTES, 10.0, *MOTORS)
    for name in MOTORS:
        one, many = (
            partial(first_night, make_fleet(folder / "day", folder / str(n), name, n), 1)
            for n in (1, MORE)
        )
        costs = interleaved({"one": one, "many": many}, repeats)
        more = costs["many"].processor_s - costs["one"].processor_s
        rows.append([name, f"{1000 * more / (MORE - 1):.0f} ms"])
    text = (
        f"24 h × 10 Hz, one worker: a run over {MORE} motors less one over one, a motor; medians "
        f"of {repeats} passes. Goal from Parquet: 250 ms."
    )
    return Part("A motor-day", text, "format | processor time", rows)


def hundred(folder: Path, repeats: int) -> Part:
    """100 motors in each format, with one worker and with two, beside just reading."""
    rows = []
    repeats = min(repeats, HUNDRED_REPEATS)
    for name, reader in READERS.items():
        # One format on the disk at a time.
        day = folder / "day"
        shutil.rmtree(day, ignore_errors=True)
        write_day(day, DAY_MINUTES, 10.0, name)
        config = make_fleet(day, folder / "fleet", name, HUNDRED)
        cases = {
            "one": partial(first_night, config, 1),
            "two": partial(first_night, config, 2),
            "read": partial(reading, reader, logs_of(config)),
        }
        costs = interleaved(cases, repeats)
        one, two, read = costs["one"], costs["two"], costs["read"]
        ratio, faster = two.elapsed_s / read.elapsed_s, one.elapsed_s / two.elapsed_s
        memory = f"{worker_peak_mib(config):.0f} MiB", f"{two.parent_mib:.0f} MiB"
        reader_name = reader.replace("_", ", ")
        rows += [
            [f"**{name}: two workers**", *_seconds(two), f"**{ratio:.1f}**", "", *memory],
            [f"{name}: one worker", *_seconds(one), "", f"{faster:.2f}", "", ""],
            [f"{name}: reading, {reader_name}", *_seconds(read), "", "", "", ""],
        ]
    goals = ", ".join(f"{name} {goal:g}" for name, goal in GOALS.items())
    text = (
        f"{HUNDRED} motors × 24 h × 10 Hz, four channels, temperature at 1 Hz; each log the same "
        f"file; medians of {repeats} passes. Goals: run over reading at most {goals}; two workers "
        "1.9 times as fast as one."
    )
    header = "what | elapsed | processor | over reading | faster | largest worker | parent"
    return Part("A hundred motors", text, header, rows)


def small(folder: Path, repeats: int) -> Part:
    """The first load of many short nights."""
    write_day(folder / "day", 90.0, 1.0, "parquet")
    config = make_fleet(folder / "day", folder / "fleet", "parquet", 12)
    add_nights(config, SMALL_NIGHTS // 12 - 1)
    cases = {f"{n} worker{'s' * (n > 1)}": partial(first_night, config, n) for n in (1, 2)}
    rows = [
        [
            what,
            *_seconds(cost),
            f"{1000 * cost.elapsed_s / SMALL_NIGHTS:.0f} ms",
            f"{1000 * cost.processor_s / SMALL_NIGHTS:.0f} ms",
        ]
        for what, cost in interleaved(cases, min(repeats, 3)).items()
    ]
    text = (
        f"{SMALL_NIGHTS} nights of 12 motors, 90 min at 1 Hz each, Parquet, a first load. Goals a "
        "night, everything included: 60 ms of processor time (least to land: 90), 35 ms elapsed "
        "with two workers (55)."
    )
    header = "workers | elapsed | processor | elapsed a night | processor a night"
    return Part("Small nights", text, header, rows)


def start(folder: Path, repeats: int) -> Part:
    """Start of the command, and runs with nothing new."""
    write_day(folder / "day", SMALL_MINUTES, 1.0, "parquet")
    known = {n: make_fleet(folder / "day", folder / str(n), "parquet", n) for n in (6, 100)}
    for config in known.values():
        first_night(config, 2)
    command = [sys.executable, "-m", "pipeline.cli"]
    cases = {
        BARE: [sys.executable, "-c", BARE],
        "`status`, 6 motors (goal: 1.3)": [*command, "status", str(known[6])],
        "nothing new, 6 motors (goal: 1.8)": fit_command(known[6], 2),
        "nothing new, 100 motors (goal: 2.5)": fit_command(known[100], 2),
        "`--help` (goal: 0.3 s)": [*command, "--help"],
    }
    costs = interleaved({what: partial(elapsed, one) for what, one in cases.items()}, repeats)
    bare = costs[BARE].elapsed_s
    rows = [[what, *_seconds(cost), f"{cost.elapsed_s / bare:.2f}"] for what, cost in costs.items()]
    text = f"Medians of {repeats}, two workers; times: elapsed, over that of the bare import."
    return Part("Start", text, "what | elapsed | processor | times", rows)


def _seconds(cost: Cost) -> tuple[str, str]:
    return f"{cost.elapsed_s:.2f} s", f"{cost.processor_s:.2f} s"


PARTS: dict[str, Callable[[Path, int], Part]] = {
    "motor_day": motor_day,
    "hundred": hundred,
    "small": small,
    "start": start,
}
