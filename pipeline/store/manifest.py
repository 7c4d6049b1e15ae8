"""SHA-256 of every published table file: what proves a table, its footer included.

One manifest a night (and a run). Page checksums do not cover a footer, and a query engine checks
neither. Before files are put into their places their manifest says what comes, and what was there;
after that, what is there: so every file can be proven at any moment, wherever a run was broken off.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from pipeline.errors import StoreError
from pipeline.store.atomic_files import put, read

MONTH_PREFIX = "month="
# In place of a month: manifests of the tables that are one file.
WHOLE = "whole"
# Month and name of a manifest.
Key = tuple[str, str]


@dataclass(frozen=True, slots=True)
class Manifest:
    """What the files of a night are to be, by path relative to the folder of the tables.

    Attributes
    ----------
    files
        SHA-256 of each.
    coming
        Of those that a run was about to replace when it wrote this: each SHA-256 that the file may
        have, that of before and that of after; None where there may be no file.
    """

    files: Mapping[str, str] = field(default_factory=dict)
    coming: Mapping[str, tuple[str | None, ...]] = field(default_factory=dict)

    def accepted(self, name: str) -> tuple[str | None, ...]:
        """What a file may be; empty where the manifest says nothing of it."""
        if name in self.coming:
            return self.coming[name]
        return (self.files[name],) if name in self.files else ()

    @property
    def names(self) -> set[str]:
        """Files of which it says something."""
        return self.files.keys() | self.coming.keys()


def manifest_file(output: Path, month: str, name: str) -> Path:
    """Where the manifest of a night, or of a run, lies."""
    return output / "manifest" / f"{MONTH_PREFIX}{month}" / f"{name}.json"


def manifest_keys(output: Path) -> list[Key]:
    """Month and name of each manifest that there is, sorted."""
    paths = (output / "manifest").glob(f"{MONTH_PREFIX}*/*.json")
    return sorted((path.parent.name.removeprefix(MONTH_PREFIX), path.stem) for path in paths)


def key_of(name: str) -> Key:
    """Month and name of the manifest that lists a table file.

    Examples
    --------
    >>> key_of("fits/month=2026-03/2026-03-02.parquet"), key_of("decisions/decisions.parquet")
    (('2026-03', '2026-03-02'), ('whole', 'decisions'))
    """
    path = PurePosixPath(name)
    folder = path.parent.name
    month = folder.removeprefix(MONTH_PREFIX) if folder.startswith(MONTH_PREFIX) else WHOLE
    return month, path.stem


def read_manifest(output: Path, month: str, name: str) -> Manifest | None:
    """The manifest of a night, or of a run; None where there is none, or it is damaged.

    Raises
    ------
    StoreError
        If there is one that cannot be read.
    """
    return _read(manifest_file(output, month, name))


def announce(
    output: Path, month: str, name: str, changes: Mapping[str, tuple[str | None, str | None]]
) -> None:
    """Say which files are about to be replaced.

    Raises
    ------
    StoreError
        If it cannot be written.
    """
    path = manifest_file(output, month, name)
    before = _read(path) or Manifest()
    coming = {one: pair for one, pair in changes.items() if pair[0] != pair[1]}
    _write(path, Manifest(before.files, {**before.coming, **coming}))


def update_manifest(output: Path, month: str, name: str, files: Mapping[str, str | None]) -> None:
    """Record the files of a night or of a run; those not named stay as they were.

    Parameters
    ----------
    output
        Output folder.
    month, name
        YYYY-MM, and the files' name without ending.
    files
        SHA-256 by path relative to the folder of the tables; None for no file.

    Raises
    ------
    StoreError
        If it cannot be written.
    """
    path = manifest_file(output, month, name)
    before = _read(path) or Manifest()
    listed: dict[str, str | None] = {**before.files, **files}
    kept = {one: digest for one, digest in listed.items() if digest is not None}
    coming = {one: some for one, some in before.coming.items() if one not in files}
    _write(path, Manifest(kept, coming))


def renew_manifest(output: Path, month: str, name: str) -> None:
    """Give a manifest the time of now, as its files have been proven once more.

    Raises
    ------
    StoreError
        If it cannot be written.
    """
    path = manifest_file(output, month, name)
    manifest = _read(path)
    if manifest is not None:
        put(path, _encoded(manifest))


def _write(path: Path, manifest: Manifest) -> None:
    """Write a manifest, unless it is there as it is to be."""
    if _read(path) != manifest:
        put(path, _encoded(manifest))


def _encoded(manifest: Manifest) -> bytes:
    document: dict[str, object] = {"files": dict(manifest.files)}
    if manifest.coming:
        document["coming"] = {name: list(some) for name, some in manifest.coming.items()}
    document["sha256"] = _digest(manifest)
    return json.dumps(document, indent=0, sort_keys=True).encode()


def _read(path: Path) -> Manifest | None:
    """A manifest; one that reads as damaged once is read again."""
    return _read_once(path) or _read_once(path)


def _read_once(path: Path) -> Manifest | None:
    try:
        content = read(path)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        # Taken for absent, it would lose what it says of the other files.
        raise StoreError(
            "store_read", f"manifest {path.name} cannot be read: {error.strerror}"
        ) from error
    try:
        document = json.loads(content)
        found = Manifest(
            {str(name): str(digest) for name, digest in document["files"].items()},
            {str(name): tuple(some) for name, some in document.get("coming", {}).items()},
        )
        return found if document["sha256"] == _digest(found) else None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def _digest(manifest: Manifest) -> str:
    said: object = dict(manifest.files)
    if manifest.coming:
        said = [said, {name: list(some) for name, some in manifest.coming.items()}]
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()
