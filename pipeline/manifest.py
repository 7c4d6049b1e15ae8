"""SHA-256 of every published table file: what proves a table, its footer included.

One manifest a night (and a run), written after its files: page checksums do not cover a footer, and
a query engine checks neither. Between a file and its manifest a crash may come; the run after
makes that night anew and the manifest with it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from pipeline.store import TEMPORARY_PREFIX, replace_whole


@dataclass(frozen=True, slots=True)
class TableFault:
    """A table file that is not as it was published.

    Attributes
    ----------
    path
        Relative to the folder of the tables.
    code
        ``table_altered``, ``table_missing``, ``table_unlisted`` or ``manifest_damaged``.
    message
        In words, with what to do.
    """

    path: str
    code: str
    message: str


def manifest_file(output: Path, month: str, name: str) -> Path:
    """Where the manifest of a night, or of a run, lies."""
    return output / "manifest" / f"month={month}" / f"{name}.json"


def update_manifest(output: Path, month: str, name: str, files: Mapping[str, str | None]) -> None:
    """Record the files of a night or of a run; those not named stay as they were.

    Parameters
    ----------
    output
        Output folder.
    month, name
        YYYY-MM, and the files' name without ending.
    files
        SHA-256 by path relative to the folder of the tables; None for a file that was removed.

    Raises
    ------
    StoreError
        If it cannot be written.
    """
    path = manifest_file(output, month, name)
    listed = {**(_read(path) or {}), **files}
    kept = {name: digest for name, digest in sorted(listed.items()) if digest is not None}
    document = {"files": kept, "sha256": _digest(kept)}

    def write(temporary: str) -> None:
        Path(temporary).write_text(json.dumps(document, indent=0, sort_keys=True), "utf-8")

    replace_whole(path, write)


def _read(path: Path) -> dict[str, str] | None:
    """Files of a manifest; None where there is none, or it is damaged."""
    try:
        document = json.loads(path.read_text("utf-8"))
        files = {str(name): str(digest) for name, digest in document["files"].items()}
        return files if document["sha256"] == _digest(files) else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def _digest(files: Mapping[str, str]) -> str:
    return hashlib.sha256(json.dumps(dict(files), sort_keys=True).encode()).hexdigest()


def listed_files(output: Path) -> dict[str, str]:
    """SHA-256 of all published files, by path relative to the folder of the tables."""
    found: dict[str, str] = {}
    for manifest in sorted((output / "manifest").glob("month=*/*.json")):
        found |= _read(manifest) or {}
    return found


def verify_tables(output: Path) -> Iterator[TableFault]:
    """Compare every table file with its manifest.

    Yields
    ------
    TableFault
        One for each file that differs, is absent, or is in no manifest.
    """
    tables = output / "tables"
    listed: set[str] = set()
    for manifest in sorted((output / "manifest").glob("month=*/*.json")):
        files = _read(manifest)
        if files is None:
            yield TableFault(
                f"manifest/{manifest.parent.name}/{manifest.name}",
                "manifest_damaged",
                "the manifest is damaged; `fit-fleet --force` with that night makes it anew",
            )
            continue
        listed |= files.keys()
        for name, digest in files.items():
            fault = _compare(tables / name, name, digest)
            if fault is not None:
                yield fault
    for path in sorted(tables.glob("**/*.parquet")):
        name = path.relative_to(tables).as_posix()
        if name not in listed and not path.name.startswith(TEMPORARY_PREFIX):
            yield TableFault(
                name, "table_unlisted", "the file is in no manifest: it was not published by a run"
            )


def _compare(path: Path, name: str, digest: str) -> TableFault | None:
    again = "`fit-fleet --force` with that night makes it anew from the logs"
    try:
        with path.open("rb") as stream:
            found = hashlib.file_digest(stream, "sha256").hexdigest()
    except FileNotFoundError:
        return TableFault(name, "table_missing", f"the file is gone; {again}")
    except OSError as error:
        return TableFault(name, "table_altered", f"it cannot be read: {error.strerror}; {again}")
    if found != digest:
        return TableFault(name, "table_altered", f"it is not what was published; {again}")
    return None
