"""The report as a whole: read the tables, make what has changed, leave the rest."""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import polars as pl

from pipeline.errors import StoreError, UsageError
from pipeline.report.charts import conditions_chart, night_chart, watch_chart
from pipeline.report.explain import EXPLAINED, paragraphs
from pipeline.report.fleet_page import FleetRow, fleet_rows, fleet_span
from pipeline.report.pages import FOLDER, page_of
from pipeline.report.plotly_json import figure, script_json
from pipeline.report.status import changed_by_rules, current_states, read_scores
from pipeline.report.tables import MotorHistory, TableReader, by_motor, motor_histories
from pipeline.report.words import STATUSES
from pipeline.schema import ALARMS, FIT_KEY_NAMES, FITS, PREDICTIONS, RUNS, frame
from pipeline.store.atomic_files import TEMPORARY_PREFIX, flush_disk, put, remove_leftovers
from pipeline.store.tables import files_of, table_folder
from pipeline.telling.outbox import backlogs
from pipeline.telling.receivers import Receiver
from pipeline.trends.nights.decisions import read_decisions
from pipeline.trends.rows.motor_states import ORDER

MANIFEST = "manifest.json"
CHART_LIBRARY = "assets/plotly.min.js"
UTC = ZoneInfo("UTC")
# Of changes of state a page lists the newest.
SHOWN_CHANGES = 200
# What every file system takes; the ids of a config match it, those of a stranger's table may not.
PLAIN = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,62}[A-Za-z0-9_-]|[A-Za-z0-9]")
# Names of devices on Windows, whatever their ending.
DEVICES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.IGNORECASE)


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


class Folder:
    """The report's folder: a file is written when its content has changed, and ours alone go."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.files: set[str] = set()  # that the report has now
        self.n_written = 0
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
            self.n_written += 1

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
        flush_disk(self.path)  # one flush for all pages, not one for each
        manifest = {"program": program, "nights": nights, "files": sorted(self.files)}
        content = json.dumps(manifest, separators=(",", ":"), sort_keys=True).encode()
        if (self.path / MANIFEST).read_bytes() != content:
            put(self.path / MANIFEST, content)
        return len(gone)


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
    folder = Folder(request.folder)
    remove_leftovers([request.folder])
    reader = TableReader(request.output)
    fits = reader.rows(FITS).filter("is_primary")
    names = _names(request, fits["motor_id"].unique())
    nights = _motors_by_night(fits, names, request.nights)
    program = _program_hash()
    states, n_nights = _make_nights(reader, folder, nights, names, program)
    n_motors = _make_pages(request, reader, folder, names, program)
    n_removed = folder.close(program, states)
    return ReportResult(
        index=request.folder / "index.html",
        n_motors=n_motors,
        n_nights=n_nights,
        n_written=folder.n_written,
        n_removed=n_removed,
        faults=tuple(sorted(set(reader.faults))),
    )


def _names(request: ReportRequest, in_tables: Iterable[str]) -> dict[str, str]:
    """File names of all motors that are shown."""
    ids = {*request.known, *in_tables}
    if strangers := sorted(set(request.motors) - ids):
        there = ", ".join(sorted(ids))
        raise UsageError("unknown_motor", f"no motor {', '.join(strangers)}; there are {there}")
    names = file_names(ids)
    return {one: names[one] for one in sorted(ids) if not request.motors or one in request.motors}


def file_names(motor_ids: Iterable[str]) -> dict[str, str]:
    """A name without ending for each motor: its id, wherever any file system takes it."""
    ids = list(motor_ids)
    sharing = Counter(motor_id.casefold() for motor_id in ids)

    def is_safe(name: str) -> bool:
        is_plain = PLAIN.fullmatch(name) and not DEVICES.match(name)
        return bool(is_plain) and sharing[name.casefold()] == 1

    hashes = {one: hashlib.sha256(one.encode()).hexdigest()[:12] for one in ids}
    return {one: one if is_safe(one) else f"motor-{hashes[one]}" for one in ids}


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
    reader: TableReader,
    folder: Folder,
    nights: Mapping[dt.date, list[str]],
    names: Mapping[str, str],
    program: str,
) -> tuple[dict[str, str], int]:
    """Make the files of nights that are new or changed; states of the nights, and how many."""
    states: dict[str, str] = {}
    n_made = 0
    for month in sorted({night.replace(day=1) for night in nights}):
        labels = [night for night in nights if night.replace(day=1) == month]
        read = TableReader(reader.output)
        of_month = {
            table: read.rows(table, labels).partition_by("night", as_dict=True)
            for table in EXPLAINED
        }
        for night in labels:
            rows = {
                table.name: of_month[table].get((night,), frame(table, [])) for table in EXPLAINED
            }
            state = _state_of(rows, files_of(reader.output, PREDICTIONS, [night]))
            files = [night_file_name(names[motor_id], night) for motor_id in nights[night]]
            is_current = (folder.program, folder.nights.get(str(night))) == (program, state)
            if not (is_current and folder.keep(files)):
                n_made += 1
                of_night = TableReader(reader.output, list(read.faults))
                rows["predictions"] = of_night.rows(PREDICTIONS, [night])
                reader.faults += of_night.faults
                for motor_id, payload in night_payloads(night, rows, of_night.faults).items():
                    if motor_id in names:
                        content = f"motorLeakage.night({script_json(payload)});\n".encode()
                        folder.write(night_file_name(names[motor_id], night), content)
                if of_night.faults:
                    continue  # it is tried again
            states[str(night)] = state
    return states, n_made


def _state_of(rows: Mapping[str, pl.DataFrame], samples: Iterable[Path]) -> str:
    """What a night is made from: its rows, and the files of its samples."""
    sums = [(name, int(of.hash_rows().sum()) if of.height else 0) for name, of in rows.items()]
    stamps = [(one.stat().st_size, one.stat().st_mtime_ns) for one in samples]
    return hashlib.sha256(f"{sums} {stamps}".encode()).hexdigest()[:16]


def night_payloads(
    night: dt.date, tables: Mapping[str, pl.DataFrame], faults: Sequence[str]
) -> dict[str, dict[str, Any]]:
    """What the page of each motor shows of a night: words as of `explain`, and a chart."""
    primary = tables["fits"].filter("is_primary").select(FIT_KEY_NAMES)
    grouped = {
        name: by_motor(
            rows.join(primary, on=FIT_KEY_NAMES, how="semi", maintain_order="left")
            if name != "fits" and set(FIT_KEY_NAMES) <= set(rows.columns)
            else rows
        )
        for name, rows in tables.items()
    }
    payloads = {}
    for motor_id in sorted(primary["motor_id"]):
        own = {name: found.get(motor_id, tables[name].clear()) for name, found in grouped.items()}
        samples = own.pop("predictions")
        words = paragraphs({name: rows.to_dicts() for name, rows in own.items()})
        words += [("Not read", list(faults))] if faults else []
        chart = figure(night_chart(samples))
        payloads[motor_id] = {"night": str(night), "words": words, "figure": chart}
    return payloads


def _make_pages(
    request: ReportRequest,
    reader: TableReader,
    folder: Folder,
    names: Mapping[str, str],
    program: str,
) -> int:
    """Make the fleet's page, the motors' pages, and what they share; how many motors."""
    output, ids = request.output, list(names)
    motors = motor_histories(reader, ids)
    types = {motor_id: one.motor_type for motor_id, one in request.known.items()}
    states = {one.motor_id: one for one in current_states(output, ids)}
    rows = fleet_rows(motors, names, types, states)
    by_id = {row.state.motor_id: row for row in rows}
    alarms = reader.rows(ALARMS).filter(pl.col("motor_id").is_in(ids))
    by_rules = changed_by_rules(alarms).sort(ALARMS.key)
    decisions = read_decisions(output)
    found = Counter(row.state.state for row in rows)
    first, newest = fleet_span(motors) or (None, None)
    facts = {
        "name": request.fleet or fleet_name(reader) or "Fleet",
        "first": first,
        "newest": newest,
        "made": request.made,
        "zone": request.zone,
        "old_after_nights": request.old_after_nights,
        "undelivered": [
            one.words for one in backlogs(output, request.receivers) if one.undelivered
        ],
        "faults": sorted(set(reader.faults)),
    }
    for motor in motors:
        known = request.known.get(motor.motor_id, KnownMotor(""))
        changes = alarms.filter(motor_id=motor.motor_id)
        values = _motor_values(motor, by_id[motor.motor_id], known, changes, folder)
        said = [one for one in decisions if one.motor_id == motor.motor_id]
        page = page_of("motor.html", facts=facts, decisions=said, **values)
        folder.write(f"motors/{names[motor.motor_id]}.html", page.encode())
    index = page_of(
        "fleet.html",
        facts=facts,
        rows=rows,
        by_rules=by_rules.with_columns(page=pl.col("motor_id").replace(names)).to_dicts(),
        counts=[(code, found[code]) for code in ORDER if found[code]],
        parts=read_scores(output, ids, decisions),
    )
    folder.write("index.html", index.encode())
    folder.write("glossary.html", page_of("glossary.html", facts=facts).encode())
    for asset in (FOLDER / "assets").iterdir():
        folder.write(f"assets/{asset.name}", asset.read_bytes())
    # One copy for all pages; it is read only where it has to be written.
    if folder.program != program or not folder.keep([CHART_LIBRARY]):
        from plotly.offline import get_plotlyjs

        folder.write(CHART_LIBRARY, get_plotlyjs().encode())
    return len(motors)


def _motor_values(
    motor: MotorHistory, row: FleetRow, known: KnownMotor, alarms: pl.DataFrame, folder: Folder
) -> dict[str, Any]:
    """What the template of a motor's page names, besides facts and decisions."""
    changes = newest_changes(alarms)
    course = watch_chart(motor, known.paths, known.events, changes)
    statuses = motor.fits["status"].to_list()
    payload = {
        "file": row.page,
        "nights": [str(night) for night in motor.nights],
        "statuses": [STATUSES.get(status, status) for status in statuses],
        "detailed": [
            int(night_file_name(row.page, night) in folder.files) for night in motor.nights
        ],
        "figures": {"course": figure(course), "conditions": figure(conditions_chart(motor))},
    }
    return {
        "row": row,
        "last": motor.fits.row(-1, named=True) if motor.nights else None,
        "marks": course.marks,
        "payload": script_json(payload),
        "changes": changes,
    }


def newest_changes(alarms: pl.DataFrame) -> list[dict[str, Any]]:
    """A motor's newest rows of `alarms`, the newest first."""
    rows = alarms.sort("time", "indicator", descending=[True, False])
    return rows.head(SHOWN_CHANGES).to_dicts()


def fleet_name(reader: TableReader) -> str:
    """Name of the fleet in its newest run; empty where there is none."""
    names = reader.rows(RUNS).sort("started_at")["fleet"].drop_nulls()
    return str(names[-1]) if len(names) else ""


def _program_hash() -> str:
    """Hash of the program's own files: any of them may shape what pages say."""
    package = FOLDER.parent
    files = sorted(one for one in package.rglob("*") if one.is_file() and one.suffix != ".pyc")
    found = hashlib.sha256("".join(map(version, ("jinja2", "plotly"))).encode())
    for file in files:
        found.update(file.read_bytes())
    return found.hexdigest()[:16]
