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
Entry = tuple[str, int]  # hash and size of a file


@dataclass(slots=True)
class ReportManifest:
    """Pages and data files that a run has written."""

    program: str = ""  # hash of all that shapes pages beside the tables
    # Hash of the table files that each night was made from, by label.
    nights: dict[str, str] = field(default_factory=dict)
    files: dict[str, Entry] = field(default_factory=dict)  # by path relative to the folder


def short_hash(content: bytes) -> str:
    """Short hash of a file's content."""
    return hashlib.sha256(content).hexdigest()[:16]


def open_report(folder: Path) -> ReportManifest:
    """The manifest of a report's folder; an empty one, which is written, of a new folder.

    Raises StoreError if the folder holds something else: nothing of it is ever overwritten.
    """
    path = folder / FILE
    if path.exists():
        try:
            document = json.loads(read(path))
            files = {name: (str(one[0]), int(one[1])) for name, one in document["files"].items()}
            return ReportManifest(document["program"], dict(document["nights"]), files)
        except (OSError, ValueError, KeyError, TypeError, AttributeError, IndexError):
            # Without it all files are made anew, over the present ones.
            return ReportManifest()
    if folder.exists() and not folder.is_dir():
        raise StoreError("report_folder", f"{folder} is no folder; name another")
    for one in sorted(folder.iterdir()) if folder.exists() else ():
        if not one.name.startswith(TEMPORARY_PREFIX):
            said = f"{folder} holds {one.name} and no report; name an empty or new folder"
            raise StoreError("report_folder", said)
    _write(path, ReportManifest())
    return ReportManifest()


def write_changed(folder: Path, name: str, content: bytes, before: Entry | None) -> Entry:
    """Write a file unless it is there with that content.

    Raises StoreError if it cannot be written.
    """
    entry = (short_hash(content), len(content))
    if entry != before or not is_as_left(folder, name, entry):
        put(folder / name, content, durable=False)
    return entry


def is_as_left(folder: Path, name: str, entry: Entry) -> bool:
    """True if a file has the size that it was written with."""
    try:
        return (folder / name).stat().st_size == entry[1]
    except OSError:
        return False


def close_report(folder: Path, before: ReportManifest, now: ReportManifest) -> int:
    """Remove files that the report had and has no more, then write the manifest; how many went."""
    stale = sorted(before.files.keys() - now.files.keys())
    for name in stale:
        path = folder / name
        # Nothing outside the report is removed, whatever the manifest lists.
        if path.resolve().is_relative_to(folder.resolve()):
            with suppress(OSError):
                path.unlink()
                path.parent.rmdir()
    flush_disk(folder)  # one flush for all pages, not one for each
    _write(folder / FILE, now)
    return len(stale)


def _write(path: Path, manifest: ReportManifest) -> None:
    content = json.dumps(asdict(manifest), separators=(",", ":"), sort_keys=True).encode()
    if not path.exists() or read(path) != content:
        put(path, content)
