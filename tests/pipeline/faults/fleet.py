"""Two motors and two nights: as published before, as they come to be, what a run leaves; damage."""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import polars as pl
import pytest

import pipeline.run.fleet
import pipeline.run.motor_task
from pipeline.night.fit_night import NightOutcome, fit_night
from pipeline.run.fleet import RunResult
from pipeline.schema import TABLES, Table
from pipeline.store.published import TableFault, verify_tables
from pipeline.store.state import STATE_FILE
from pipeline.store.tables import files_of, name_of, read_table
from tests.pipeline import calling
from tests.pipeline.simulated import NIGHT
from tests.pipeline.workshop import DAY, QUICK, Workshop
from tests.pipeline.written import LASTING, processed_of, record_of

# Of a process that imports the tests.
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path.cwd()), *sys.path])}
MOTORS = ("M1", "M2")
LATER = NIGHT + DAY
Tables = dict[str, pl.DataFrame]


class TinyFleet(Workshop):
    """Logs and config, and outputs as runs leave them."""

    @property
    def before(self) -> Path:
        """Output with the first night of both motors."""
        return self.folder / "before"

    @property
    def after(self) -> Path:
        """After another run: a log of the night was corrected, and those of the second came."""
        return self.folder / "after"

    @classmethod
    def at(cls, folder: Path) -> TinyFleet:
        """Make it, and both outputs."""
        made = cls(folder)
        made.configure(fleet=QUICK, motors=MOTORS)
        for number, motor in enumerate(MOTORS):
            made.log(NIGHT, seed=number, motor=motor)
        made.run(made.before)
        made.log(NIGHT, seed=7)
        for number, motor in enumerate(MOTORS):
            made.log(LATER, seed=10 + number, motor=motor)
        shutil.copytree(made.before, made.after)
        made.run(made.after)
        return made

    def run(self, output: Path, **execution: Any) -> RunResult:
        return calling.run(self.fleet, output=output, **execution)


@contextmanager
def remembered_fits() -> Iterator[None]:
    """A night's fit hangs on its inputs alone: each is done once, however many runs there are."""
    known: dict[object, NightOutcome] = {}

    def fit(spec: Any, night: Any, channels: Mapping[str, Any]) -> NightOutcome:
        content = tuple(
            (name, channel.time_us.tobytes(), channel.value.tobytes())
            for name, channel in sorted(channels.items())
        )
        key = (spec.motor_id, night, content)
        if key not in known:
            known[key] = fit_night(spec, night, channels)
        return known[key]

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(pipeline.run.motor_task, "fit_night", fit)
        yield


def tables_in(output: Path) -> Tables:
    """Rows of every table file by its path, and by night, without the run that wrote them."""
    found = {}
    for table in TABLES:
        for path in files_of(output, table):
            rows = _rows(path, path.read_bytes(), table)
            if "night" not in table.key:
                found[name_of(output, path)] = rows
                continue
            for (night,), part in rows.partition_by("night", as_dict=True).items():
                found[f"{name_of(output, path)} {night}"] = part
    return found


_READ: dict[tuple[str, bytes], pl.DataFrame] = {}


def _rows(path: Path, content: bytes, table: Table) -> pl.DataFrame:
    """Rows of a file; the same bytes are decoded once."""
    key = (table.name, hashlib.sha256(content).digest())
    if key not in _READ:
        _READ[key] = read_table(path, table).drop("run_id", strict=False)
    return _READ[key]


def same(first: pl.DataFrame | None, second: pl.DataFrame | None) -> bool:
    """True if two files hold the same rows; a file without rows equals a missing one."""
    if first is None or second is None:
        return all(rows is None or not rows.height for rows in (first, second))
    return first.equals(second, null_equal=True)


def check_old_or_new(output: Path, old: Path, new: Path) -> None:
    """Every table file is whole, as it was or as it comes to be, and provable; no key twice."""
    now, before, after = (tables_in(folder) for folder in (output, old, new))
    for name in sorted(now.keys() | before.keys() | after.keys()):
        if name.split("/")[0] not in calling.OF_RUNS:
            assert any(same(now.get(name), state.get(name)) for state in (before, after)), name
    assert list(verify_tables(output)) == []
    for table in TABLES:
        check_keys(now, table)


def check_keys(tables: Tables, table: Table) -> None:
    key = [name for name in table.key if name != "run_id"]
    parts = [rows.select(key) for name, rows in tables.items() if name.split("/")[0] == table.name]
    if parts and key:
        assert pl.concat(parts).is_unique().all(), table.name


def check_repaired(output: Path, expected: Path) -> None:
    """All is as if nothing had been."""
    check_tables(output, expected)
    for motor in MOTORS:
        assert processed_of(output, motor) == processed_of(expected, motor)
        assert record_of(output, motor) == record_of(expected, motor)
    assert list(verify_tables(output)) == []
    assert temporary(output) == []


def check_tables(output: Path, expected: Path) -> None:
    """All tables are those of a run that nothing disturbed."""
    now, after = tables_in(output), tables_in(expected)
    for name in sorted(now.keys() | after.keys()):
        if name.split("/")[0] not in calling.OF_RUNS:
            assert same(now.get(name), after.get(name)), name


def temporary(output: Path) -> list[Path]:
    """Files that should not outlive a run."""
    strangers = {path.name for path in output.iterdir()} - LASTING
    # SQLite leaves its log where there is no room to put it into the file.
    strangers = {name for name in strangers if not name.startswith(f"{STATE_FILE}-")}
    return [*map(Path, sorted(strangers)), *output.rglob(".writing-*"), *output.rglob("*.damaged")]


def flip(path: Path, place: int) -> None:
    """Flip a bit of a byte of a file; its time stays, as it does on a disk."""
    state = path.stat()
    content = bytearray(path.read_bytes())
    content[place] ^= 4
    path.write_bytes(content)
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))


def rot(path: Path) -> None:
    """Flip a bit of the content; of a table, in a first page, whose header no checksum covers."""
    flip(path, min(path.stat().st_size // 3, 210))


def rot_of_footer(path: Path) -> None:
    flip(path, path.stat().st_size - 100)


def codes_of(damage: Iterable[TableFault]) -> list[tuple[str, str]]:
    return [(fault.path, fault.code) for fault in damage]


def remove_aside(output: Path) -> int:
    """Remove what was put aside, which people look at; how many files it were."""
    aside = list(output.rglob("*.damaged"))
    for path in aside:
        path.unlink()
    return len(aside)
