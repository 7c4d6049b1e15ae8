"""Every built-in format through the conformance kit, and configs that no reader could follow."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.ingest import time_span
from pipeline.ingest.conformance import Check, Format, checks_of, many_rows

from .writers import FORMATS


@pytest.mark.parametrize(
    ("form", "check"),
    [
        pytest.param(form, check, id=f"{form.name}-{check.__name__}")
        for form in FORMATS
        for check in checks_of(form)
    ],
)
def test_conformance(form: Format, check: Check, tmp_path: Path) -> None:
    check(form, tmp_path)


@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_a_log_of_another_format_is_an_error(form: Format, tmp_path: Path) -> None:
    for other in FORMATS:
        if other.log_format != form.log_format:
            path = other.written(tmp_path, many_rows(20))
            assert form.code(path)
            assert form.code(path, time_span)
