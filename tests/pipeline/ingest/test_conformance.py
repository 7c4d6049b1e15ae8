"""Every built-in format through the conformance kit, and what no kit of one format can ask."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from pipeline.config import load_fleet
from pipeline.errors import LogError
from pipeline.ingest import contract, read_log
from pipeline.ingest.conformance import (
    CHANNELS,
    Cell,
    Check,
    Format,
    Row,
    checks_of,
    damage_never_raises_anything_else,
    many_rows,
    pressures,
)
from pipeline.logs.files import covered
from pipeline.logs.processed import FileRecord
from pipeline.setup.sniff import sniff
from tests.pipeline.simulated import motor_toml, write_configs

from .writers import FORMATS, NUMBERS_ONLY

each_format = pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)


@pytest.mark.parametrize(
    ("form", "check"),
    [
        pytest.param(form, check, id=f"{form.name}-{check.__name__}")
        for form in FORMATS
        for check in checks_of(form)
    ]
    + [
        pytest.param(form, damage_never_raises_anything_else, id=f"{form.name}-damage")
        for form in NUMBERS_ONLY
    ],
)
def test_conformance(form: Format, check: Check, tmp_path: Path) -> None:
    check(form, tmp_path)


@pytest.mark.parametrize("form", [*FORMATS, *NUMBERS_ONLY], ids=lambda form: form.name)
def test_init_refuses_no_damaged_log_but_with_a_code(form: Format, tmp_path: Path) -> None:
    path = form.written(tmp_path, many_rows(60))
    data = path.read_bytes()
    for at in range(0, len(data), 64):
        for other in (data[:at], data[:at] + b"\xff\x00" + data[at + 1 :]):
            path.write_bytes(other)
            with suppress(LogError):
                sniff(path)


def test_the_contract_lists_every_code_of_a_reader() -> None:
    folder = Path(contract.__file__).parent
    raised = {
        code
        for path in folder.rglob("*.py")
        for code in re.findall(r'"(log_[a-z]+(?:_[a-z]+)*)"', path.read_text("utf-8"))
    }
    listed = set(re.findall(r"``(log_\w+)``", contract.__doc__ or ""))
    assert raised - {"log_of_samples"} <= listed


@each_format
def test_a_log_of_another_format_is_an_error(form: Format, tmp_path: Path) -> None:
    for other in FORMATS:
        if other.log_format != form.log_format:
            assert all(form.codes(other.written(tmp_path, many_rows(20))))


@each_format
def test_all_null_is_read_as_what_it_is_and_told_by_the_file_s_record(
    form: Format, tmp_path: Path
) -> None:
    """A reader judges nothing but the file itself; the record of the file has the code."""
    (spec,) = load_fleet(write_configs(tmp_path, {"M1": motor_toml("M1")})).motors
    record = FileRecord(f"log.{form.log_format}", 1, 1, "x")

    def read(**cells: Cell) -> Any:
        rows = [
            Row(pressure.time_us, {**pressure.cells, **cells})
            for pressure in pressures([200.0] * 5)
        ]
        return form.read(tmp_path, rows)

    log = read(dp=None, T=None, q=None)
    assert all(channel.missing.all() for channel in log.channels.values())
    with pytest.raises(LogError, match=record.path) as raised:
        covered(record, log, spec)
    assert (raised.value.code, raised.value.place) == ("log_empty", "pressure_difference")
    assert "all 5 cells of leakage_flow are blank" in raised.value.message
    found = covered(record, read(T=None), spec)
    assert (found.status, found.message) == ("ok", "all 5 cells of oil_temperature are blank")


@each_format
def test_what_may_not_be_opened(
    form: Format, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = form.written(tmp_path, many_rows(5))
    if os.geteuid():
        path.chmod(0)
    else:  # for whom nothing is forbidden

        def refuse(*_: object, **__: object) -> None:
            raise PermissionError(13, "Permission denied", str(path))

        monkeypatch.setattr(Path, "open", refuse)
        monkeypatch.setattr(pq, "ParquetFile", refuse)
    assert form.codes(path) == ("log_not_readable", "log_not_readable")
    with pytest.raises(LogError, match="Permission denied"):
        read_log(path, form.logs, CHANNELS)
