"""Files of a report's folder: a run writes only what has changed and removes only its own.

A night is made anew when its table files or the program have; a file is written when its content
has changed or it is not there as it was left.
"""

from __future__ import annotations

import hashlib
import json
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path

from pipeline.errors import StoreError
from pipeline.store.atomic_files import TEMPORARY_PREFIX, flush_disk, put, read

FILE = "manifest.json"


@dataclass(slots=True)
class ReportManifest:
    """Pages and data files that a run has written."""

    program: str  # hash of all that shapes pages beside the tables
    # Hash of the table files that each night was made from, by label.
    nights: dict[str, str] = field(default_factory=dict)
    # Hash and size of every file of the report, by path relative to its folder.
    files: dict[str, tuple[str, int]] = field(default_factory=dict)


def short_hash(content: bytes) -> str:
    """Short hash of a file's content."""
    return hashlib.sha256(content).hexdigest()[:16]


def read_report_manifest(folder: Path) -> ReportManifest | None:
    """The manifest of a report's folder; None where there is none that can be used.

    Raises StoreError if the folder holds something else: nothing of it is ever overwritten.
    """
    path = folder / FILE
    if not path.exists():
        strangers = [one for one in _entries(folder) if not one.name.startswith(TEMPORARY_PREFIX)]
        if strangers:
            raise StoreError(
                "report_folder",
                f"{folder} holds {strangers[0].name} and no report; name an empty or new folder",
            )
        return None
    try:
        document = json.loads(read(path))
        files = {name: (str(one[0]), int(one[1])) for name, one in document["files"].items()}
        return ReportManifest(document["program"], dict(document["nights"]), files)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, IndexError):
        # Without it all files are made anew, over the present ones.
        return None


def _entries(folder: Path) -> list[Path]:
    if not folder.exists():
        return []
    if not folder.is_dir():
        raise StoreError("report_folder", f"{folder} is no folder; name another")
    return sorted(folder.iterdir())


def write_report_manifest(folder: Path, manifest: ReportManifest) -> None:
    """Write the manifest last: the files in it are then there."""
    # One flush for all pages, not one for each; of a new report there is nothing yet.
    if folder.is_dir():
        flush_disk(folder)
    content = json.dumps(asdict(manifest), separators=(",", ":"), sort_keys=True).encode()
    if not (folder / FILE).exists() or read(folder / FILE) != content:
        put(folder / FILE, content)


def write_changed(
    folder: Path, name: str, content: bytes, before: tuple[str, int] | None
) -> tuple[str, int]:
    """Write a file unless it is there with that content.

    Raises StoreError if it cannot be written.
    """
    entry = (short_hash(content), len(content))
    if entry != before or not is_as_left(folder, name, entry):
        put(folder / name, content, durable=False)
    return entry


def is_as_left(folder: Path, name: str, entry: tuple[str, int]) -> bool:
    """True if a file has the size that it was written with."""
    try:
        return (folder / name).stat().st_size == entry[1]
    except OSError:
        return False


def remove_stale(folder: Path, before: ReportManifest, now: ReportManifest) -> int:
    """Remove files that the report had and has no more, and no others; returns how many."""
    stale = sorted(before.files.keys() - now.files.keys())
    for name in stale:
        path = folder / name
        # Nothing outside the report is removed, whatever the manifest lists.
        if path.resolve().is_relative_to(folder.resolve()):
            with suppress(OSError):
                path.unlink()
                path.parent.rmdir()
    return len(stale)
