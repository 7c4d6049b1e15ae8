"""Files of a Delta table that are its newest version's: others lie beside them until a clean-up.

The log of a table is in `_delta_log/`: a JSON file a version, with a line an action, and now and
then a checkpoint with all files that are added by then (Delta transaction log protocol,
https://github.com/delta-io/delta/blob/master/PROTOCOL.md).
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from urllib.parse import unquote

import pyarrow as pa
import pyarrow.parquet as pq

LOG = "_delta_log"


def of_newest_version(paths: Iterable[Path], root: Path) -> set[Path]:
    """Return the paths without those that a Delta table at or above them has removed."""
    return {path for path in paths if _is_live(path, root)}


def _is_live(path: Path, root: Path) -> bool:
    for folder in path.parents:
        log = folder / LOG
        if log.is_dir():
            return path.relative_to(folder).as_posix() in _live(folder, log.stat().st_mtime_ns)
        if folder == root:
            break
    return True


@lru_cache(maxsize=64)
def _live(table: Path, _: int) -> frozenset[str]:
    """Return the files of a table's newest version, by path in it, as of a change of its log."""
    log, live, since = table / LOG, set[str](), -1
    checkpoints = sorted(log.glob("*.checkpoint*.parquet"))
    if checkpoints:
        since = _version(checkpoints[-1])
        for path in (checkpoint for checkpoint in checkpoints if _version(checkpoint) == since):
            live |= _added(path)
    for path in sorted(log.glob("*.json")):
        if _version(path) <= since:
            continue
        for line in path.read_text("utf-8").splitlines():
            action = json.loads(line)
            live -= {unquote(action["remove"]["path"])} if "remove" in action else set()
            live |= {unquote(action["add"]["path"])} if "add" in action else set()
    return frozenset(live)


def _added(checkpoint: Path) -> set[str]:
    actions = pq.read_table(checkpoint, columns=["add"])["add"].combine_chunks()
    paths: pa.Array = actions.field("path")
    return {unquote(path) for path in paths.to_pylist() if path is not None}


def _version(path: Path) -> int:
    number = path.name.partition(".")[0]
    return int(number) if number.isdigit() else -1
