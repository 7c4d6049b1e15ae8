"""The demo fleet's first nights in every dialect: how far the tables of the whole run differ.

The demo is made and fitted. What was recorded is then written anew, by writers that share nothing
with the readers, as a fleet of loggers of another make each time, and `fit-fleet` is run over it.
Motors whose logs a dialect cannot hold are left out: stamps finer than a spreadsheet's, infinite
readings in whole numbers, blank cells in messages that must have a value.

In the end, files that are cut in the middle lie beside the good ones; and a demo begins on the
night in which summer time ends, in the dialects of local time.
"""

from __future__ import annotations

import argparse
import datetime as dt
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from joblib import Parallel, delayed

from benchmarks.day_fleets import search_every_night
from benchmarks.results_file import write_results
from pipeline.demo import write_demo
from tests.dialects.catalogue import DIALECTS, OVER_A_CLOCK_CHANGE
from tests.dialects.comparison import Comparison, compare
from tests.dialects.dialect import Dialect
from tests.dialects.fleet import Nights, first_nights, write_fleet

CLOCK_CHANGE = dt.date(2025, 10, 26)
LONG_ENOUGH_MINUTES = 300.0
CUT = next(dialect for dialect in DIALECTS if dialect.name.startswith("gzip"))
HEADER = (
    "dialect",
    "format",
    "motors",
    "files read",
    "skipped",
    "fits",
    "parameters",
    "sensitivities",
    "cost of starts",
    "other cells that differ",
    "rows in one only",
)


@dataclass(frozen=True, slots=True)
class Demo:
    """A demo, what was recorded in it, and what `fit-fleet` made of its own logs."""

    folder: Path
    nights: Nights
    output: Path


def main(nights: int = 2, minutes: float = 90.0, rate_hz: float = 5.0, jobs: int = 2) -> None:
    """Write `benchmarks/results/demo_dialects.md`."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        demo = _demo(folder / "first", nights, minutes, rate_hz)
        late = _demo(folder / "change", 1, LONG_ENOUGH_MINUTES, rate_hz, CLOCK_CHANGE)
        tasks = [(demo, dialect, dialect.name) for dialect in DIALECTS]
        tasks += [(late, one, f"{one.name}; summer time ends") for one in OVER_A_CLOCK_CHANGE]
        rows = Parallel(n_jobs=jobs)(
            delayed(_row)(*task, folder / str(place)) for place, task in enumerate(tasks)
        )
        rows.append(_cut_row(demo, folder / "cut"))
    motors = len(demo.nights)
    title = (
        f"The demo in {len(DIALECTS)} dialects: largest relative difference by table "
        f"({motors} motors, {nights} nights of {minutes:g} min at {rate_hz:g} Hz)"
    )
    write_results("demo_dialects", title, HEADER, rows)


def _demo(
    folder: Path, nights: int, minutes: float, rate_hz: float, first: dt.date | None = None
) -> Demo:
    chosen = {} if first is None else {"first_night": first}
    write_demo(folder, nights=nights, minutes=minutes, rate_hz=rate_hz, **chosen)
    output = folder / "out"
    search_every_night(folder / "configs" / "fleet.toml")
    _fit(folder / "configs" / "fleet.toml", output, jobs=2)
    return Demo(folder, first_nights(folder), output)


def _fit(config: Path, output: Path, jobs: int = 1) -> None:
    """`fit-fleet`; 1 says that a night failed, which the tables tell."""
    program = "from pipeline.cli import main; main()"
    command = [sys.executable, "-c", program, "fit-fleet", config, "--output", output]
    done = subprocess.run([*command, "--jobs", str(jobs)], capture_output=True, check=False)
    if done.returncode not in (0, 1):
        raise subprocess.CalledProcessError(done.returncode, command, done.stdout, done.stderr)


def _row(demo: Demo, dialect: Dialect, name: str, folder: Path) -> list[str]:
    config = write_fleet(demo.folder, folder, dialect, demo.nights)
    _fit(config, folder / "out")
    return _cells(demo, dialect, name, folder)


def _cut_row(demo: Demo, folder: Path) -> list[str]:
    """Beside the first nights, of each motor one file more that lost its second half."""
    config = write_fleet(demo.folder, folder, CUT, demo.nights)
    for motor, logs in demo.nights.items():
        last = max(logs)
        whole = next((folder / "demo" / "logs" / motor).glob(f"*{last}*"))
        data = whole.read_bytes()
        cut = whole.with_name(whole.name.replace(str(last), str(last + dt.timedelta(days=1))))
        cut.write_bytes(data[: len(data) // 2])
    _fit(config, folder / "out")
    return _cells(demo, CUT, f"{CUT.name}; a cut file a motor beside them", folder)


def _cells(demo: Demo, dialect: Dialect, name: str, folder: Path) -> list[str]:
    motors = tuple(path.stem for path in (folder / "configs" / "motors").iterdir())
    found: Comparison = compare(demo.output, folder / "out", motors)
    figures = [
        f"{found.largest[table]:.0e}" if found.largest[table] else "0"
        for table in ("fits", "parameters", "sensitivities", "starts")
    ]
    counts = [str(sum(part.values())) for part in (found.others, found.rows)]
    shutil.rmtree(folder)
    files = [str(found.n_read), str(found.n_failed)]
    return [name, dialect.format, str(len(motors)), *files, *figures, *counts]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--nights", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=90.0)
    parser.add_argument("--rate", type=float, default=5.0, dest="rate_hz")
    parser.add_argument("--jobs", type=int, default=2)
    main(**vars(parser.parse_args()))
