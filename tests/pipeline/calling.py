"""The command in this process, and the config of a small fleet with changes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

CSV, PARQUET = "CB400-01", "CB400-02"
Called = tuple[int, str, str]
Call = Callable[..., Called]


def break_log(fleet: Path, motor: str) -> Path:
    path = max((fleet.parent.parent / "demo" / "logs" / motor).iterdir())
    path.write_bytes(b"nonsense" * 1000)
    return path


def change(fleet: Path, file: str, before: str, after: str) -> None:
    path = fleet.parent / file
    text = path.read_text(encoding="utf-8")
    assert before in text
    path.write_text(text.replace(before, after), encoding="utf-8")


def without_workers(fleet: Path) -> Path:
    """For tests of what the command says, not of how its work is spread."""
    change(fleet, "fleet.toml", "[execution]\n", '[execution]\nbackend = "sequential"\n')
    return fleet
