"""Ledger of a motor: the files that were read, and the outcome of each night.

One sealed file for each motor and month, beside the tables: a night costs the same however long the
history is. It only saves work: without it all logs are read again and give the same tables.
"""

from __future__ import annotations

import datetime as dt
import hashlib
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from pipeline.config import MotorSpec
from pipeline.config.hashes import ROLLER
from pipeline.store.sealed import put_sealed, read_if_whole, unseal
from pipeline.workers.process import still_alive

# Read at a time for the hash of a file.
PIECE_BYTES = 1 << 20
# Stands for the month of files without a night.
NO_MONTH = "unknown"


@dataclass(frozen=True, slots=True)
class FileRecord:
    """Record of a log file."""

    path: str
    # size, modified_ns: while both stay, the content counts as unchanged.
    size: int
    modified_ns: int
    sha256: str | None  # hash of the content; None where it could not be read
    read_with: str = ""  # hash of the settings of reading: dialect, channels, nights
    rows: int | None = None
    # first_us, last_us: first and last sample, UTC microseconds; None where unknown.
    first_us: int | None = None
    last_us: int | None = None
    # Labels of the nights in which it has samples, or which fail with it.
    nights: tuple[str, ...] = ()
    # status, error_code, message: ``ok``, ``failed``, or ``growing`` for one that is changed while
    # it is read, and the reason; of an ``ok`` file the rows left out.
    status: str = "ok"
    error_code: str | None = None
    message: str | None = None
    inode: int = 0  # of the file: it differs if another one has taken its name


@dataclass(frozen=True, slots=True)
class SeenLogs:
    """A motor's log files as they were looked at, and those that are named and absent."""

    files: Mapping[str, FileRecord]
    absent: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class NightRecord:
    """Outcome of a night."""

    status: str  # one of the five outcomes
    # The model that the next night is judged with; empty without a fit.
    model: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    judged_with: str = ""  # hash of the model before that the night was judged with
    # statistics_hash, figures_hash: hashes of the settings of its statistics, and of the figures
    # made from them; empty without any.
    statistics_hash: str = ""
    figures_hash: str = ""
    # Whether it tells the scale of the rollers' curve; None without a fit, or such a curve.
    tells_roller: bool | None = None


@dataclass(frozen=True, slots=True)
class Ledger:
    """Files and nights of a motor."""

    # By path relative to the log root.
    files: Mapping[str, FileRecord] = field(default_factory=dict)
    nights: Mapping[dt.date, NightRecord] = field(default_factory=dict)  # by label

    def model_before(self, night: dt.date) -> Mapping[str, tuple[float, ...]]:
        """The motor's last model before a night; empty where there is none."""
        earlier = [label for label, record in self.nights.items() if label < night and record.model]
        return self.nights[max(earlier)].model if earlier else {}

    def without(self, nights: Collection[dt.date], refit: Collection[dt.date] = ()) -> Ledger:
        """A ledger without the files that have samples of some nights: these are made anew.

        Nights with a fit are kept: if their log is gone, the night after is still judged with their
        model. Those of `refit` are then fitted anew from their statistics.
        """
        labels = {night.isoformat() for night in nights}
        return Ledger(
            {name: one for name, one in self.files.items() if labels.isdisjoint(one.nights)},
            {
                night: replace(one, figures_hash="") if night in refit else one
                for night, one in self.nights.items()
                if one.model or night not in nights
            },
        )

    def by_month(self) -> dict[str, Ledger]:
        """Content of each month's file: a night goes by its label, a file by its first night."""
        files: defaultdict[str, dict[str, FileRecord]] = defaultdict(dict)
        nights: defaultdict[str, dict[dt.date, NightRecord]] = defaultdict(dict)
        for path, record in self.files.items():
            files[min(record.nights)[:7] if record.nights else NO_MONTH][path] = record
        for label, one in self.nights.items():
            nights[f"{label:%Y-%m}"][label] = one
        return {month: Ledger(files[month], nights[month]) for month in sorted({*files, *nights})}


def changed_months(before: Ledger, after: Ledger) -> dict[str, Ledger]:
    """Months that have changed; an empty one has no content left."""
    old, new = before.by_month(), after.by_month()
    return {
        month: new.get(month, Ledger())
        for month in sorted({*old, *new})
        if old.get(month) != new.get(month)
    }


def ledger_folder(output: Path, motor_id: str) -> Path:
    """Folder of a motor's ledger."""
    return output / "ledger" / motor_id


def read_ledger(output: Path, motor_id: str) -> Ledger:
    """A motor's ledger, without damaged months."""
    files: dict[str, FileRecord] = {}
    nights: dict[dt.date, NightRecord] = {}
    for path in sorted(ledger_folder(output, motor_id).glob("*.json")):
        month = _read_month(path)
        files |= month.files
        nights |= month.nights
    return Ledger(files, nights)


def _read_month(path: Path) -> Ledger:
    document = read_if_whole(path, unseal)
    if document is None:
        return Ledger()
    try:
        files = {
            name: FileRecord(**(record | {"nights": tuple(record["nights"])}))
            for name, record in document["files"].items()
        }
        nights = {
            dt.date.fromisoformat(label): NightRecord(
                **(record | {"model": {k: tuple(v) for k, v in record["model"].items()}})
            )
            for label, record in document["nights"].items()
        }
    except (ValueError, KeyError, TypeError, AttributeError):
        return Ledger()
    return Ledger(files, nights)


def month_files(
    output: Path, motor_id: str, before: Ledger, after: Ledger
) -> dict[Path, dict[str, Any]]:
    """Documents of the months of a motor's ledger that have changed, by file."""
    return {
        ledger_folder(output, motor_id) / f"{month}.json": {
            "files": {path: asdict(record) for path, record in sorted(ledger.files.items())},
            "nights": {
                label.isoformat(): asdict(record) for label, record in sorted(ledger.nights.items())
            },
        }
        for month, ledger in changed_months(before, after).items()
    }


def settings_file(output: Path, motor_id: str) -> Path:
    """File of the settings of a motor's last run."""
    return ledger_folder(output, motor_id) / "settings"


def read_settings(output: Path, motor_id: str) -> dict[str, Any]:
    """Settings of a motor's last run, as `settings_of` has them; empty without a record."""
    return read_if_whole(settings_file(output, motor_id), unseal) or {}


def as_published(output: Path, spec: MotorSpec) -> MotorSpec:
    """A motor with the scale of its rollers' curve free where its published fits have it so."""
    is_free = ROLLER in read_settings(output, spec.motor_id)
    return replace(spec, roller_is_free=is_free)


def forget_nights(
    output: Path,
    nights: Collection[dt.date],
    keep: Collection[str] = (),
    refit: Collection[dt.date] = (),
) -> dict[str, set[dt.date]]:
    """Let the next run make nights anew whose tables were lost, for all motors but those to keep.

    Nights of `refit` may be fitted from their statistics if their logs are gone. Returns, by motor,
    those of the nights with a fit.

    Raises StoreError if a ledger cannot be written.
    """
    fitted = {}
    for folder in sorted((output / "ledger").glob("*")):
        if folder.name in keep:
            continue
        before = read_ledger(output, folder.name)
        fitted[folder.name] = {
            night for night, one in before.nights.items() if one.model and night in nights
        }
        after = before.without(nights, refit)
        for path, document in month_files(output, folder.name, before, after).items():
            put_sealed(path, document)
    return fitted


def content_hash(path: Path) -> str:
    """SHA-256 of a file's content.

    Raises OSError if the file cannot be read.
    """
    digest, piece = hashlib.sha256(), bytearray(PIECE_BYTES)
    with path.open("rb", buffering=0) as stream:
        while size := stream.readinto(piece):
            digest.update(memoryview(piece)[:size])
            still_alive()
    return digest.hexdigest()
