"""The report as a whole: read the tables, make what has changed, leave the rest."""

from __future__ import annotations

import datetime as dt
import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import polars as pl

from leakage import AnnularGap
from pipeline.config import Fleet, MotorSpec
from pipeline.errors import StoreError
from pipeline.messages import plain
from pipeline.notification.outbox import backlogs
from pipeline.notification.receivers import receivers_of
from pipeline.report.charts import night_chart, watch_chart
from pipeline.report.explain import EXPLAINED, paragraphs
from pipeline.report.fleet_page import FleetRow, fleet_rows, fleet_span
from pipeline.report.pages import FOLDER, page_of
from pipeline.report.plotly_json import figure, script_json
from pipeline.report.status import current_states
from pipeline.report.tables import MotorHistory, by_motor, finite_rows, motor_histories
from pipeline.schema import ALARMS, NIGHTS, PREDICTIONS, frame
from pipeline.store.atomic_files import (
    TEMPORARY_PREFIX,
    flush_path,
    put,
    remove_leftovers,
    store_errors,
)
from pipeline.store.tables import files_of, read_rows, table_folder
from pipeline.trends.nights.decisions import read_decisions
from pipeline.trends.rows.alarm_rows import what_of
from pipeline.trends.rows.motor_states import ORDER

MANIFEST = "manifest.json"
CHART_LIBRARY = "assets/plotly.min.js"
# Of changes of state a page lists the newest.
SHOWN_CHANGES = 200


@dataclass(frozen=True, slots=True)
class ReportResult:
    """Result of a report."""

    # n_motors, n_nights: motors shown, and nights of the fleet that were made anew.
    n_motors: int
    n_nights: int
    # n_written, n_removed: files that were written and removed; all others were as they had to be.
    n_written: int
    n_removed: int


class Folder:
    """The report's folder: a file is written when its content has changed, and ours alone go."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.files: set[str] = set()  # that the report has now
        self.written: list[Path] = []
        # What the last report left: hash of the program, states of the nights, names of the files.
        self.program = ""
        self.nights: dict[str, str] = {}
        self.before: set[str] = set()
        manifest = path / MANIFEST
        if manifest.exists():
            # Without a sound one all files are made anew, over the present ones.
            with suppress(OSError, ValueError, KeyError, TypeError):
                last = json.loads(manifest.read_bytes())
                found = str(last["program"]), dict(last["nights"]), set(last["files"])
                self.program, self.nights, self.before = found
            return
        if path.exists() and not path.is_dir():
            raise StoreError("report_folder", f"{path} is no folder; name another")
        for one in sorted(path.iterdir()) if path.exists() else ():
            if not one.name.startswith(TEMPORARY_PREFIX):
                said = f"{path} holds {one.name} and no report; name an empty or new folder"
                raise StoreError("report_folder", said)
        put(manifest, b"{}")

    def write(self, name: str, content: bytes) -> None:
        """Write a file unless it is there with that content."""
        self.files.add(name)
        path = self.path / name
        if not (path.exists() and path.read_bytes() == content):
            put(path, content, durable=False)
            self.written.append(path)

    def keep(self, names: Iterable[str]) -> bool:
        """Keep files of the last report as they are; False if one is gone."""
        wanted = set(names)
        is_there = wanted <= self.before and all((self.path / one).is_file() for one in wanted)
        self.files |= wanted if is_there else set()
        return is_there

    def close(self, program: str, nights: Mapping[str, str]) -> int:
        """Remove files that the report has no more, and remember the others; how many went."""
        gone = sorted(self.before - self.files)
        for name in gone:
            path = self.path / name
            # Nothing outside the report is removed, whatever the manifest lists.
            if path.resolve().is_relative_to(self.path.resolve()):
                with suppress(OSError):
                    path.unlink()
                    path.parent.rmdir()
        with store_errors(self.path):
            # At the end: what the first ones wait for is true of the later ones as well.
            for path in (*self.written, *{one.parent for one in self.written}):
                flush_path(path)
        manifest = {"program": program, "nights": nights, "files": sorted(self.files)}
        content = json.dumps(manifest, separators=(",", ":"), sort_keys=True).encode()
        if (self.path / MANIFEST).read_bytes() != content:
            put(self.path / MANIFEST, content)
        return len(gone)


def build_report(
    fleet: Fleet, folder: Path, *, nights: int | None = None, made: dt.datetime | None = None
) -> ReportResult:
    """Write the report of a fleet's motors to a folder, or of a present one what has changed.

    `nights`: newest nights that get a file of their own; None for all. `made`: time of making,
    which the fleet's page tells; None: it tells none.

    Raises StoreError if there are no tables, one is damaged or of a newer version of the program,
    or the folder cannot be written or holds something else.
    """
    if not table_folder(fleet.output, NIGHTS).is_dir():
        raise StoreError(
            "report_tables",
            f"{fleet.output} holds no table of nights; run fit-fleet first; if it found no log, "
            "run check",
        )
    report = Folder(folder)
    remove_leftovers([folder])
    program = _program_hash()
    states, n_nights = _make_nights(fleet, report, nights, program)
    _make_pages(fleet, made, report, program)
    n_removed = report.close(program, states)
    return ReportResult(len(fleet.motors), n_nights, len(report.written), n_removed)


def _motors_by_night(fleet: Fleet, newest: int | None) -> dict[dt.date, list[str]]:
    """Motors that have a row, by night in time order; of the newest nights, or of all."""
    ids = [spec.motor_id for spec in fleet.motors]
    shown = read_rows(fleet.output, NIGHTS, ids, ("motor_id", "night"))
    groups = shown.group_by("night").agg(pl.col("motor_id").sort()).sort("night")
    return dict((groups if newest is None else groups.tail(newest)).iter_rows())


def night_file_name(motor_id: str, night: dt.date) -> str:
    """Path of a night's file within the report."""
    return f"data/{motor_id}/{night}.js"


def _make_nights(
    fleet: Fleet, folder: Folder, newest: int | None, program: str
) -> tuple[dict[str, str], int]:
    """Make the files of nights that are new or changed; states of the nights, and how many."""
    output, ids = fleet.output, [spec.motor_id for spec in fleet.motors]
    nights = _motors_by_night(fleet, newest)
    states: dict[str, str] = {}
    n_made = 0
    for month in sorted({night.replace(day=1) for night in nights}):
        labels = [night for night in nights if night.replace(day=1) == month]
        of_month = {
            table.name: finite_rows(output, table, ids, labels).partition_by("night", as_dict=True)
            for table in EXPLAINED
        }
        for night in labels:
            rows = {name: of[(night,)] for name, of in of_month.items() if (night,) in of}
            state = _state_of(rows, files_of(output, PREDICTIONS, [night]))
            states[str(night)] = state
            files = [night_file_name(motor_id, night) for motor_id in nights[night]]
            is_current = (folder.program, folder.nights.get(str(night))) == (program, state)
            if is_current and folder.keep(files):
                continue
            n_made += 1
            rows["predictions"] = finite_rows(output, PREDICTIONS, ids, [night])
            own = {name: by_motor(of) for name, of in rows.items()}
            for motor_id, file in zip(nights[night], files, strict=True):
                of_motor = {name: of[motor_id] for name, of in own.items() if motor_id in of}
                payload = night_payload(night, of_motor)
                folder.write(file, f"motorLeakage.night({script_json(payload)});\n".encode())
    return states, n_made


def _state_of(rows: Mapping[str, pl.DataFrame], samples: Iterable[Path]) -> str:
    """What a night is made from: its rows, and the files of its samples."""
    sums = [(name, int(of.hash_rows().sum())) for name, of in rows.items()]
    stamps = [(sample.stat().st_size, sample.stat().st_mtime_ns) for sample in samples]
    return hashlib.sha256(f"{sums} {stamps}".encode()).hexdigest()[:16]


def night_payload(night: dt.date, rows: Mapping[str, pl.DataFrame]) -> dict[str, Any]:
    """What a motor's page shows of a night: words as of `explain`, and a chart."""
    none = pl.DataFrame()
    listed = {table.name: rows.get(table.name, none).to_dicts() for table in EXPLAINED}
    mode = listed["nights"][0]["flushing_mode"]
    samples = rows.get("predictions", frame(PREDICTIONS, [])).filter(flushing_mode=mode)
    chart = figure(night_chart(samples))
    return {"night": str(night), "words": paragraphs(listed), "figure": chart}


def _make_pages(fleet: Fleet, made: dt.datetime | None, folder: Folder, program: str) -> None:
    """Make the fleet's page, the motors' pages, and what they share."""
    ids = [spec.motor_id for spec in fleet.motors]
    motors = dict(zip(ids, motor_histories(fleet.output, ids), strict=True))
    states = {state.motor_id: state for state in current_states(fleet.output, ids)}
    specs = {spec.motor_id: spec for spec in fleet.motors}
    rows = fleet_rows(list(motors.values()), specs, states)
    by_id = {row.state.motor_id: row for row in rows}
    alarms = by_motor(read_rows(fleet.output, ALARMS, ids))
    decisions = read_decisions(fleet.output)
    found = Counter(row.state.state for row in rows)
    first, newest = fleet_span(list(motors.values())) or (None, None)
    waiting = backlogs(fleet.output, receivers_of(fleet.settings.alarms))
    facts = {
        "name": fleet.name,
        "first": first,
        "newest": newest,
        "made": made,
        "zone": fleet.settings.nights.zone,
        "old_after_nights": fleet.settings.alarms.stale_after_nights,
        "undelivered": [one.words for one in waiting if one.undelivered],
    }
    for spec in fleet.motors:
        motor_id = spec.motor_id
        changes = newest_changes(alarms.get(motor_id, frame(ALARMS, [])))
        values = _motor_values(spec, motors[motor_id], by_id[motor_id], changes)
        said = [decision for decision in decisions if decision.motor_id == motor_id]
        page = page_of("motor.html", facts=facts, decisions=said, **values)
        folder.write(f"motors/{motor_id}.html", page.encode())
    counts = [(code, found[code]) for code in ORDER if found[code]]
    index = page_of("fleet.html", facts=facts, rows=rows, counts=counts)
    folder.write("index.html", index.encode())
    folder.write("glossary.html", page_of("glossary.html", facts=facts).encode())
    for asset in (FOLDER / "assets").iterdir():
        folder.write(f"assets/{asset.name}", asset.read_bytes())
    # One copy for all pages; it is read only where it has to be written.
    if folder.program != program or not folder.keep([CHART_LIBRARY]):
        from plotly.offline import get_plotlyjs

        folder.write(CHART_LIBRARY, get_plotlyjs().encode())


def _motor_values(
    spec: MotorSpec,
    motor: MotorHistory,
    row: FleetRow,
    changes: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """What the template of a motor's page names, besides facts and decisions."""
    paths = [path.name for path in spec.motor_type.paths()]
    course = watch_chart(motor, paths, spec.file.events, changes)
    payload = {
        "file": motor.motor_id,
        "nights": [str(night) for night in motor.nights],
        "statuses": [plain(status) for status in motor.rows["status"]],
        "course": figure(course),
    }
    return {
        "row": row,
        "last": motor.rows.row(-1, named=True) if motor.nights else None,
        "marks": course.marks,
        "parts": [(path.name, isinstance(path, AnnularGap)) for path in spec.motor_type.paths()],
        "payload": script_json(payload),
        "changes": changes,
    }


def newest_changes(alarms: pl.DataFrame) -> list[dict[str, Any]]:
    """A motor's newest rows of `alarms`, the newest first."""
    rows = alarms.sort("night", "id", descending=[True, False]).head(SHOWN_CHANGES)
    return [row | {"indicator": what_of(row)} for row in rows.to_dicts()]


def _program_hash() -> str:
    """Hash of the program's own files: any of them may shape what pages say."""
    package = FOLDER.parent
    files = sorted(path for path in package.rglob("*") if path.is_file() and path.suffix != ".pyc")
    found = hashlib.sha256("".join(map(version, ("jinja2", "plotly"))).encode())
    for file in files:
        found.update(file.read_bytes())
    return found.hexdigest()[:16]
