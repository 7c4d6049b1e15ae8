"""A motor's log files during its task: the record of each, its news, and its content."""

from __future__ import annotations

import datetime as dt
from collections import Counter, OrderedDict
from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

from pipeline.clock import utc
from pipeline.config import MotorSpec
from pipeline.config.hashes import reading_hash
from pipeline.config.nights import Night, night_of, nights_between
from pipeline.errors import LogError
from pipeline.ingest import RawLog, read_log
from pipeline.logs.files import (
    failed_record,
    has_no_span,
    labels_of,
    reaches_us,
    with_coverage,
    with_known_nights,
    without_misdated,
)
from pipeline.logs.finding import FolderLogs, logs_of, require_answer
from pipeline.logs.processed import FileRecord
from pipeline.workers.process import Loss, reading, still_alive

# Logs in memory: that which ends within a night, and that which begins.
LOGS_IN_MEMORY = 2
# A longer silence between two logs is no row of nights without a log: a clock was wrong, or the
# motor stood in store.
LONGEST_HOLE = dt.timedelta(days=366)
# Of the hash of a content, so much tells it from a motor's others.
HASH_LENGTH = 16
# Outcomes of a file in a run: left is left to another run, as a night of it was not done.
FATES = ("read", "unchanged", "growing", "failed", "left")


class MotorLogs:
    """The log files of a motor, by path relative to the log root, each read once while needed.

    `before` are former records of its files; samples after `latest_us` are refused. Files that are
    `silent` did not answer, and are not opened. Without `log_records` the files are inspected.
    """

    def __init__(
        self,
        spec: MotorSpec,
        before: Mapping[str, FileRecord],
        latest_us: int,
        silent: Mapping[str, Loss],
        log_records: Mapping[str, FileRecord] | None = None,
    ) -> None:
        self._spec = spec
        self.before = before
        self._read_with = reading_hash(spec)
        self._latest_us = latest_us
        self._silent = silent
        self.absent: list[str] = []  # those that the config names, and are not there
        records = self._inspect() if log_records is None else log_records
        latest = night_of(latest_us, spec.settings.nights)
        self.files = with_known_nights(without_misdated(records), before, latest)
        self.read: set[str] = set()  # those whose content was read
        self.n_moved = 0  # logs that turned out to have other nights than before they were read
        self._open: OrderedDict[str, RawLog] = OrderedDict()
        # How long the last sample of an on-change channel may hold into the next night.
        self._reach_us = max(reaches_us(spec).values(), default=0)

    @cached_property
    def _source(self) -> FolderLogs:
        """The logs themselves: not asked for anything while nothing of them is needed."""
        return logs_of(self._spec, self._latest_us, self._silent)

    def unmatched(self) -> tuple[str, ...]:
        """Return messages about globs that match no log."""
        return self._source.unmatched()

    def _inspect(self) -> dict[str, FileRecord]:
        """Return each file as its ends tell it."""
        self.absent = self._source.absent
        return {
            name: replace(self._inspect_log(name), read_with=self._read_with)
            for name in self._source.names
        }

    def _inspect_log(self, name: str) -> FileRecord:
        still_alive()
        known = self._known(name)
        if name not in self._silent:
            return self._source.stat_log(name, known)
        if known is not None and known.status == "ok":
            return known  # as far as anybody can tell, it is as it was
        return self._unanswered(FileRecord(name, 0, 0, None))

    def _unanswered(self, record: FileRecord) -> FileRecord:
        """Return the record of a file that is to be tried again by the next run."""
        loss = self._silent[record.path]
        error = LogError(loss.code, Path(record.path), loss.how.removeprefix(f"{record.path} "))
        return failed_record(replace(record, sha256=None), error)

    def _known(self, name: str) -> FileRecord | None:
        """Return the former record of a file, if it was read with the same settings."""
        record = self.before.get(name)
        return record if record and record.read_with == self._read_with else None

    def news_of(self, name: str) -> str | None:
        """Return the news of a file that no run has finished with, as text; None without any."""
        before, known, now = self.before.get(name), self._known(name), self.files[name]
        if before is None:
            return f"new file {name}"
        if known is None:
            return f"{name} is to be read with other settings"
        # An unreadable file has no hash: it may be readable by now.
        if now.sha256 is None or known.sha256 != now.sha256:
            return f"changed file {name}"
        if known.is_ahead and (now.status, now.last_us) != (known.status, known.last_us):
            return f"the clock has passed time stamps of {name}"
        is_newly_known = has_no_span(now) and not labels_of(now) <= labels_of(known)
        return f"the night of {name} is known now" if is_newly_known else None

    def touched(self, name: str) -> set[dt.date]:
        """Return nights in which a file has samples, or had them before it was changed."""
        record = self.files[name]
        return labels_of(record) | labels_of(self.before.get(name, record))

    def reached(self, name: str) -> set[dt.date]:
        """Return nights into which a file's last samples may hold, or might before a change."""
        if not self._reach_us:
            return set()
        record, nights = self.files[name], self._spec.settings.nights
        ends = {each.last_us for each in (record, self.before.get(name, record))}
        reached = (
            nights_between(night_of(end, nights), night_of(end + self._reach_us, nights))
            for end in ends
            if end is not None
        )
        return set().union(*reached)

    def present(self) -> set[dt.date]:
        """Return nights in which any file has samples."""
        return {label for record in self.files.values() for label in labels_of(record)}

    def waiting(self) -> set[dt.date]:
        """Return nights that wait for the next run, as their file changes while it is read."""
        return {
            label
            for name, record in self.files.items()
            if record.status == "growing"
            for label in self.touched(name)
        }

    def holes(self, certain: Collection[dt.date]) -> set[dt.date]:
        """Return nights that no log covers between those of readable logs and `certain` ones."""
        # A file that cannot be read may stand far off: its night is a guess.
        readable = (labels_of(file) for file in self.files.values() if file.status == "ok")
        between = {
            label
            for first, last in pairwise(sorted(set(certain).union(*readable)))
            if last - first <= LONGEST_HOLE
            for label in nights_between(first, last)
        }
        return between - self.present()

    def contents_of(self, label: dt.date) -> tuple[str, ...]:
        """Return hashes of the contents of a night's files, cut short, in order."""
        records = (self.files[name] for name in self.of_night(label))
        return tuple(record.sha256[:HASH_LENGTH] for record in records if record.sha256)

    def has_contents(self, hashes: Collection[str]) -> bool:
        """Return True where all contents of some hashes are there, under whatever names."""
        sound = (record.sha256 for record in self.files.values() if record.status == "ok")
        return bool(hashes) and {own[:HASH_LENGTH] for own in sound if own}.issuperset(hashes)

    def of_night(self, label: dt.date) -> list[str]:
        """Return files of a night, in order of time."""
        names = (name for name, record in self.files.items() if label in labels_of(record))
        return sorted(names, key=self._begin)

    def before_night(self, here: Night) -> list[str]:
        """Return files before a night of which an on-change channel may hold into it."""
        names = (
            name
            for name, record in self.files.items()
            if record.status == "ok"
            and record.last_us is not None
            and here.start_us - self._reach_us <= record.last_us < here.start_us
        )
        return sorted(names, key=self._begin)

    def _begin(self, name: str) -> tuple[int, str]:
        return self.files[name].first_us or 0, name

    def content(self, name: str) -> RawLog | None:
        """Return a log's content, read once while it is needed.

        None where it cannot be read, or was changed since it was looked at: that goes into its
        record.
        """
        if name in self._open:
            self._open.move_to_end(name)
            return self._open[name]
        record = self.files[name]
        if record.status != "ok":
            return None
        if name in self._silent:
            self.files[name] = self._unanswered(record)
            return None
        try:
            file, path = self._spec.file, self._source.path(name)
            require_answer(name, path)
            with reading(name):
                content = read_log(path, file.logs, file.channels, self._latest_us)
            new = with_coverage(record, content, self._spec)
        except LogError as error:
            new = failed_record(record, error)
        why = self._source.change_of(record)
        new = new if why is None else failed_record(record, why)
        self.n_moved += (new.nights, new.status) != (record.nights, record.status)
        self.files[name] = new
        if new.status != "ok":
            self.read.discard(name)
            return None
        self.read.add(name)
        self._open[name] = content
        if len(self._open) > LOGS_IN_MEMORY:
            self._open.popitem(last=False)
        return content

    def let_go_until(self, label: dt.date) -> None:
        """Give up contents that no later night needs."""
        for name in list(self._open):
            if max(self.touched(name) | self.reached(name), default=label) <= label:
                del self._open[name]

    def in_time(self) -> list[tuple[dt.date, str]]:
        """Return the last night and the name of each log that can be read, in order of time."""
        return sorted(
            (max(labels), name)
            for name, record in self.files.items()
            if record.status == "ok" and (labels := labels_of(record))
        )

    def path(self, name: str) -> Path:
        """Return a file with the content of a log; raises LogError as `FolderLogs.path`."""
        return self._source.path(name)

    def finished(self, done: Collection[dt.date]) -> dict[str, FileRecord]:
        """Return files of which every night is done: the others stay new for a later run."""
        nights, present = set(done), self.present()
        return {
            name: record
            for name, record in self.files.items()
            if record.status != "growing"
            and (
                self.news_of(name) is None
                or self.touched(name) | (self.reached(name) & present) <= nights
            )
        }

    def counts(self, done: Collection[dt.date]) -> Counter[str]:
        """Return number of files by outcome of `FATES`."""
        finished = self.finished(done)
        return Counter(self._fate(name, finished) for name in self.files)

    def _fate(self, name: str, finished: Mapping[str, FileRecord]) -> str:
        if self.files[name].status != "ok":
            return self.files[name].status
        if name not in finished:
            return "left"
        return "read" if name in self.read else "unchanged"

    def growing(self) -> list[str]:
        """Return messages about files that change while they are read."""
        records = (record for _, record in sorted(self.files.items()))
        return [record.message or "" for record in records if record.status == "growing"]

    def left_out(self) -> list[str]:
        """Return messages about files that were read, and of which rows were left out."""
        return [
            f"{name}: {self.files[name].message}"
            for name in sorted(self.read)
            if self.files[name].status == "ok" and self.files[name].message
        ]

    def rows(self) -> list[dict[str, Any]]:
        """Return rows of `log_files`: each file once, with its first night, if any."""
        return [
            {
                "motor_id": self._spec.motor_id,
                "path": name,
                "night": min(labels_of(record), default=None),
                "format": self._spec.file.logs.format,
                "size_bytes": record.size,
                "rows": record.rows,
                "first_time": None if record.first_us is None else utc(record.first_us),
                "last_time": None if record.last_us is None else utc(record.last_us),
                "status": record.status,
                "error_code": record.error_code,
                "message": record.message,
            }
            for name, record in sorted(self.files.items())
            if record.status != "growing"
        ]
