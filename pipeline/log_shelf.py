"""A motor's log files while its task works through them: what each is, and what is new of it."""

from __future__ import annotations

import datetime as dt
from collections import OrderedDict
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

from pipeline.config import MotorSpec
from pipeline.errors import LogError
from pipeline.ingest import RawLog, read_log
from pipeline.ledger import FileRecord
from pipeline.logs import covered, failed, find_logs, inspect_log, labels_of, place_failed
from pipeline.night_rows import utc
from pipeline.settings_hashes import reading_hash

# Logs kept in memory: one that ends and one that begins within a night.
LOGS_IN_MEMORY = 2


class LogShelf:
    """The log files of a motor, each read once while it is needed.

    Parameters
    ----------
    spec
        The motor.
    before
        What was known of its files.

    Attributes
    ----------
    files
        What is known of each file by now, by path relative to the log root.
    absent
        Those that are named in the config and absent.
    read
        Paths of those whose content was read.
    """

    def __init__(self, spec: MotorSpec, before: Mapping[str, FileRecord]) -> None:
        self._spec = spec
        self._before = before
        self._read_with = reading_hash(spec)
        self._paths, self.absent = find_logs(spec)
        looked_at = {
            name: replace(
                inspect_log(name, path, self._known(name), spec), read_with=self._read_with
            )
            for name, path in self._paths.items()
        }
        self.files = place_failed(looked_at, before, spec)
        self.read: set[str] = set()
        self._open: OrderedDict[str, RawLog] = OrderedDict()

    def _known(self, name: str) -> FileRecord | None:
        """What was known of a file, if it was understood as it is now."""
        record = self._before.get(name)
        return record if record and record.read_with == self._read_with else None

    def news_of(self, name: str) -> str | None:
        """What is new of a file, in words; None: nothing."""
        before, known, now = self._before.get(name), self._known(name), self.files[name]
        if before is None:
            return f"new file {name}"
        if known is None:
            return f"{name} is to be read with other settings"
        # What could not be read has no hash: it may be legible by now.
        changed = now.sha256 is None or known.sha256 != now.sha256
        return f"changed file {name}" if changed else None

    def touched(self, name: str) -> set[dt.date]:
        """Nights in which a file has samples, or had them before it was changed."""
        record = self.files[name]
        return labels_of(record) | labels_of(self._before.get(name, record))

    def present(self) -> set[dt.date]:
        """Nights in which any file has samples."""
        return {label for record in self.files.values() for label in labels_of(record)}

    def of_night(self, label: dt.date) -> list[str]:
        """Files of a night, in order of time."""
        return sorted(
            (name for name, record in self.files.items() if label in labels_of(record)),
            key=lambda name: (self.files[name].first_us or 0, name),
        )

    def content(self, name: str) -> RawLog | None:
        """A log's content, read once while it is needed; a failure goes into its record."""
        if name in self._open:
            self._open.move_to_end(name)
            return self._open[name]
        record = self.files[name]
        if record.status == "failed":
            return None
        try:
            content = read_log(self._paths[name], self._spec.file.log_source())
        except LogError as error:
            self.files[name] = failed(record, error)
            return None
        self.read.add(name)
        self.files[name] = covered(record, content, self._spec)
        self._open[name] = content
        if len(self._open) > LOGS_IN_MEMORY:
            self._open.popitem(last=False)
        return content

    def finished(self, done: Collection[dt.date]) -> dict[str, FileRecord]:
        """Files of which every night is done: the others stay new, for a run that wants them."""
        nights = set(done)
        return {
            name: record
            for name, record in self.files.items()
            if self.news_of(name) is None or self.touched(name) <= nights
        }

    def rows(self) -> list[dict[str, Any]]:
        """Rows of `input_files`: each file once, under its first night."""
        return [
            {
                "motor_id": self._spec.motor_id,
                "path": name,
                "night": min(labels_of(record)),
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
            if record.nights
        ]
