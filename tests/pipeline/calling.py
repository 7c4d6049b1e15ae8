"""The command in this process, its refusals, and a small fleet's files with changes."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from pipeline.errors import MotorLeakageError

CSV, PARQUET = "CB400-01", "CB400-02"
Called = tuple[int, str, str]
Call = Callable[..., Called]


@contextmanager
def refused(code: str, words: str = "") -> Iterator[None]:
    """A block that ends with an error of the program: its code, and words of its message."""
    with pytest.raises(MotorLeakageError) as caught:
        yield
    assert caught.value.code == code
    assert words in caught.value.message


def python(code: str, *arguments: object, **settings: Any) -> subprocess.CompletedProcess[str]:
    """Run code in a process of its own, which ends well."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=True, **settings)


def contents(folder: Path) -> dict[str, bytes]:
    """Files of a folder by their path in it."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def change(fleet: Path, file: str, before: str, after: str) -> None:
    path = fleet.parent / file
    text = path.read_text(encoding="utf-8")
    assert before in text
    path.write_text(text.replace(before, after), encoding="utf-8")


def without_workers(fleet: Path) -> Path:
    """For tests of what the command says, not of how its work is spread."""
    change(fleet, "fleet.toml", "[execution]\n", '[execution]\nbackend = "sequential"\n')
    return fleet
