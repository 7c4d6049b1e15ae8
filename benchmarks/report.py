"""The report of 100 motors over 365 nights: time to make it, its sizes, and time to open it.

The tables are those of one fitted night of the demo, copied to as many motors and nights, with the
leakage moved a little so that no two nights are alike. A page counts as open when its first chart
is drawn, in headless Chromium from the file system; without a browser that is left out.
"""

from __future__ import annotations

import datetime as dt
import shutil
import tempfile
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl

from benchmarks.results_file import write_results
from pipeline.config import Execution, load_fleet
from pipeline.demo import write_demo
from pipeline.report.build import ReportRequest, build_report
from pipeline.run.fleet import RunRequest, run_fleet
from pipeline.schema import NIGHT_TABLES, PREDICTIONS, TREND_TABLES, Table
from pipeline.store.tables import night_file, write_table
from tests.pipeline.report.browser import installed, opened

MOTORS, NIGHTS = 100, 365
FIRST = dt.date(2025, 1, 1)
SLEEP_S = 0.02
LONGEST_S = 60.0

Row = list[str]


def main() -> None:
    """Measure and write `benchmarks/results/report.md`."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "out"
        templates = fitted_night(Path(folder))
        for number in range(NIGHTS):
            _write_night(output, templates, FIRST + dt.timedelta(days=number), number)
        request = ReportRequest(output, output / "report", execution=Execution(workers=2))
        rows = [_timed("all of it", request), _timed("again, with nothing new", request)]
        _write_night(output, templates, FIRST + dt.timedelta(days=NIGHTS), NIGHTS)
        rows.append(_timed("again, with one new night of all motors", request))
        rows += _sizes(request.folder)
        if installed():
            rows += _opening(request.folder)
    title = f"Report of {MOTORS} motors over {NIGHTS} nights"
    write_results("report", title, ("what", "measured"), rows)


def fitted_night(folder: Path) -> Mapping[Table, pl.DataFrame]:
    """The rows of one motor and night of the demo, by table."""
    demo = folder / "demo"
    write_demo(demo, nights=2, minutes=120.0, workers=2)
    fleet = load_fleet(demo / "configs" / "fleet.toml")
    chosen = fleet.motors[-1].motor_id
    output = folder / "fitted"
    run_fleet(RunRequest(replace(fleet, output=output), motors=(chosen,)))
    night = max((output / "tables" / "fits").rglob("*.parquet")).stem
    label = dt.date.fromisoformat(night)
    templates = {
        table: pl.read_parquet(night_file(output, table, label))
        for table in (*NIGHT_TABLES, *TREND_TABLES)
        if night_file(output, table, label).exists()
    }
    shutil.rmtree(demo)
    return templates


def _write_night(
    output: Path, templates: Mapping[Table, pl.DataFrame], night: dt.date, number: int
) -> None:
    """One night of all motors, its times and its leakage moved."""
    rng = np.random.default_rng(number)
    moves = pl.DataFrame(
        {
            "motor_id": [f"M{place:03d}" for place in range(MOTORS)],
            "factor": 1 + 0.02 * rng.standard_normal(MOTORS) + 0.001 * number,
        }
    )
    for table, template in templates.items():
        shift = pl.duration(days=(night - template["night"][0]).days)
        times = [name for name, kind in template.schema.items() if isinstance(kind, pl.Datetime)]
        flows = [
            name
            for name, kind in template.schema.items()
            if kind == pl.Float64
            and (table is PREDICTIONS or "leakage" in name or name in ("value", "lower", "upper"))
        ]
        rows = (
            template.drop("motor_id")
            .join(moves, how="cross")
            .with_columns(
                pl.lit(night).alias("night"),
                *(pl.col(name) + shift for name in times),
                *(pl.col(name) * pl.col("factor") for name in flows),
            )
        )
        write_table(night_file(output, table, night), rows.select(template.columns).sort(table.key))


def _timed(what: str, request: ReportRequest) -> Row:
    begin = time.perf_counter()
    result = build_report(request)
    taken = time.perf_counter() - begin
    return [f"{what}, 2 workers", f"{taken:.1f} s, {result.n_written} files written"]


def _sizes(folder: Path) -> list[Row]:
    kilobyte = 1000
    nights = [path.stat().st_size for path in (folder / "data").rglob("*.js")]
    pages = [path.stat().st_size for path in (folder / "motors").iterdir()]
    index = (folder / "index.html").stat().st_size
    return [
        ["fleet page", f"{index / kilobyte:.0f} kB"],
        ["largest motor page", f"{max(pages) / kilobyte:.0f} kB"],
        ["largest night", f"{max(nights) / kilobyte:.0f} kB"],
        ["all nights together", f"{sum(nights) / kilobyte**2:.0f} MB"],
    ]


def _opening(folder: Path) -> list[Row]:
    rows = []
    places = {
        "fleet page": ("index.html", "return document.readyState === 'complete'"),
        "motor page": ("motors/M007.html", "return !!document.querySelector('[data-drawn=chart]')"),
    }
    for what, (place, is_open) in places.items():
        taken = []
        for _ in range(3):
            with opened() as browser:
                begin = time.perf_counter()
                browser.get((folder / place).resolve().as_uri())
                while not browser.execute_script(is_open):
                    assert time.perf_counter() - begin < LONGEST_S
                    time.sleep(SLEEP_S)
                taken.append(time.perf_counter() - begin)
        rows.append([f"open the {what}, new browser", f"{sorted(taken)[1]:.2f} s"])
    return rows
