"""`check --tables`: all files of an output, those that only runs read among them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from pipeline.errors import StoreError
from pipeline.store.atomic_files import TEMPORARY_PREFIX
from pipeline.store.sealed import read_sealed, unseal
from pipeline.store.verification import TableFault, compare_published, verify_unlisted
from pipeline.telling.outbox import OUTBOX_FILES, read_outbox_file
from pipeline.trends.nights.decisions import damaged_lines, journal_file
from pipeline.trends.nights.trend_record import kept_file

ONLY_WORK = "it only saves work: `check --tables --mend` removes it, and a run makes it anew"


def verify_tables(output: Path) -> Iterator[TableFault]:
    """Compare every table file with its manifest, and check the sealed files beside them.

    A run may be publishing meanwhile.

    Yields
    ------
    TableFault
        For each file that differs, is missing, is in no manifest, or is damaged.
    """
    yield from compare_published(output).faults
    yield from verify_unlisted(output)
    yield from _verify_sealed(output)
    yield from _verify_journal(output)
    yield from _verify_outbox(output)


def _verify_sealed(output: Path) -> Iterator[TableFault]:
    from pipeline.trends.nights.kept import decoded

    kept = kept_file(output, "*").relative_to(output).as_posix()
    kinds: tuple[tuple[str, str, Callable[[bytes], object]], ...] = (
        ("ledger/*/*", "ledger_damaged", unseal),
        (kept, "history_damaged", decoded),
    )
    for pattern, code, unsealed in kinds:
        for path in sorted(output.glob(pattern)):
            if path.name.startswith(TEMPORARY_PREFIX):
                continue
            try:
                read_sealed(path, unsealed)
            except StoreError:
                yield TableFault(path.relative_to(output).as_posix(), code, ONLY_WORK)


def _verify_journal(output: Path) -> Iterator[TableFault]:
    name = journal_file(output).name
    try:
        lines = damaged_lines(output)
    except StoreError as error:
        yield TableFault(name, "journal_damaged", error.message)
        return
    for number in lines:
        message = f"line {number} is damaged; `check --tables --mend` takes it out"
        yield TableFault(name, "journal_damaged", message)


def _verify_outbox(output: Path) -> Iterator[TableFault]:
    there = [name for name in OUTBOX_FILES if (output / name).exists()]
    damaged = [name for name in there if _is_damaged(output / name)]
    again = "the next run makes it anew from the other one"
    if len(damaged) == len(there):
        again = "what was not delivered is not known any more; the next run says what is not sent"
    for name in damaged:
        yield TableFault(name, "outbox_damaged", again)


def _is_damaged(outbox: Path) -> bool:
    try:
        read_outbox_file(outbox)
    except StoreError:
        return True
    return False
