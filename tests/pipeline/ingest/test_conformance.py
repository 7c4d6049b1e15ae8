"""Every built-in format through the conformance kit, and what no kit of one format can ask."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from pipeline.errors import LogError
from pipeline.ingest.conformance import (
    Check,
    Format,
    checks_of,
    damage_never_raises_anything_else,
    every_sample_comes_back_to_the_last_digit,
    many_rows,
)
from pipeline.setup.sniff import sniff

from .writers import FORMATS, NUMBERS_ONLY

# One of each format; the others, whose packers and encodings differ, are damaged in the full run.
DAMAGED = ("csv", "parquet", "mcap-zstd")


def marks_of(form: Format, check: Check) -> list[pytest.MarkDecorator]:
    is_quick = check is not damage_never_raises_anything_else or form.name in DAMAGED
    return [] if is_quick else [pytest.mark.full]


each_format = pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)


@pytest.mark.parametrize(
    ("form", "check"),
    [
        pytest.param(form, check, id=f"{form.name}-{check.__name__}", marks=marks_of(form, check))
        for form in FORMATS
        # What damage does to text does not hang on its dialect.
        for check in checks_of(form)[: 6 if form.name == "csv-european" else None]
    ]
    + [
        pytest.param(form, check, id=f"{form.name}-{check.__name__}", marks=marks_of(form, check))
        for form in NUMBERS_ONLY
        for check in (every_sample_comes_back_to_the_last_digit, damage_never_raises_anything_else)
    ],
)
def test_conformance(form: Format, check: Check, tmp_path: Path) -> None:
    check(form, tmp_path)


@pytest.mark.parametrize("form", [*FORMATS, *NUMBERS_ONLY], ids=lambda form: form.name)
def test_init_refuses_no_damaged_log_but_with_a_code(form: Format, tmp_path: Path) -> None:
    path = form.written(tmp_path, many_rows(60))
    data = path.read_bytes()
    for at in range(0, len(data), len(data) // 6):
        for other in (data[:at], data[:at] + b"\xff\x00" + data[at + 1 :]):
            path.write_bytes(other)
            with suppress(LogError):
                sniff(path)


@each_format
def test_a_log_of_another_format_is_an_error(form: Format, tmp_path: Path) -> None:
    for other in FORMATS:
        if other.log_format != form.log_format:
            assert all(form.codes(other.written(tmp_path, many_rows(20))))


@each_format
def test_what_may_not_be_opened(
    form: Format, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = form.written(tmp_path, many_rows(5))

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "open", refuse)
    monkeypatch.setattr(pq, "ParquetFile", refuse)
    assert form.codes(path) == ("log_not_readable", "log_not_readable")
