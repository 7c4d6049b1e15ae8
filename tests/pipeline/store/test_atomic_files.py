"""Files that are moved into place."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from pipeline.store import atomic_files
from pipeline.store.atomic_files import take_over
from pipeline.store.sealed import stage_sealed


def test_files_of_another_disk_are_copied_into_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    staged, rename = tmp_path / "staging" / "a.json", os.replace
    staged.parent.mkdir()
    staged.write_bytes(b"ledger")

    def across(source: Path, target: Path) -> None:
        if Path(source).parent == staged.parent:
            raise OSError(errno.EXDEV, os.strerror(errno.EXDEV))
        rename(source, target)

    flushed: list[Path] = []
    monkeypatch.setattr(os, "replace", across)
    monkeypatch.setattr(atomic_files, "flush_disk", flushed.append)
    take_over(tmp_path, {staged: tmp_path / "ledger" / "a.json"})
    assert (tmp_path / "ledger" / "a.json").read_bytes() == b"ledger"
    assert not staged.exists()
    assert [path.name for path in (tmp_path / "ledger").iterdir()] == ["a.json"]
    # The new folder lies on the other disk.
    assert flushed == [tmp_path, tmp_path / "ledger" / "a.json"]


def test_files_of_a_run_are_for_all_users_to_read(tmp_path: Path) -> None:
    staged, place = tmp_path / "ledger" / "M1" / "a.json", tmp_path / "out" / "a.json"
    before = os.umask(0o077)
    try:
        stage_sealed(staged, {"files": {}})
    finally:
        os.umask(before)
    take_over(tmp_path, {staged: place})
    assert place.stat().st_mode & 0o777 == 0o644
