"""One motor's task: what is new in its logs, which nights that touches, and the fit of each.

The task reads the logs and its own ledger, writes only into its own staging files, and returns a
small outcome. Whatever goes wrong with a log or a night is a row, not an exception.
"""

from __future__ import annotations

import datetime as dt
import logging
import resource
import time
from collections import Counter, OrderedDict, defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

from threadpoolctl import threadpool_limits

from pipeline.config import MotorSpec
from pipeline.errors import LogError, StoreError
from pipeline.ingest import RawLog, read_log
from pipeline.ledger import FileRecord, Ledger, NightRecord, read_ledger
from pipeline.logs import (
    covered,
    failed,
    find_logs,
    inspect_log,
    labels_of,
    legible,
    place_failed,
    slice_night,
)
from pipeline.motor_night import (
    FAILED,
    NO_NEW_DATA,
    OK,
    NightOutcome,
    PreviousModel,
    fit_night,
    unfitted,
)
from pipeline.night_rows import Row, utc
from pipeline.night_statistics import hash_of
from pipeline.nights import night, nights_between
from pipeline.schema import FITS, NIGHT_TABLES
from pipeline.store import night_file, stage

log = logging.getLogger(__name__)

# Raise it when the code makes other figures of the same statistics: everything is then done anew.
FIGURES_VERSION = 2
# Logs kept in memory: one that ends and one that begins within a night.
LOGS_IN_MEMORY = 2
# A longer silence between two logs is no row of nights without a log: a clock was wrong, or the
# motor stood in store.
LONGEST_HOLE = dt.timedelta(days=366)


@dataclass(frozen=True, slots=True)
class MotorTask:
    """What a worker needs to do a motor: plain data, small enough to send.

    Attributes
    ----------
    spec
        The motor with its resolved config.
    output
        Output folder, for the ledger (read only).
    staging
        Folder for this run's staged rows.
    since, until
        Labels of the first and last night to do; None: no limit.
    """

    spec: MotorSpec
    output: Path
    staging: Path
    since: dt.date | None = None
    until: dt.date | None = None

    def wants(self, label: dt.date) -> bool:
        """Whether a night lies within the asked-for range."""
        return (self.since is None or label >= self.since) and (
            self.until is None or label <= self.until
        )


@dataclass(frozen=True, slots=True)
class MotorOutcome:
    """What came of a motor in a run.

    Attributes
    ----------
    status
        failed if a night failed; else ok if a night was fitted; else what came of its nights.
    error_code, message
        The first failure.
    counts
        Nights by outcome.
    nights
        Labels of the nights whose rows are staged.
    inputs
        Hashes of the contents that were read, in the order of the files.
    ledger
        The motor's new ledger, to be written once its rows are published.
    seconds
        Time by stage.
    peak_memory_mib
        Largest memory of the worker so far.
    """

    motor_id: str
    status: str
    error_code: str | None = None
    message: str | None = None
    counts: Mapping[str, int] = field(default_factory=dict)
    nights: tuple[dt.date, ...] = ()
    inputs: tuple[str, ...] = ()
    ledger: Ledger | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    peak_memory_mib: float | None = None


def settings_hash(spec: MotorSpec) -> str:
    """Hash of all that shapes a motor's figures; not of how the work is spread, or where."""
    return hash_of(
        {
            "version": FIGURES_VERSION,
            "motor": spec.file.model_dump(
                mode="json", exclude={"override": True, "events": {"__all__": {"note"}}}
            ),
            "type": spec.motor_type.model_dump(mode="json"),
            "oils": {name: oil.model_dump(mode="json") for name, oil in sorted(spec.oils.items())},
            "settings": spec.settings.model_dump(mode="json"),
        }
    )


def run_motor(task: MotorTask) -> MotorOutcome:
    """Do everything that is new for a motor, and stage its rows.

    Returns
    -------
    MotorOutcome
        Also where the task failed as a whole: with status ``failed`` and no nights.
    """
    with threadpool_limits(1):
        try:
            return _Nights(task).run()
        except StoreError as error:
            return lost(task, error.code, error.message)
        except Exception as error:  # the edge of a motor's task: it must not take others down
            log.exception("motor %s failed", task.spec.motor_id)
            return lost(task, "internal", legible(f"{type(error).__name__}: {error}"))


def lost(task: MotorTask, code: str, message: str) -> MotorOutcome:
    """The outcome of a motor whose task was lost as a whole."""
    return MotorOutcome(task.spec.motor_id, FAILED, code, message)


def _hash_of_model(model: PreviousModel) -> str:
    return _hash_of_items(tuple(sorted((mode, tuple(theta)) for mode, theta in model.items())))


@lru_cache(maxsize=8192)
def _hash_of_items(items: tuple[tuple[str, tuple[float, ...]], ...]) -> str:
    return hash_of(dict(items))


def _still_published(ledger: Ledger, output: Path) -> Ledger:
    """A ledger without the nights whose tables somebody removed: they are to be made anew."""
    gone = {label for label in ledger.nights if not night_file(output, FITS, label).exists()}
    return replace(
        ledger,
        files={name: one for name, one in ledger.files.items() if not labels_of(one) & gone},
        nights={label: one for label, one in ledger.nights.items() if label not in gone},
    )


class _Nights:
    """A motor's files and nights while its task works through them."""

    def __init__(self, task: MotorTask) -> None:
        self.task = task
        self.spec = task.spec
        remembered = read_ledger(task.output, task.spec.motor_id, settings_hash(task.spec))
        self.before = _still_published(remembered, task.output)
        self.paths: dict[str, Path] = {}
        self.files: dict[str, FileRecord] = {}
        self.open_logs: OrderedDict[str, RawLog] = OrderedDict()
        self.read: set[str] = set()
        self.done: dict[dt.date, NightOutcome] = {}
        self.judged_with: dict[dt.date, str] = {}
        self.seconds: defaultdict[str, float] = defaultdict(float)

    def run(self) -> MotorOutcome:
        absent = self._look()
        # Reading may show that a log covers other nights than its ends had told, so look again.
        while todo := self._todo():
            label = min(todo)
            before = self._model_before(label)
            outcome = self._night(label, before)
            self.done[label] = outcome
            self.judged_with[label] = _hash_of_model(before)
            for stage_name, seconds in outcome.seconds.items():
                self.seconds[stage_name] += seconds
        for label in self._holes():
            reason = "no log covers this night"
            self.done[label] = unfitted(self.spec, label, NO_NEW_DATA, reason)
        self._stage()
        return self._outcome(absent)

    def _look(self) -> list[str]:
        """Bring together what is known of all files; returns those that are named but absent."""
        begin = time.perf_counter()
        self.paths, absent = find_logs(self.spec)
        looked_at = {
            name: inspect_log(name, path, self.before.files.get(name), self.spec)
            for name, path in self.paths.items()
        }
        self.files = place_failed(looked_at, self.before.files, self.spec)
        self.seconds["read_s"] += time.perf_counter() - begin
        return absent

    def _is_new(self, name: str) -> bool:
        before, now = self.before.files.get(name), self.files[name]
        return before is None or now.sha256 is None or before.sha256 != now.sha256

    def _todo(self) -> set[dt.date]:
        """Nights still to do within the asked-for range."""
        new = {label for name in self.files if self._is_new(name) for label in self._touched(name)}
        todo = (new - self.done.keys()) | self._outdated()
        return {label for label in todo if self.task.wants(label)}

    def _touched(self, name: str) -> set[dt.date]:
        """Nights in which a file has samples, or had them before it was changed."""
        record = self.files[name]
        return labels_of(record) | labels_of(self.before.files.get(name, record))

    def _present(self) -> set[dt.date]:
        return {label for record in self.files.values() for label in labels_of(record)}

    def _nights(self) -> dict[dt.date, NightRecord]:
        """What is known of every night by now."""
        fresh = {
            label: NightRecord(one.status, one.model, self.judged_with.get(label, ""))
            for label, one in self.done.items()
        }
        return {**self.before.nights, **fresh}

    def _outdated(self) -> set[dt.date]:
        """Nights with a fit that was judged with another model than the one before it now."""
        present, outdated = self._present(), set()
        before = _hash_of_model({})
        for label, record in sorted(self._nights().items()):
            if not record.model:
                continue
            if record.judged_with != before and label in present:
                outdated.add(label)
            before = _hash_of_model(record.model)
        return outdated

    def _holes(self) -> list[dt.date]:
        """Nights between two logs that no log covers and no row tells of yet."""
        if not self.done:
            return []
        known = self._nights()
        told = self._present() | known.keys()
        # A file that cannot be read may stand far off: its night is a guess.
        readable = [record for record in self.files.values() if record.status == "ok"]
        certain = {label for record in readable for label in labels_of(record)}
        certain |= {label for label, record in known.items() if record.status != FAILED}
        between = {
            label
            for first, last in pairwise(sorted(certain))
            if last - first <= LONGEST_HOLE
            for label in nights_between(first, last)
        }
        return sorted(label for label in between - told if self.task.wants(label))

    def _night(self, label: dt.date, before: PreviousModel) -> NightOutcome:
        names = sorted(
            (name for name, record in self.files.items() if label in labels_of(record)),
            key=lambda name: (self.files[name].first_us or 0, name),
        )
        begin = time.perf_counter()
        logs = [self._log(name) for name in names]
        self.seconds["read_s"] += time.perf_counter() - begin
        broken = [self.files[name] for name in names if self.files[name].status == "failed"]
        if broken:
            return unfitted(
                self.spec, label, FAILED, broken[0].message or "", code=broken[0].error_code
            )
        here = night(label, self.spec.settings.nights)
        channels = slice_night([one for one in logs if one is not None], here)
        if not any(len(channel.time_us) for channel in channels.values()):
            return unfitted(self.spec, label, NO_NEW_DATA, "no log covers this night")
        try:
            return fit_night(self.spec, here, channels, before)
        except Exception as error:  # a fault of ours in one night must not cost the motor's others
            log.exception("motor %s, night %s failed", self.spec.motor_id, label)
            reason = legible(f"{type(error).__name__}: {error}")
            return unfitted(self.spec, label, FAILED, reason, code="internal")

    def _log(self, name: str) -> RawLog | None:
        """A log's content, read once while it is needed; a failure goes into its record."""
        if name in self.open_logs:
            self.open_logs.move_to_end(name)
            return self.open_logs[name]
        record = self.files[name]
        if record.status == "failed":
            return None
        try:
            content = read_log(self.paths[name], self.spec.file.log_source())
        except LogError as error:
            self.files[name] = failed(record, error)
            return None
        self.read.add(name)
        self.files[name] = covered(record, content, self.spec)
        self.open_logs[name] = content
        if len(self.open_logs) > LOGS_IN_MEMORY:
            self.open_logs.popitem(last=False)
        return content

    def _model_before(self, label: dt.date) -> PreviousModel:
        return replace(self.before, nights=self._nights()).model_before(label)

    def _stage(self) -> None:
        begin = time.perf_counter()
        rows = {label: dict(outcome.rows) for label, outcome in self.done.items()}
        for row in self._file_rows():
            if row["night"] in rows:
                rows[row["night"]].setdefault("input_files", []).append(row)
        for table in NIGHT_TABLES if rows else ():
            path = self.task.staging / table.name / f"{self.spec.motor_id}.arrow"
            stage(path, table, {label: part.get(table.name, []) for label, part in rows.items()})
        self.seconds["store_s"] += time.perf_counter() - begin

    def _file_rows(self) -> list[Row]:
        """Rows of `input_files`: each file once, under its first night."""
        return [
            {
                "motor_id": self.spec.motor_id,
                "path": name,
                "night": min(labels_of(record)),
                "format": self.spec.file.logs.format,
                "size_bytes": record.size,
                "sha256": record.sha256,
                "rows": record.rows,
                "first_time": None if record.first_us is None else utc(record.first_us),
                "last_time": None if record.last_us is None else utc(record.last_us),
                "status": record.status,
                "error_code": record.error_code,
                "message": record.message,
            }
            for name, record in sorted(self.files.items())
            if record.nights
        ]

    def _finished_files(self) -> dict[str, FileRecord]:
        """Files of which every night is done: the others stay new, for a run that wants them."""
        return {
            name: record
            for name, record in self.files.items()
            if not self._is_new(name) or self._touched(name) <= self.done.keys()
        }

    def _outcome(self, absent: list[str]) -> MotorOutcome:
        counts = Counter(outcome.status for outcome in self.done.values())
        errors: list[tuple[str | None, str | None]] = [
            (one.error_code, f"night {label}: {one.reason}")
            for label, one in sorted(self.done.items())
            if one.status == FAILED
        ]
        errors += [
            (record.error_code, record.message)
            for record in self.files.values()
            if record.status == "failed" and not record.nights
        ]
        errors += [("log_missing", f"{name}: named in the config and absent") for name in absent]
        if errors:
            status = FAILED
        elif counts[OK]:
            status = OK
        else:
            status = counts.most_common(1)[0][0] if counts else NO_NEW_DATA
        code, message = errors[0] if errors else (None, None)
        return MotorOutcome(
            motor_id=self.spec.motor_id,
            status=status,
            error_code=code,
            message=message,
            counts=counts,
            nights=tuple(sorted(self.done)),
            inputs=tuple(self.files[name].sha256 or "" for name in sorted(self.read)),
            ledger=replace(
                self.before,
                files={**self.before.files, **self._finished_files()},
                nights=self._nights(),
            ),
            seconds=dict(self.seconds),
            peak_memory_mib=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        )
