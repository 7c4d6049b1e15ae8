"""A motor's log files during its task: the record of each, and its news."""

from __future__ import annotations

import datetime as dt
from collections import Counter, OrderedDict
from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

from polars.exceptions import PanicException

from pipeline.clock import utc
from pipeline.config import MotorSpec
from pipeline.config.hashes import reading_hash
from pipeline.config.nights import Night, night_of, nights_between
from pipeline.errors import LogError
from pipeline.ingest import RawLog, header_units, read_log
from pipeline.logs.files import NEW_LOG, covered, failed, growing, labels_of, reaches_us
from pipeline.logs.finding import require_answer
from pipeline.logs.ledger import FileRecord, SeenLogs
from pipeline.logs.locations import LogSource, logs_of
from pipeline.logs.told_nights import PlausibleNights, is_newly_told, place_failed
from pipeline.workers.process import Loss, reading, sign_of_life, told_alive

# Logs kept in memory: one that ends and one that begins within a night.
LOGS_IN_MEMORY = 2
# Outcomes of a file in a run: left is left to another run, as one of its nights was not done.
FATES = ("read", "unchanged", "growing", "failed", "left")


class LogShelf:
    """The log files of a motor, each read once while it is needed.

    Parameters
    ----------
    spec
        The motor.
    before
        Former records of its files.
    latest_us
        Samples after this time are refused [µs since 1970].
    silent
        Those that did not answer: none is opened.
    looked_at
        What another task of this run has seen of them; none is then looked at again.
    reads_new
        Read a log at once where it is the only new one: its ends are then those of its samples.

    Attributes
    ----------
    files
        Present record of each file, by path relative to the log root.
    before
        Former records, without nights that are no longer plausible.
    absent
        Those that are named in the config and absent.
    read
        Paths of those whose content was read.
    plausible
        Nights that the name or time of an unreadable one may tell.
    """

    def __init__(
        self,
        spec: MotorSpec,
        before: Mapping[str, FileRecord],
        latest_us: int,
        silent: Mapping[str, Loss],
        looked_at: SeenLogs | None = None,
        *,
        reads_new: bool = False,
    ) -> None:
        self._spec = spec
        self.before: Mapping[str, FileRecord] = before
        self._read_with = reading_hash(spec)
        self._latest_us = latest_us
        self._silent = silent
        self._read_ahead: dict[Path, RawLog] = {}
        seen = looked_at or SeenLogs(self._look(reads_new), self._source.absent)
        found, self.absent = seen.files, seen.absent
        latest = night_of(latest_us, spec.settings.nights)
        self.plausible = PlausibleNights.of((*found.values(), *before.values()), latest)
        self.before = {name: self.plausible.only_plausible(one) for name, one in before.items()}
        self.files = place_failed(found, self.before, spec, self.plausible)
        self.read: set[str] = set()
        self._open: OrderedDict[str, RawLog] = OrderedDict()
        self._units: dict[str, Mapping[str, str]] = {}
        # How long the last sample of an on-change channel may hold into the next night.
        self._reach_us = max(reaches_us(spec).values(), default=0)

    @cached_property
    def _source(self) -> LogSource:
        """The logs themselves: not asked for anything while nothing of them is needed."""
        return logs_of(self._spec, self._latest_us, self._silent)

    def unmatched(self) -> tuple[str, ...]:
        """Messages about globs that match no log."""
        return self._source.unmatched()

    def _look(self, reads_new: bool) -> dict[str, FileRecord]:
        """Each file as its ends tell it."""
        new = [name for name in self._source.names if name not in self.before]
        alone = new if reads_new and len(new) == 1 else []
        return {
            name: replace(self._look_at(name, name in alone), read_with=self._read_with)
            for name in told_alive(self._source.names)
        }

    def _look_at(self, name: str, is_read: bool) -> FileRecord:
        known = self._known(name)
        if name not in self._silent and is_read:
            sign_of_life(NEW_LOG)
            found = self._source.look_at(name, None, self._ends_of_content)
            sign_of_life("")
            return found
        if name not in self._silent:
            return self._source.look_at(name, known)
        if known is not None and known.status == "ok":
            return known  # as far as anybody can tell, it is as it was
        return self._unanswered(FileRecord(name, 0, 0, None))

    def _ends_of_content(self, path: Path) -> tuple[int, int] | None:
        """First and last sample of a log, whose content is kept for its nights."""
        file = self._spec.file
        try:
            log = read_log(path, file.logs, file.channels, self._latest_us)
        except (Exception, PanicException):  # which its night is to tell
            return None
        self._read_ahead[path] = log
        return None if log.first_us is None or log.last_us is None else (log.first_us, log.last_us)

    def _unanswered(self, record: FileRecord) -> FileRecord:
        """The record of a file that is to be tried again by the next run."""
        loss = self._silent[record.path]
        error = LogError(loss.code, Path(record.path), loss.how.removeprefix(f"{record.path} "))
        return failed(replace(record, sha256=None), error)

    def _known(self, name: str) -> FileRecord | None:
        """The former record of a file, if it was read with the same settings."""
        record = self.before.get(name)
        return record if record and record.read_with == self._read_with else None

    def news_of(self, name: str) -> str | None:
        """The news of a file that no run has finished with, as text; None without any."""
        before, known, now = self.before.get(name), self._known(name), self.files[name]
        if before is None:
            return f"new file {name}"
        if known is None:
            return f"{name} is to be read with other settings"
        # An unreadable file has no hash: it may be readable by now.
        if now.sha256 is None or known.sha256 != now.sha256:
            return f"changed file {name}"
        return f"the night of {name} is told now" if is_newly_told(known, now) else None

    def touched(self, name: str) -> set[dt.date]:
        """Nights in which a file has samples, or had them before it was changed."""
        record = self.files[name]
        return labels_of(record) | labels_of(self.before.get(name, record))

    def reached(self, name: str) -> set[dt.date]:
        """Nights into which a file's last samples may hold, or might before it was changed."""
        if not self._reach_us:
            return set()
        record, nights = self.files[name], self._spec.settings.nights
        ends = {one.last_us for one in (record, self.before.get(name, record))}
        found: set[dt.date] = set()
        for last_us in ends:
            if last_us is not None:
                last = night_of(last_us + self._reach_us, nights)
                found |= set(nights_between(night_of(last_us, nights), last))
        return found

    def present(self) -> set[dt.date]:
        """Nights in which any file has samples."""
        return {label for record in self.files.values() for label in labels_of(record)}

    def waiting(self) -> set[dt.date]:
        """Nights that wait for the next run, as a file of theirs changes while it is read."""
        return {
            label
            for name, record in self.files.items()
            if record.status == "growing"
            for label in self.touched(name)
        }

    def of_night(self, label: dt.date) -> list[str]:
        """Files of a night, in order of time."""
        names = [name for name, record in self.files.items() if label in labels_of(record)]
        return self._in_order(names)

    def before_night(self, here: Night) -> list[str]:
        """Files that end before a night, and so late that an on-change channel may hold into it."""
        names = [
            name
            for name, record in self.files.items()
            if record.status == "ok"
            and record.last_us is not None
            and here.start_us - self._reach_us <= record.last_us < here.start_us
        ]
        return self._in_order(names)

    def _in_order(self, names: Collection[str]) -> list[str]:
        return sorted(names, key=lambda name: (self.files[name].first_us or 0, name))

    def content(self, name: str) -> RawLog | None:
        """A log's content, read once while it is needed.

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
        content: RawLog | None = None
        try:
            file, path = self._spec.file, self._source.path(name)
            content = self._read_ahead.pop(path, None)
            if content is None:
                require_answer(name, path)
                with reading(name):
                    content = read_log(path, file.logs, file.channels, self._latest_us)
            found = self._with_change_of_units(covered(record, content, self._spec))
        except LogError as error:
            found, content = failed(record, error), None
            if error.code == "log_column_missing":
                found = replace(found, message=f"{found.message}{self._last_read(record)}")
        why = self._source.change_of(record)
        if why is not None:
            found, content = growing(record, why), None
        self.files[name] = found
        if content is None:
            self.read.discard(name)
            return None
        self.read.add(name)
        self._open[name] = content
        if len(self._open) > LOGS_IN_MEMORY:
            self._open.popitem(last=False)
        return content

    def _with_change_of_units(self, record: FileRecord) -> FileRecord:
        """The record of a log, with a remark where its header has other units than the one before.

        Logs of an object store, which would have to be copied for it, have none.
        """
        before = self._log_before(record)
        if before is None or self._spec.log_url:
            return record
        now, then = self._header_units(record.path), self._header_units(before.path)
        label = max(labels_of(before))
        changes = [
            f"the header gives {name} in {unit!r}, that of {before.path}, of {label.day} "
            f"{label:%B %Y}, in {then[name]!r}"
            for name, unit in now.items()
            if then.get(name, unit) != unit
        ]
        words = "; ".join(filter(None, [record.message, *changes]))
        return replace(record, message=words or None)

    def _header_units(self, name: str) -> Mapping[str, str]:
        """Units in a log's header; none where it cannot be read."""
        if name not in self._units and name not in self._silent:
            file = self._spec.file
            try:
                with reading(name):
                    path = self._source.path(name)
                    self._units[name] = header_units(path, file.logs, file.channels)
            except LogError:
                self._units[name] = {}
        return self._units.get(name, {})

    def _log_before(self, record: FileRecord) -> FileRecord | None:
        """The last log that ends before this one begins and can be read."""
        first_us = record.first_us
        earlier = [
            (one.last_us, name)
            for name, one in self.files.items()
            if one.status == "ok" and one.last_us is not None
            if first_us is not None and one.last_us < first_us
        ]
        return self.files[max(earlier)[1]] if earlier else None

    def _last_read(self, record: FileRecord) -> str:
        """The last log before this one that was read, which had all columns, in words."""
        last = self._log_before(record)
        if last is None or last.rows is None:
            return ""
        label = max(labels_of(last))
        return f"; {last.path}, of {label.day} {label:%B %Y}, was the last log that had them all"

    def let_go_until(self, label: dt.date) -> None:
        """Give up contents that no night after this one needs."""
        for name in list(self._open):
            if max(self.touched(name) | self.reached(name), default=label) <= label:
                del self._open[name]

    def finished(self, done: Collection[dt.date]) -> dict[str, FileRecord]:
        """Files of which every night is done: the others stay new, for a run that wants them."""
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
        """Number of files by outcome, one of `FATES`."""
        finished = self.finished(done)
        return Counter(self._fate(name, finished) for name in self.files)

    def _fate(self, name: str, finished: Mapping[str, FileRecord]) -> str:
        if self.files[name].status != "ok":
            return self.files[name].status
        if name not in finished:
            return "left"
        return "read" if name in self.read else "unchanged"

    def growing(self) -> list[str]:
        """Messages about files that change while they are read."""
        records = (record for _, record in sorted(self.files.items()))
        return [record.message or "" for record in records if record.status == "growing"]

    def rows(self) -> list[dict[str, Any]]:
        """Rows of `input_files`: each file once, with its first night, or none if it is of none."""
        return [
            {
                "motor_id": self._spec.motor_id,
                "path": name,
                "night": min(labels_of(record), default=None),
                "format": self._spec.file.logs.format,
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
            if record.status != "growing"
        ]
