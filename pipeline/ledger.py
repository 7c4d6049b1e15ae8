"""What a motor's task remembers: which files were read, and what came of which night.

One JSON file a motor, beside the tables. It only saves work: without it everything is read again
and the same tables come out.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from pipeline.store import replace_whole


@dataclass(frozen=True, slots=True)
class FileRecord:
    """A log file as it was read.

    Attributes
    ----------
    size, modified_ns
        While both stay, the content counts as unchanged.
    sha256
        Hash of the content; None where it could not be read.
    first_us, last_us
        First and last sample, UTC microseconds; None where unknown.
    nights
        Labels of the nights in which it has samples, or which its failure failed.
    status, error_code, message
        ``ok``, ``failed``, or ``growing`` for one that is changed while it is read, and why; of an
        ``ok`` file what was left out.
    inode
        Number of the file on its disk: another one has taken its name where this differs.
    """

    path: str
    size: int
    modified_ns: int
    sha256: str | None
    rows: int | None = None
    first_us: int | None = None
    last_us: int | None = None
    nights: tuple[str, ...] = ()
    status: str = "ok"
    error_code: str | None = None
    message: str | None = None
    inode: int = 0


@dataclass(frozen=True, slots=True)
class NightRecord:
    """What came of a night.

    Attributes
    ----------
    status
        One of the five outcomes.
    model
        The model that the next night is judged with; empty without a fit.
    judged_with
        Hash of the model before that the night was judged with.
    """

    status: str
    model: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    judged_with: str = ""


@dataclass(frozen=True, slots=True)
class Ledger:
    """All that is remembered of a motor.

    Attributes
    ----------
    settings_hash
        Hash of all that shapes the motor's figures: another one makes everything new.
    files
        By path relative to the log root.
    nights
        By label.
    """

    settings_hash: str
    files: Mapping[str, FileRecord] = field(default_factory=dict)
    nights: Mapping[dt.date, NightRecord] = field(default_factory=dict)

    def model_before(self, night: dt.date) -> Mapping[str, tuple[float, ...]]:
        """The motor's last model before a night; empty where there is none."""
        earlier = [label for label, record in self.nights.items() if label < night and record.model]
        return self.nights[max(earlier)].model if earlier else {}


def ledger_file(output: Path, motor_id: str) -> Path:
    """Where a motor's ledger lies."""
    return output / "ledger" / f"{motor_id}.json"


def read_ledger(output: Path, motor_id: str, settings_hash: str) -> Ledger:
    """A motor's ledger; empty where there is none, it is damaged, or settings are others."""
    try:
        document = json.loads(ledger_file(output, motor_id).read_text("utf-8"))
        if document.pop("sha256") != _digest(document):
            return Ledger(settings_hash)
        if document["settings_hash"] != settings_hash:
            return Ledger(settings_hash)
        files = {
            path: FileRecord(**(record | {"nights": tuple(record["nights"])}))
            for path, record in document["files"].items()
        }
        nights = {
            dt.date.fromisoformat(label): NightRecord(
                record["status"],
                {mode: tuple(theta) for mode, theta in record["model"].items()},
                record["judged_with"],
            )
            for label, record in document["nights"].items()
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return Ledger(settings_hash)
    return Ledger(settings_hash, files, nights)


def write_ledger(output: Path, motor_id: str, ledger: Ledger) -> None:
    """Replace a motor's ledger.

    Raises
    ------
    StoreError
        If it cannot be written.
    """
    document: dict[str, Any] = {
        "settings_hash": ledger.settings_hash,
        "files": {path: asdict(record) for path, record in sorted(ledger.files.items())},
        "nights": {
            label.isoformat(): asdict(record) for label, record in sorted(ledger.nights.items())
        },
    }
    document["sha256"] = _digest(document)
    text = json.dumps(document, indent=1, sort_keys=True)

    def write(name: str) -> None:
        Path(name).write_text(text, "utf-8")

    replace_whole(ledger_file(output, motor_id), write)


def forget_night(output: Path, night: dt.date, keep: Collection[str]) -> None:
    """Let the next run make a night anew for all motors but some.

    Parameters
    ----------
    output
        Output folder.
    night
        Label of a night whose table was lost.
    keep
        Ids of motors whose rows of that night are published.

    Raises
    ------
    StoreError
        If a ledger cannot be written.
    """
    for path in (output / "ledger").glob("*.json"):
        if path.stem in keep:
            continue
        try:
            settings_hash = json.loads(path.read_text("utf-8"))["settings_hash"]
        except (OSError, ValueError, KeyError, TypeError):
            continue
        ledger = read_ledger(output, path.stem, settings_hash)
        label = night.isoformat()
        kept = {name: one for name, one in ledger.files.items() if label not in one.nights}
        nights = {date: one for date, one in ledger.nights.items() if date != night}
        write_ledger(output, path.stem, Ledger(settings_hash, kept, nights))


def _digest(document: Mapping[str, Any]) -> str:
    """Hash of all that a ledger says: a flipped digit would otherwise be believed."""
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def content_hash(path: Path) -> str:
    """SHA-256 of a file's content.

    Raises
    ------
    OSError
        If the file cannot be read.
    """
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
