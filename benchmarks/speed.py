"""How long a fleet's first night takes, beside just reading the same logs.

Whole processes from outside: `fit-fleet` on a fleet of which nothing is known yet, everything
included (reading, cleaning, statistics, starts, intervals, validation, residual analysis, tables,
verification, trends), beside two fresh processes that read the same files into columns with the
fastest reader there is, each half of them. Cases take turns, and a ratio is one of medians of one
run; absolute times are of the machine that it ran on. Logs come from the page cache on both sides.

`--only PART,PART` does some of the parts, `--repeats N` as many passes, `--motors N` fleets of N.
What the other parts found in runs before stays (`speed.json`).
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.day_fleets import (
    DAY_MINUTES,
    MOTORS,
    add_nights,
    later,
    log_of,
    logs_of,
    make_fleet,
    write_day,
)
from benchmarks.results_file import Part, in_folder, write_stored
from benchmarks.whole_runs import (
    Cost,
    compile_sources,
    elapsed,
    first_night,
    fit_command,
    interleaved,
    reading,
    until_first_byte,
    worker_peak_mib,
)

READERS = {"parquet": "pyarrow_parquet", "csv": "pyarrow_csv", "mcap": "plain_mcap"}
GOALS = {"parquet": 9.0, "csv": 3.0, "mcap": 1.3}
# Logs of a fleet in `hundred`, and the most passes over them: each takes some ten minutes.
HUNDRED, HUNDRED_REPEATS = 100, 3
SAMPLES = (100_000, 1_000_000, 8_640_000)
# As many days at 100 Hz are a hundred million samples.
DAYS = 12
FLEETS = (1, 10, 100, 1000)
SMALL_MINUTES = 20.0
SMALL_NIGHTS = 840
NIGHTS = (10, 100, 1000)
BARE = "import numpy, polars, pyarrow, scipy.special, pydantic"
USER_STARTS, TIMED_STARTS = 50, 3


@dataclass(frozen=True, slots=True)
class Asked:
    """What is asked for on the command line."""

    folder: Path
    repeats: int
    motors: int


def main(options: Sequence[str] = ()) -> None:
    """Measure, and write `benchmarks/results/speed.md`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks speed", add_help=False)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--motors", type=int, default=12)
    asked, rest = parser.parse_known_args(list(options))
    compile_sources()

    def made(make: Callable[[Asked], Part]) -> Part:
        return in_folder(lambda folder: make(Asked(folder, asked.repeats, asked.motors)))

    makers = {name: partial(made, make) for name, make in PARTS.items()}
    write_stored("speed", "As fast as reading the logs", __doc__ or "", makers, rest)


def motor_day(asked: Asked) -> Part:
    """Processor time of one more motor-day: without the start of the processes."""
    rows = []
    write_day(asked.folder / "day", DAY_MINUTES, 10.0, *MOTORS)
    for name in MOTORS:
        configs = {
            n: make_fleet(asked.folder / "day", asked.folder / str(n), name, n, linked=True)
            for n in (1, asked.motors)
        }
        costs = interleaved(
            {str(n): lambda config=config: first_night(config, 1) for n, config in configs.items()},
            asked.repeats,
        )
        more = costs[str(asked.motors)].processor_s - costs["1"].processor_s
        rows.append([name, f"{1000 * more / (asked.motors - 1):.0f} ms"])
    text = (
        f"24 h × 10 Hz, one worker: a run over {asked.motors} motors less one over one, a motor; "
        f"medians of {asked.repeats} passes. Goal from Parquet: 250 ms."
    )
    return Part("A motor-day", text, "format | processor time", rows)


def hundred(asked: Asked) -> Part:
    """100 motors in each format, with one worker and with two, beside just reading."""
    rows = []
    for name, reader in READERS.items():
        # One format on the disk at a time.
        day = asked.folder / "day"
        shutil.rmtree(day, ignore_errors=True)
        write_day(day, DAY_MINUTES, 10.0, name)
        config = make_fleet(day, asked.folder / "fleet", name, HUNDRED, linked=True)
        files = logs_of(config)
        costs = interleaved(
            {
                "one": partial(first_night, config, 1),
                "two": partial(first_night, config, 2, look_at_parent=True),
                "read": partial(reading, reader, files),
            },
            min(asked.repeats, HUNDRED_REPEATS),
        )
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
        f"file; medians of {min(asked.repeats, HUNDRED_REPEATS)} passes. Goals: run over reading "
        f"at most {goals}; two workers 1.9 times as fast as one."
    )
    header = "what | elapsed | processor | over reading | faster | largest worker | parent"
    return Part("A hundred motors", text, header, rows)


def fast(asked: Asked) -> Part:
    """One motor of 24 h at 100 Hz."""
    day = asked.folder / "day"
    write_day(day, DAY_MINUTES, 100.0, "parquet")
    config = make_fleet(day, asked.folder / "fleet", "parquet", 1)
    files = logs_of(config)
    costs = interleaved(
        {
            "ours": lambda: first_night(config, 2),
            "read": lambda: reading(READERS["parquet"], files),
        },
        asked.repeats,
    )
    rows = [
        ["fit-fleet", *_seconds(costs["ours"]), f"{worker_peak_mib(config):.0f} MiB"],
        ["reading, PyArrow", *_seconds(costs["read"]), ""],
        ["ratio", f"{costs['ours'].elapsed_s / costs['read'].elapsed_s:.2f}", "", ""],
    ]
    text = "One motor × 24 h × 100 Hz, Parquet. Goal: at most 1024 MiB a worker."
    return Part("100 Hz", text, "what | elapsed | processor | largest worker", rows)


def small(asked: Asked) -> Part:
    """The first load of many short nights."""
    day = asked.folder / "day"
    write_day(day, 90.0, 1.0, "parquet")
    config = make_fleet(day, asked.folder / "fleet", "parquet", 12)
    add_nights(config, SMALL_NIGHTS // 12 - 1)
    cases = {f"{n} worker{'s' * (n > 1)}": partial(first_night, config, n) for n in (1, 2)}
    costs = interleaved(cases, min(asked.repeats, 3))
    rows = [
        [
            what,
            *_seconds(cost),
            f"{1000 * cost.elapsed_s / SMALL_NIGHTS:.0f} ms",
            f"{1000 * cost.processor_s / SMALL_NIGHTS:.0f} ms",
        ]
        for what, cost in costs.items()
    ]
    text = (
        f"{SMALL_NIGHTS} nights of 12 motors, 90 min at 1 Hz each, Parquet, a first load. Goals a "
        "night, everything included: 60 ms of processor time (least to land: 90), 35 ms elapsed "
        "with two workers (55)."
    )
    header = "workers | elapsed | processor | elapsed a night | processor a night"
    return Part("Small nights", text, header, rows)


def start(asked: Asked) -> Part:
    """Start of the command, and runs with nothing new."""
    day = asked.folder / "day"
    write_day(day, SMALL_MINUTES, 1.0, "parquet")
    new = make_fleet(day, asked.folder / "new", "parquet", 2)
    known = {n: make_fleet(day, asked.folder / str(n), "parquet", n) for n in (6, 100)}
    for config in known.values():
        first_night(config, 2)
    python = [sys.executable]
    status = ["-m", "pipeline.cli", "status", str(known[6])]
    costs = interleaved(
        {
            BARE: lambda: elapsed([*python, "-c", BARE]),
            "`status`, 6 motors (goal: 1.3)": lambda: elapsed([*python, *status]),
            **{
                f"nothing new, {n} motors (goal: {goal})": partial(elapsed, fit_command(config, 2))
                for (n, config), goal in zip(known.items(), (1.8, 2.5), strict=True)
            },
            "`--help` (goal: 0.3 s)": lambda: elapsed([*python, "-m", "pipeline.cli", "--help"]),
            "`fit-fleet` to the first byte read of a log (goal: 1.5 s)": lambda: until_first_byte(
                new
            ),
        },
        asked.repeats,
    )
    bare = costs[BARE].elapsed_s
    rows = [[what, *_seconds(cost), f"{cost.elapsed_s / bare:.2f}"] for what, cost in costs.items()]
    text = f"Medians of {asked.repeats}, two workers; times: elapsed, over that of the bare import."
    return Part("Start", text, "what | elapsed | processor | times", rows)


def user(asked: Asked) -> Part:
    """What a user would write instead, one motor-night of it."""
    from benchmarks.user_script import user_motor_night

    day = asked.folder / "day"
    write_day(day, DAY_MINUTES, 10.0, "parquet")
    config = make_fleet(day, asked.folder / "fleet", "parquet", asked.motors)
    ours, theirs = [], []
    for _ in range(min(asked.repeats, 3)):
        ours.append(first_night(config, 2).elapsed_s / asked.motors)
        theirs.append(user_motor_night(log_of(day, "parquet"), USER_STARTS, TIMED_STARTS))
    own = statistics.median(ours)
    rows = [["ours, a motor-night of the fleet", f"{own:.2f} s", ""]]
    for what, seconds in zip(
        ("the model evaluated in each trial", "what no trial changes worked out once"),
        zip(*theirs, strict=True),
        strict=True,
    ):
        # A loop over motors keeps two workers busy.
        other = statistics.median(seconds) / 2
        rows.append([f"pandas and SciPy, {what}", f"{other:.0f} s", f"{other / own:.0f}"])
    text = (
        f"A loop over motors on two workers, so half of what one motor-night takes: pandas reads "
        f"and cleans, `scipy.optimize.least_squares` searches over the samples from {USER_STARTS} "
        f"starts, of which {TIMED_STARTS} are timed and scaled. It has no intervals, no "
        "validation, no residual analysis and no tables; ours has, and starts its processes."
    )
    header = "what | elapsed a motor-night | ratio (goal: at least 500)"
    return Part("What a user would write", text, header, rows)


def growth(asked: Asked) -> Part:
    """Time against samples, motors, motors of a circuit and nights of history."""
    rows = []
    day = asked.folder / "day"
    write_day(day, DAY_MINUTES, 100.0, "parquet")
    whole = pq.read_table(log_of(day, "parquet"))
    taken: list[tuple[int, float]] = []
    for n in SAMPLES:
        path = log_of(day, "parquet")
        pq.write_table(_thinned(whole, n), path)
        config = make_fleet(day, asked.folder / "fleet", "parquet", 1)
        cost = interleaved({"": lambda c=config: first_night(c, 1)}, min(asked.repeats, 3))[""]
        taken.append((n, cost.processor_s))
        rows.append([f"{n:,} samples of a day", *_seconds(cost), ""])
    config = make_fleet(day, asked.folder / "fleet", "parquet", 1)
    (log,) = logs_of(config)
    for number in range(1, DAYS):
        pq.write_table(later(whole, number), log.with_name(f"{number}.parquet"))
    cost = first_night(config, 1)
    taken.append((DAYS * whole.num_rows, cost.processor_s))
    what = f"{DAYS * whole.num_rows:,} samples of {DAYS} days, {worker_peak_mib(config):.0f} MiB"
    rows.append([what, *_seconds(cost), _slope(taken)])
    del whole
    shutil.rmtree(day)
    write_day(day, SMALL_MINUTES, 1.0, "parquet")
    taken = []
    for n in FLEETS:
        config = make_fleet(day, asked.folder / "fleet", "parquet", n)
        cost = first_night(config, 2, look_at_parent=True)
        taken.append((n, cost.processor_s))
        parent = f"parent {cost.parent_mib:.0f} MiB"
        rows.append([f"{n} motors of {SMALL_MINUTES:g} min", *_seconds(cost), parent])
    rows[-1][-1] += f", {_slope(taken)}"
    taken = []
    for n in FLEETS[1:3]:
        config = make_fleet(day, asked.folder / "fleet", "parquet", n, tank="tank")
        cost = first_night(config, 2)
        taken.append((n, cost.processor_s))
        rows.append([f"{n} motors of one oil circuit", *_seconds(cost), ""])
    rows[-1][-1] += _slope(taken)
    taken = []
    for n in NIGHTS:
        config = make_fleet(day, asked.folder / "fleet", "parquet", 1)
        add_nights(config, n - 1)
        cost = first_night(config, 1, look_at_parent=True)
        taken.append((n, cost.processor_s))
        rows.append([f"{n} nights of 20 min", *_seconds(cost), f"parent {cost.parent_mib:.0f} MiB"])
    rows[-1][-1] += f", {_slope(taken)}"
    text = (
        "Samples of one motor in Parquet (a day at 100 Hz, thinned; several days), one worker; "
        "motors with a short log, each on a tank of its own or all on one, two workers. "
        "A slope of 1 on logarithmic axes is growth in proportion; what does not grow (the start "
        "of the processes) is below it. Nights of history: `night_cost.md`."
    )
    return Part("Growth", text, "what | elapsed | processor | slope", rows)


def _thinned(table: pa.Table, n: int) -> pa.Table:
    rows = np.linspace(0, table.num_rows - 1, min(n, table.num_rows)).astype(np.int64)
    return table.take(pa.array(rows))


def _slope(taken: Sequence[tuple[int, float]]) -> str:
    """Slope of the last two points on logarithmic axes, and what one more costs."""
    (n0, s0), (n1, s1) = taken[-2:]
    slope = np.log(s1 / s0) / np.log(n1 / n0)
    return f"slope {slope:.2f}, {1e6 * (s1 - s0) / (n1 - n0):.3g} µs each"


def _seconds(cost: Cost) -> tuple[str, str]:
    return f"{cost.elapsed_s:.2f} s", f"{cost.processor_s:.2f} s"


PARTS: dict[str, Callable[[Asked], Part]] = {
    "motor_day": motor_day,
    "hundred": hundred,
    "fast": fast,
    "small": small,
    "user": user,
    "start": start,
    "growth": growth,
}
