"""`motor-leakage check --tables`: whether all that a run has left is as it was written."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pipeline.decisions import damaged_lines, journal_file
from pipeline.errors import StoreError
from pipeline.landing import TEMPORARY_PREFIX, read
from pipeline.ledger import month_of
from pipeline.manifest import Manifest, read_manifest
from pipeline.sealed import unseal_bytes
from pipeline.store import PUT_ASIDE
from pipeline.telling.outbox import OUTBOX_FILES, parsed
from pipeline.trends.kept_nights import kept_folder
from pipeline.trends.record import read_record, record_file

AGAIN = "`fit-fleet --force` with that night makes it anew from the logs"


@dataclass(frozen=True, slots=True)
class TableFault:
    """A file that is not as it was left.

    Attributes
    ----------
    path
        Relative to the folder of the tables; of another file, to the output folder.
    code
        ``table_altered``, ``table_missing``, ``table_unlisted``, ``manifest_damaged``,
        ``ledger_damaged``, ``history_damaged``, ``journal_damaged`` or ``outbox_damaged``.
    message
        In words, with what to do.
    """

    path: str
    code: str
    message: str


def verify_tables(output: Path) -> Iterator[TableFault]:
    """Compare every table file with its manifest, and look at what is remembered beside them.

    A run may be publishing meanwhile.

    Yields
    ------
    TableFault
        One for each file that differs, is absent, is in no manifest, or is damaged itself.
    """
    yield from _verify_listed(output)
    yield from _verify_unlisted(output)
    yield from _verify_ledger(output)
    yield from _verify_history(output)
    yield from _verify_journal(output)
    yield from _verify_outbox(output)


def _verify_listed(output: Path) -> Iterator[TableFault]:
    for path in sorted((output / "manifest").glob("month=*/*.json")):
        manifest = _manifest_at(output, path)
        if manifest is None:
            yield TableFault(
                path.relative_to(output).as_posix(),
                "manifest_damaged",
                "the manifest is damaged; `fit-fleet --force` with that night makes it anew",
            )
            continue
        for name in sorted(manifest.names):
            fault = _compare(output, name, manifest)
            # A run may have published it since its manifest was read.
            if fault is not None and (now := _manifest_at(output, path)) not in (None, manifest):
                assert now is not None
                fault = _compare(output, name, now)
            if fault is not None:
                yield fault


def _verify_unlisted(output: Path) -> Iterator[TableFault]:
    """Files first, then what the manifests say: a run announces a file before it puts it there."""
    tables = output / "tables"
    found = {
        path.relative_to(tables).as_posix()
        for path in tables.rglob("*")
        if path.is_file() and not path.name.startswith(TEMPORARY_PREFIX)
    }
    for path in (output / "manifest").glob("month=*/*.json"):
        manifest = _manifest_at(output, path)
        found -= manifest.names if manifest else set()
    for name in sorted(found):
        message = "the file is in no manifest: it was not published by a run"
        if name.endswith(PUT_ASIDE):
            message = "it was damaged and a run put it aside; delete it when you have seen it"
        yield TableFault(name, "table_unlisted", message)


def _verify_ledger(output: Path) -> Iterator[TableFault]:
    for folder in sorted((output / "ledger").glob("*/")):
        damaged = [path for path in sorted(folder.glob("*.json")) if month_of(path) is None]
        record = record_file(output, folder.name)
        if record.exists() and read_record(output, folder.name) is None:
            damaged.append(record)
        for path in damaged:
            if path.exists():
                yield TableFault(
                    path.relative_to(output).as_posix(),
                    "ledger_damaged",
                    "it only saves work: the next run makes anew what it told of",
                )


def _verify_history(output: Path) -> Iterator[TableFault]:
    for path in sorted(kept_folder(output).glob("*/*")):
        if path.name.startswith(TEMPORARY_PREFIX):
            continue
        with suppress(OSError):
            if unseal_bytes(read(path)) is not None:
                continue
        if path.exists():
            yield TableFault(
                path.relative_to(output).as_posix(),
                "history_damaged",
                "it only saves work: the next run reads the nights from the tables again",
            )


def _verify_journal(output: Path) -> Iterator[TableFault]:
    name = journal_file(output).name
    try:
        lines = damaged_lines(output)
    except StoreError as error:
        yield TableFault(name, "journal_damaged", error.message)
        return
    for number in lines:
        yield TableFault(
            name, "journal_damaged", f"line {number} is damaged; take the line from a backup"
        )


def _verify_outbox(output: Path) -> Iterator[TableFault]:
    there = [name for name in OUTBOX_FILES if (output / name).exists()]
    damaged = [name for name in there if _is_damaged_outbox(output / name)]
    again = "the next run makes it anew from the other one"
    if len(damaged) == len(there):
        again = "what was not delivered is not known any more; the next run says what is not sent"
    for name in damaged:
        yield TableFault(name, "outbox_damaged", again)


def _is_damaged_outbox(path: Path) -> bool:
    try:
        return parsed(read(path)) is None
    except FileNotFoundError:
        return False
    except OSError:
        return True


def _manifest_at(output: Path, path: Path) -> Manifest | None:
    return read_manifest(output, path.parent.name.removeprefix("month="), path.stem)


def _compare(output: Path, name: str, manifest: Manifest) -> TableFault | None:
    accepted = manifest.accepted(name)
    try:
        with (output / "tables" / name).open("rb") as stream:
            found = hashlib.file_digest(stream, "sha256").hexdigest()
    except FileNotFoundError:
        if None in accepted or not accepted:
            return None
        return TableFault(name, "table_missing", f"the file is gone; {AGAIN}")
    except OSError as error:
        return TableFault(name, "table_altered", f"it cannot be read: {error.strerror}; {AGAIN}")
    if found not in accepted:
        return TableFault(name, "table_altered", f"it is not what was published; {AGAIN}")
    return None
