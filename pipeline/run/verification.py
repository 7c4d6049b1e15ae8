"""`check --tables`: all files of an output, those that only runs read among them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from pipeline.store.manifest import manifest_keys
from pipeline.store.state import STATE_FILE, is_sound
from pipeline.store.verification import TableFault, compare_published, verify_unlisted


def verify_tables(output: Path) -> Iterator[TableFault]:
    """Compare every table file with its manifest, and check the state file beside them.

    A run may be publishing meanwhile.

    Yields
    ------
    TableFault
        For each file that differs, is missing, is in no manifest, or is damaged.
    """
    yield from compare_published(output, manifest_keys(output)).faults
    yield from verify_unlisted(output)
    if not is_sound(output):
        message = "the next run takes its backup, or makes it anew"
        yield TableFault(STATE_FILE, "state_damaged", message)
