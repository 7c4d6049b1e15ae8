"""The report as a whole: read the tables, make what has changed, leave the rest."""

from __future__ import annotations

import datetime as dt
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import polars as pl

from pipeline.config import Execution
from pipeline.errors import StoreError, UsageError
from pipeline.report.charts import conditions_chart, watch_chart
from pipeline.report.findings import scores
from pipeline.report.fleet_page import FleetRow, fleet_rows, fleet_span
from pipeline.report.history import MotorHistory, motor_histories
from pipeline.report.manifest import (
    Entry,
    ReportManifest,
    close_report,
    is_as_left,
    open_report,
    short_hash,
    write_changed,
)
from pipeline.report.names import file_names
from pipeline.report.night import night_payloads
from pipeline.report.pages import (
    ASSETS,
    UTC,
    FleetFacts,
    fleet_html,
    glossary_html,
    motor_html,
)
from pipeline.report.plotly_json import script_json
from pipeline.report.status import changed_by_rules, standing_states
from pipeline.report.tables import SHOWN_TABLES, ReportTables, read_night, read_tables
from pipeline.report.words import STATUSES
from pipeline.schema import ALARMS, FITS, NIGHTLY_TABLES, SCHEMA_VERSION, WATCH, Table
from pipeline.store.atomic_files import remove_leftovers
from pipeline.store.tables import days_of, files_of, read_table, table_folder
from pipeline.telling.delivery import Receiver
from pipeline.telling.outbox import backlogs
from pipeline.workers.engine import open_workers
from pipeline.workers.process import Loss

INDEX = "index.html"
CHART_LIBRARY = "assets/plotly.min.js"
# Fewer nights than this are made in this very process: starting others takes longer.
WORTH_WORKERS = 8
# Of changes of state a page lists the newest.
SHOWN_CHANGES = 200

Entries = dict[str, Entry]


@dataclass(frozen=True, slots=True)
class KnownMotor:
    """Facts on a motor that only the config has."""

    motor_type: str
    # Its dated events, each with `date`, `kind` and `note`.
    events: tuple[Mapping[str, Any], ...] = ()
    paths: tuple[str, ...] = ()  # names of its leakage paths, in the config's order


@dataclass(frozen=True, slots=True)
class ReportRequest:
    """Request for a report."""

    output: Path  # output folder of the runs, in which `tables/` lies
    folder: Path  # folder of the report
    fleet: str = ""  # name of the fleet; where empty, that of the newest run
    # Motors of the config by id, those without any night too.
    known: Mapping[str, KnownMotor] = field(default_factory=dict)
    motors: tuple[str, ...] = ()  # ids of the motors to show; empty for all
    nights: int | None = None  # newest nights that get a file of their own; None for all
    # How many nights are made at the same time, and within which limits.
    execution: Execution = field(default_factory=lambda: Execution(backend="sequential"))
    # Time of making, which the fleet's page tells; None: it tells none.
    made: dt.datetime | None = None
    zone: ZoneInfo = UTC  # time zone of the fleet
    old_after_nights: int = 7  # nights after which a motor's newest data are old
    # Receivers of alarms; what they have not taken is on the fleet's page.
    receivers: tuple[Receiver, ...] = ()


@dataclass(frozen=True, slots=True)
class ReportResult:
    """Result of a report."""

    index: Path  # the page to open
    # n_motors, n_nights: motors shown, and nights of the fleet that were made anew.
    n_motors: int
    n_nights: int
    # n_written, n_removed: files that were written and removed; all others were as they had to be.
    n_written: int
    n_removed: int
    faults: tuple[str, ...]  # table files that could not be read, in words


@dataclass(frozen=True, slots=True)
class NightTask:
    """A night to make: plain data, small enough to send to a worker."""

    output: Path
    folder: Path
    night: dt.date
    names: Mapping[str, str]  # names of the motors' folders; other motors are left out
    before: Mapping[str, Entry]  # entries of the night's files in the manifest, by path


def build_report(request: ReportRequest) -> ReportResult:
    """Write the report, or of a present one what has changed.

    Raises StoreError if there are no tables, one is of a newer version of the program, or the
    folder cannot be written or holds something else; UsageError if a motor is asked for that
    neither the config nor a table knows.
    """
    if not table_folder(request.output, FITS).is_dir():
        raise StoreError(
            "report_tables",
            f"{request.output} holds no table of fits; run fit-fleet first; if it found no log, "
            "run check",
        )
    before = open_report(request.folder)
    remove_leftovers([request.folder])
    history = read_tables(request.output)
    names = _names(request, history)
    nights = _motors_by_night(history.fits, names, request.nights)
    now = ReportManifest(_program_hash())
    made, faults = _make_nights(request, nights, names, before, now)
    n_motors = _make_pages(request, history, names, faults, before, now)
    n_written = sum(1 for name, entry in now.files.items() if before.files.get(name) != entry)
    n_removed = close_report(request.folder, before, now)
    return ReportResult(
        index=request.folder / INDEX,
        n_motors=n_motors,
        n_nights=made,
        n_written=n_written,
        n_removed=n_removed,
        faults=(*history.faults, *faults),
    )


def _names(request: ReportRequest, history: ReportTables) -> dict[str, str]:
    """File names of all motors that are shown."""
    ids = {*request.known, *history.fits["motor_id"].unique()}
    if strangers := sorted(set(request.motors) - ids):
        there = ", ".join(sorted(ids))
        raise UsageError("unknown_motor", f"no motor {', '.join(strangers)}; there are {there}")
    names = file_names(ids)
    return {one: names[one] for one in sorted(ids) if not request.motors or one in request.motors}


def _motors_by_night(
    fits: pl.DataFrame, names: Mapping[str, str], newest: int | None
) -> dict[dt.date, list[str]]:
    """Motors that have a row, by night in time order; of the newest nights, or of all."""
    shown = fits.filter(pl.col("motor_id").is_in(list(names)))
    groups = shown.group_by("night").agg(pl.col("motor_id").sort()).sort("night")
    return dict((groups if newest is None else groups.tail(newest)).iter_rows())


def night_file_name(motor_name: str, night: dt.date) -> str:
    """Path of a night's file within the report."""
    return f"data/{motor_name}/{night}.js"


def _make_nights(
    request: ReportRequest,
    nights: Mapping[dt.date, list[str]],
    names: Mapping[str, str],
    before: ReportManifest,
    now: ReportManifest,
) -> tuple[int, list[str]]:
    """Make the files of nights that are new or changed; enter all into the new manifest."""
    states = _table_states(request.output, nights)
    tasks = []
    for night, motors in nights.items():
        files = [night_file_name(names[motor_id], night) for motor_id in motors]
        kept = {name: before.files[name] for name in files if name in before.files}
        label = night.isoformat()
        is_current = (
            before.program == now.program
            and before.nights.get(label) == states[night]
            and len(kept) == len(files)
            and all(is_as_left(request.folder, name, entry) for name, entry in kept.items())
        )
        if is_current:
            now.files |= kept
            now.nights[label] = states[night]
        else:
            tasks.append(NightTask(request.output, request.folder, night, names, kept))
    faults = []
    is_small = len(tasks) < WORTH_WORKERS or request.execution.backend == "sequential"
    # Not over a cluster: pages are written where they belong.
    backend = "sequential" if is_small else "loky"
    execution = request.execution.model_copy(update={"backend": backend})
    with open_workers(execution) as workers:
        for night, entries, found in workers.run(make_night, tasks, _lost_night):
            now.files |= entries
            faults += found
            if not found:
                now.nights[night.isoformat()] = states[night]
    return len(tasks), sorted(faults)


def _table_states(output: Path, nights: Mapping[dt.date, object]) -> dict[dt.date, str]:
    """Hash of what each night is made from, taken before it is read."""
    states = {night: hashlib.sha256() for night in nights}
    for table in SHOWN_TABLES:
        for path in files_of(output, table, nights):
            for night, state in _states_in(path, table).items():
                if night in states:
                    states[night].update(f"{table.name} {state};".encode())
    return {night: state.hexdigest()[:16] for night, state in states.items()}


def _states_in(path: Path, table: Table) -> dict[dt.date, str]:
    """What tells whether a night's rows have changed: its file, or its rows in that of a month."""
    status = path.stat()
    stamp = f"{status.st_size} {status.st_mtime_ns}"
    if table in NIGHTLY_TABLES:
        return dict.fromkeys(days_of(path.stem), stamp)
    try:
        rows = read_table(path, table)
    except StoreError:
        return dict.fromkeys(days_of(path.stem), stamp)
    sums = rows.select("night", state=rows.hash_rows()).group_by("night").agg(pl.sum("state"))
    return {night: str(state) for night, state in sums.iter_rows()}


def _lost_night(task: NightTask, loss: Loss) -> tuple[dt.date, Entries, list[str]]:
    """Its files stay as they were, until the next report makes them."""
    return task.night, dict(task.before), [f"night {task.night}: {loss.code}: {loss.how}"]


def make_night(task: NightTask) -> tuple[dt.date, Entries, list[str]]:
    """Make the files of one night for all its motors."""
    read = read_night(task.output, task.night)
    entries: Entries = {}
    for motor_id, payload in night_payloads(task.night, read):
        if motor_id in task.names:
            name = night_file_name(task.names[motor_id], task.night)
            content = f"motorLeakage.night({script_json(payload)});\n".encode()
            entries[name] = write_changed(task.folder, name, content, task.before.get(name))
    return task.night, entries, [fault for part in read.values() for fault in part.faults]


def _make_pages(
    request: ReportRequest,
    history: ReportTables,
    names: Mapping[str, str],
    faults: Sequence[str],
    before: ReportManifest,
    now: ReportManifest,
) -> int:
    """Make the fleet's page, the motors' pages, and what they share."""

    def write(name: str, content: bytes) -> None:
        now.files[name] = write_changed(request.folder, name, content, before.files.get(name))

    motors = list(motor_histories(history, list(names)))
    span = fleet_span(motors)
    types = {motor_id: one.motor_type for motor_id, one in request.known.items()}
    states = {one.motor_id: one for one in standing_states(request.output, list(names))}
    rows = fleet_rows(motors, names, types, states)
    name = request.fleet or history.fleet or "Fleet"
    waiting = backlogs(request.output, request.receivers)
    facts = FleetFacts(
        name=name,
        first=span[0] if span else None,
        newest=span[1] if span else None,
        faults=(*history.faults, *faults),
        undelivered=tuple(one.words for one in waiting if one.undelivered),
        made=request.made,
        zone=request.zone,
        old_after_nights=request.old_after_nights,
    )
    for asset in ASSETS:
        write(f"assets/{asset.name}", asset.read_bytes())
    _write_chart_library(request.folder, before, now)
    by_rules = changed_by_rules(history.rows(ALARMS)).filter(pl.col("motor_id").is_in(list(names)))
    told = by_rules.sort(ALARMS.key).with_columns(page=pl.col("motor_id").replace(names))
    by_id = {row.state.motor_id: row for row in rows}
    by_type = {motor_id: row.motor_type for motor_id, row in by_id.items()}
    parts = scores(history.decisions, history.rows(WATCH), by_type)
    write(INDEX, fleet_html(facts, rows, told.to_dicts(), parts).encode())
    write("glossary.html", glossary_html(facts).encode())
    for motor in motors:
        name = names[motor.motor_id]
        page = _motor_page(request, history, motor, name, by_id[motor.motor_id], facts, now)
        write(f"motors/{name}.html", page.encode())
    return len(motors)


def _motor_page(
    request: ReportRequest,
    history: ReportTables,
    motor: MotorHistory,
    name: str,
    row: FleetRow,
    facts: FleetFacts,
    now: ReportManifest,
) -> str:
    known = request.known.get(motor.motor_id, KnownMotor(""))
    changes = changes_of_state(motor.motor_id, history)
    nights = {
        "file": name,
        "nights": [str(night) for night in motor.nights],
        "statuses": [STATUSES.get(status, status) for status in motor.statuses],
        "detailed": [int(night_file_name(name, night) in now.files) for night in motor.nights],
    }
    charts = {
        "course": watch_chart(motor, known.paths, known.events, changes),
        "conditions": conditions_chart(motor),
    }
    said = [one for one in history.decisions if one.motor_id == motor.motor_id]
    return motor_html(facts, row, motor, charts, nights, changes, said)


def changes_of_state(motor_id: str, history: ReportTables) -> list[dict[str, Any]]:
    """A motor's newest rows of `alarms`, the newest first."""
    rows = history.rows(ALARMS).filter(motor_id=motor_id)
    return rows.sort("time", "indicator", descending=[True, False]).head(SHOWN_CHANGES).to_dicts()


def _write_chart_library(folder: Path, before: ReportManifest, now: ReportManifest) -> None:
    """One copy of the chart library for all pages; it is read only where it has to be written."""
    entry = before.files.get(CHART_LIBRARY)
    if before.program == now.program and entry and is_as_left(folder, CHART_LIBRARY, entry):
        now.files[CHART_LIBRARY] = entry
        return
    from plotly.offline import get_plotlyjs

    now.files[CHART_LIBRARY] = write_changed(folder, CHART_LIBRARY, get_plotlyjs().encode(), entry)


def _program_hash() -> str:
    """Hash of the report's own files and of what else shapes its content."""
    sources = sorted(path for path in Path(__file__).parent.rglob("*") if path.is_file())
    own = [path.read_bytes() for path in sources if "__pycache__" not in path.parts]
    packages = [version(name).encode() for name in ("motor-leakage", "jinja2", "plotly")]
    return short_hash(b"|".join((*own, *packages, str(SCHEMA_VERSION).encode())))
