"""What a report's folder holds: a run writes only what has changed and removes only its own.

A night is made anew when its table files or the program have; a file is written when its content
has changed or it is not there as it was left.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.errors import StoreError
from pipeline.store.atomic_files import TEMPORARY_PREFIX, flush_all, put, read

FILE = "manifest.json"
FORMAT = 1


@dataclass(slots=True)
class Manifest:
    """What was rendered.

    Attributes
    ----------
    program
        Hash of all that shapes pages beside the tables.
    nights
        Hash of the table files that each night was made from, by label.
    files
        Hash and size of every file of the report, by path relative to its folder.
    """

    program: str
    nights: dict[str, str] = field(default_factory=dict)
    files: dict[str, tuple[str, int]] = field(default_factory=dict)


def content_hash(content: bytes) -> str:
    """Short hash of a file's content.

    Examples
    --------
    >>> content_hash(b"")
    'e3b0c44298fc1c14'
    """
    return hashlib.sha256(content).hexdigest()[:16]


def read_manifest(folder: Path) -> Manifest | None:
    """The manifest of a report's folder; None where there is none that can be used.

    Raises
    ------
    StoreError
        If the folder holds something that is no report: nothing of it is ever overwritten.
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
        if document["format"] != FORMAT:
            return Manifest("", files=_files(document))
        return Manifest(document["program"], dict(document["nights"]), _files(document))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        # Without it everything is made anew, over what is there.
        return None


def _entries(folder: Path) -> list[Path]:
    if not folder.exists():
        return []
    if not folder.is_dir():
        raise StoreError("report_folder", f"{folder} is no folder; name another")
    return sorted(folder.iterdir())


def _files(document: Mapping[str, Mapping[str, list[str | int]]]) -> dict[str, tuple[str, int]]:
    return {name: (str(one[0]), int(one[1])) for name, one in document["files"].items()}


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Leave the manifest; last, so that what it lists is there."""
    document = {
        "format": FORMAT,
        "program": manifest.program,
        "nights": dict(sorted(manifest.nights.items())),
        "files": dict(sorted(manifest.files.items())),
    }
    text = json.dumps(document, separators=(",", ":"))
    # One flush for all pages, not one for each: first they, then what tells that they are there.
    flush_all()
    put(folder / FILE, text.encode())


def write_changed(
    folder: Path, name: str, content: bytes, before: tuple[str, int] | None
) -> tuple[str, int]:
    """Write a file unless it is there with that content.

    Raises
    ------
    StoreError
        If it cannot be written.
    """
    entry = (content_hash(content), len(content))
    if entry != before or not is_as_left(folder, name, entry):
        put(folder / name, content, durable=False)
    return entry


def is_as_left(folder: Path, name: str, entry: tuple[str, int]) -> bool:
    """Whether a file has the size that it was written with."""
    try:
        return (folder / name).stat().st_size == entry[1]
    except OSError:
        return False


def remove_stale(folder: Path, before: Manifest, now: Manifest) -> int:
    """Remove files that the report had and has no more, and no others; returns how many."""
    stale = sorted(before.files.keys() - now.files.keys())
    for name in stale:
        path = folder / name
        # A manifest is a file like others: what it names must lie in the report.
        if path.resolve().is_relative_to(folder.resolve()):
            with suppress(OSError):
                path.unlink()
                path.parent.rmdir()
    return len(stale)
