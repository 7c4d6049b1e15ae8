"""The report as a whole: read the tables, make what has changed, leave the rest."""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import textwrap
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from itertools import groupby
from pathlib import Path
from typing import Any

import polars as pl
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from leakage import AnnularGap
from pipeline.config import Fleet
from pipeline.errors import StoreError
from pipeline.messages import ABSENT, as_sentence, plain
from pipeline.messages import figure as figure_words
from pipeline.notification.outbox import backlogs, receivers_of
from pipeline.report.charts import (
    fleet_span,
    night_chart,
    overlay,
    residual_chart,
    sparkline,
    watch_chart,
)
from pipeline.report.explain import EXPLAINED, conditions, of_model, paragraphs
from pipeline.report.plotly_json import figure, script_json
from pipeline.report.status import (
    MotorHistory,
    by_motor,
    current_states,
    finite_rows,
    motor_histories,
)
from pipeline.schema import ALARMS, NIGHTS, PREDICTIONS, frame
from pipeline.store.atomic_files import (
    TEMPORARY_PREFIX,
    flush_path,
    put,
    remove_leftovers,
    store_errors,
)
from pipeline.store.tables import read_rows, table_folder
from pipeline.trends.decisions import read_decisions
from pipeline.trends.motor_states import ORDER, MotorState, urgency, what_of
from pipeline.trends.sentences import cause_words, change_of, part_of

FOLDER = Path(__file__).parent
MANIFEST = "manifest.json"
CHART_LIBRARY = "assets/plotly.min.js"
# Of changes of state a page lists the newest.
SHOWN_CHANGES = 200
# Letters of such a change before it is opened.
LONGEST_SUMMARY = 90
INDICATORS = {
    "pressure_zero": "zero of the pressure sensor",
    "flow_zero": "zero of the flow sensor",
}
# A state has the name that the tables have; the pages say its meaning beside.
STATES = {
    "alarm": "the leakage is above the alarm level, or above the motor type's own limit",
    "warning": "a change was detected and is in force",
    "common_cause": "the other motors of the oil circuit have changed alike",
    "stale": "no night with samples for long: the present state is unknown",
    "removed": "in the config no more, and nobody has confirmed it",
    "insufficient": "too few nights for a baseline, or to show a change",
    "ok": "no change was detected; each motor says how small a step would have been",
}


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

    def __init__(self, path: Path, program: str) -> None:
        self.path, self.program = path, program
        # Files that the report has now with a digest of what they are made from, and those of the
        # last report.
        self.files: dict[str, str] = {}
        self.before: dict[str, str] = {}
        self.written: list[Path] = []
        manifest = path / MANIFEST
        if manifest.exists():
            # Without a sound index all files are made anew, over the present ones.
            with suppress(OSError, ValueError, KeyError, TypeError):
                last = json.loads(manifest.read_bytes())
                is_same, files = last["program"] == program, dict(last["files"])
                self.before = files if is_same else dict.fromkeys(files, "")
            return
        if path.exists() and not path.is_dir():
            raise StoreError("report_folder", f"{path} is no folder; name another")
        for entry in sorted(path.iterdir()) if path.exists() else ():
            if not entry.name.startswith(TEMPORARY_PREFIX):
                message = f"{path} holds {entry.name} and no report; name an empty or new folder"
                raise StoreError("report_folder", message)
        put(manifest, b"{}")

    def write(self, name: str, content: bytes, digest: str = "") -> None:
        """Write a file unless it is there with that content."""
        self.files[name] = digest
        path = self.path / name
        if not (path.exists() and path.read_bytes() == content):
            put(path, content, durable=False)
            self.written.append(path)

    def keep(self, name: str, digest: str = "") -> bool:
        """Leave a file of the last report as it is; False if it is gone or made from other data."""
        known = self.before.get(name)
        if not known or (digest and known != digest) or not (self.path / name).is_file():
            return False
        self.files[name] = known
        return True

    def close(self) -> int:
        """Remove files that the report has no more, and remember the others; how many went."""
        gone = sorted(self.before.keys() - self.files)
        for name in gone:
            path = self.path / name
            # Nothing outside the report is removed, whatever the manifest lists.
            if path.resolve().is_relative_to(self.path.resolve()):
                with suppress(OSError):
                    path.unlink()
                    path.parent.rmdir()
        with store_errors(self.path):
            # At the end: what the first ones wait for is true of the later ones as well.
            for path in (*self.written, *{file.parent for file in self.written}):
                flush_path(path)
        manifest = {"program": self.program, "files": self.files}
        content = json.dumps(manifest, separators=(",", ":"), sort_keys=True).encode()
        if (self.path / MANIFEST).read_bytes() != content:
            put(self.path / MANIFEST, content)
        return len(gone)


def build_report(
    fleet: Fleet,
    folder: Path,
    *,
    nights: int | None = None,
    made: dt.datetime | None = None,
    config: str = "CONFIG",
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> ReportResult:
    """Write the report of a fleet's motors to a folder, or of a present report what has changed.

    `nights`: newest nights that get a file of their own; None for all. `made`: time of making,
    which the fleet's page shows; None: it shows none. `config`: the fleet file in commands.
    `progress`: called with the nights that are done, and how many there are.

    Raises StoreError if there are no tables, any is damaged or of a newer version of the program,
    or the folder cannot be written or holds something else.
    """
    if not table_folder(fleet.output, NIGHTS).is_dir():
        raise StoreError(
            "report_tables",
            f"{fleet.output} holds no table of nights; run fit-fleet first; if it found no log, "
            "run check",
        )
    report = Folder(folder, _program_hash())
    remove_leftovers(folder, below=True)
    states = current_states(fleet.output, [spec.motor_id for spec in fleet.motors])
    ids = [state.motor_id for state in states]
    n_nights = _make_nights(fleet.output, ids, report, nights, progress)
    _make_pages(fleet, states, made, report, config)
    return ReportResult(len(states), n_nights, len(report.written), report.close())


def night_file_name(motor_id: str, night: dt.date) -> str:
    """Return path of a night's file within the report."""
    return f"data/{motor_id}/{night}.js"


def _make_nights(
    output: Path,
    ids: Sequence[str],
    folder: Folder,
    newest: int | None,
    progress: Callable[[int, int], None],
) -> int:
    """Make the files of motors' nights that are new or changed; return of how many nights."""
    rows = read_rows(output, NIGHTS, ids).sort("night", "motor_id")
    # By night and motor. The run in a row stands for what else it wrote of the night.
    digests: dict[dt.date, dict[str, str]] = {}
    for motor, night, digest in zip(rows["motor_id"], rows["night"], rows.hash_rows(), strict=True):
        digests.setdefault(night, {})[motor] = f"{digest:016x}"
    shown = list(digests) if newest is None else list(digests)[max(len(digests) - newest, 0) :]
    changed = [
        (night, motor)
        for night in shown
        for motor, digest in digests[night].items()
        if not folder.keep(night_file_name(motor, night), digest)
    ]
    for _, month in groupby(changed, key=lambda new: (new[0].year, new[0].month)):
        new = list(month)
        tables = _rows_of(output, new)
        for night, motor in new:
            own = {name: of[night, motor] for name, of in tables.items() if (night, motor) in of}
            content = f"motorLeakage.night({script_json(night_payload(night, own))});\n"
            folder.write(night_file_name(motor, night), content.encode(), digests[night][motor])
            progress(shown.index(night) + 1, len(shown))
    return len({night for night, _ in changed})


def _rows_of(
    output: Path, nights: Sequence[tuple[dt.date, str]]
) -> Mapping[str, Mapping[tuple[Any, ...], pl.DataFrame]]:
    """Return rows by table, night and motor."""
    labels, motors = (sorted(set(part)) for part in zip(*nights, strict=True))
    return {
        table.name: finite_rows(output, table, motors, labels).partition_by(
            "night", "motor_id", as_dict=True
        )
        for table in EXPLAINED
    }


def night_payload(night: dt.date, rows: Mapping[str, pl.DataFrame]) -> dict[str, Any]:
    """Return what a motor's page shows of a night: words as of `explain`, and a chart."""
    none = pl.DataFrame()
    listed = {table.name: rows.get(table.name, none).to_dicts() for table in EXPLAINED}
    mode = listed["nights"][0]["flushing_mode"]
    samples = rows.get("predictions", frame(PREDICTIONS, [])).filter(flushing_mode=mode)
    tests = [row for row in listed["residual_tests"] if row["flushing_mode"] == mode]
    return {
        "night": str(night),
        "words": paragraphs(listed),
        "figure": figure(night_chart(samples)),
        "residuals": figure(residual_chart(tests)),
    }


def _make_pages(
    fleet: Fleet,
    states: Sequence[MotorState],
    made: dt.datetime | None,
    folder: Folder,
    config: str,
) -> None:
    """Make the fleet's page, the motors' pages, and what they share."""
    histories = motor_histories(fleet, states)
    motors = sorted(histories, key=lambda motor: urgency(motor.state))
    counts = Counter(state.state for state in states)
    span = fleet_span(motors)
    waiting = backlogs(fleet.output, receivers_of(fleet.settings.alarms))
    facts = {
        "name": fleet.name,
        "config": config,
        "zone": fleet.settings.nights.zone,
        "old_after_nights": fleet.settings.alarms.stale_after_nights,
    }
    _make_motor_pages(fleet.output, motors, facts, folder)
    curves = script_json(overlay(histories, fleet.settings.alarms.alarm_percent))
    folder.write("curves.js", f"motorLeakageFleet({curves});\n".encode())
    facts |= {
        "first": span and span[0],
        "newest": span and span[1],
        "made": made,
        "undelivered": [backlog.words for backlog in waiting if backlog.undelivered],
    }
    shown = [(code, counts[code]) for code in ORDER if counts[code]]
    lines = {motor.motor_id: sparkline(motor, span) if span else "" for motor in motors}
    index = page_of("fleet.html", facts=facts, rows=motors, lines=lines, counts=shown)
    folder.write("index.html", index.encode())
    folder.write("glossary.html", page_of("glossary.html", facts=facts).encode())
    for asset in (FOLDER / "assets").iterdir():
        folder.write(f"assets/{asset.name}", asset.read_bytes())
    # A copy for all pages; it is read only where it has to be written.
    if not folder.keep(CHART_LIBRARY):
        from plotly.offline import get_plotlyjs

        folder.write(CHART_LIBRARY, get_plotlyjs().encode(), folder.program)


def _make_motor_pages(
    output: Path, motors: Sequence[MotorHistory], facts: Mapping[str, Any], folder: Folder
) -> None:
    """Make the pages of motors of which something has changed."""
    alarms = by_motor(read_rows(output, ALARMS, [motor.motor_id for motor in motors]))
    decisions = read_decisions(output)
    for motor in motors:
        motor_id, spec = motor.motor_id, motor.spec
        changes = newest_changes(alarms.get(motor_id, frame(ALARMS, [])))
        own = [decision for decision in decisions if decision.motor_id == motor_id]
        # The run in a row stands for what else it wrote.
        rows = {name: int(of.hash_rows().sum()) for name, of in motor.trends.items()}
        rows["nights"] = int(motor.rows.hash_rows().sum())
        # What the page says nothing of leaves it as it is.
        state = {name: of for name, of in motor.state.row.items() if name != "data_age_nights"}
        stated = (spec.motor_type, spec.file) if spec else ()
        parts = (rows, state, motor.state.intraday, motor.reference, changes, own, facts, stated)
        digest = hashlib.sha256(repr(parts).encode()).hexdigest()[:16]
        if not folder.keep(name := f"motors/{motor_id}.html", digest):
            values = _motor_values(motor, changes)
            page = page_of("motor.html", facts=facts, decisions=own, **values)
            folder.write(name, page.encode(), digest)


def _motor_values(motor: MotorHistory, changes: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return what the template of a motor's page names, besides facts and decisions."""
    paths = motor.spec.motor_type.paths() if motor.spec else ()
    events = motor.spec.file.events if motor.spec else ()
    course = watch_chart(motor, [path.name for path in paths], events, changes)
    payload = {
        "file": motor.motor_id,
        "nights": [str(night) for night in motor.nights],
        "statuses": [plain(status) for status in motor.rows["status"]],
        "course": figure(course),
    }
    return {
        "row": motor,
        "last": motor.rows.row(-1, named=True) if motor.nights else None,
        "marks": course.marks,
        "parts": [(path.name, isinstance(path, AnnularGap)) for path in paths],
        "payload": script_json(payload),
        "changes": changes,
    }


def newest_changes(alarms: pl.DataFrame) -> list[dict[str, Any]]:
    """Return a motor's newest rows of `alarms`, the newest first."""
    rows = alarms.sort("night", "id", descending=[True, False]).head(SHOWN_CHANGES)
    return [row | {"indicator": what_of(row), "summary": _summary(row)} for row in rows.to_dicts()]


def _summary(change: Mapping[str, Any]) -> str:
    """Return a change of state in a few words: its size and part, else how its sentence begins."""
    part = f", {part_of(change['cause'])}" if change["cause"] else ""
    size = change_of(change)
    words = f"{size}{part}" if size else change["sentence"].partition(";")[0]
    return textwrap.shorten(words, LONGEST_SUMMARY, placeholder=" …")


def candidates(causes: Sequence[Mapping[str, Any]] | None) -> list[tuple[str, float]]:
    """Return causes in words with their probabilities, as a row of `nights` lists them."""
    return [(cause_words(cause["cause"]), cause["probability"]) for cause in causes or ()]


def page_of(template: str, **values: Any) -> str:
    """Return the HTML of a page; `values` are what its template names."""
    return _environment().get_template(template).render(**values)


@cache
def _environment() -> Environment:
    """Return the templates, which escape whatever is put into them."""
    environment = Environment(
        loader=FileSystemLoader(FOLDER / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "candidates": candidates,
        "change": change_of,
        "figure": figure_words,
        "of_model": of_model,
        "plain": plain,
        "sentence": as_sentence,
    }
    environment.globals |= {
        "absent": ABSENT,
        "conditions": conditions,
        "indicators": INDICATORS,
        "states": STATES,
    }
    return environment


def _program_hash() -> str:
    """Return hash of the program's own files: any of them may shape what pages say."""
    package = FOLDER.parent
    files = sorted(path for path in package.rglob("*") if path.is_file() and path.suffix != ".pyc")
    digest = hashlib.sha256("".join(map(version, ("jinja2", "plotly"))).encode())
    for file in files:
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
