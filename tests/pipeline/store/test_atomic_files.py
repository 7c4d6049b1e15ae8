"""Files that are moved into place."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from pipeline.store.atomic_files import take_over


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

    monkeypatch.setattr(os, "replace", across)
    take_over(tmp_path, {staged: tmp_path / "ledger" / "a.json"})
    assert (tmp_path / "ledger" / "a.json").read_bytes() == b"ledger"
    assert not staged.exists()
    assert [path.name for path in (tmp_path / "ledger").iterdir()] == ["a.json"]
