"""Every built-in format through the conformance kit, and configs that no reader could follow."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from pipeline.ingest import time_span
from pipeline.ingest.conformance import CHANNELS, Check, Format, checks_of, many_rows

from .sources import changed, logs_of
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


@pytest.mark.parametrize(
    "wrong",
    [
        {"source": ""},
        {"scale": 0.0},
        {"scale": float("inf")},
        {"offset": float("nan")},
    ],
    ids=str,
)
def test_channels_that_cannot_be_read_are_refused_when_they_are_named(
    wrong: dict[str, Any],
) -> None:
    with pytest.raises(ValidationError, match=r"\w"):
        changed(CHANNELS["pressure_difference"], **wrong)


@pytest.mark.parametrize(
    "wrong",
    [
        {"log_format": "xlsx"},
        {"separator": ";;"},
        {"separator": '"'},
        {"separator": "·"},
        {"decimal": ","},
        {"decimal": ";"},
        {"skip_rows": -1},
        {"unit_rows": -1},
        {"thousands": "x"},
        {"thousands": ","},
        {"thousands": "."},
        {"layout": "tall"},
        {"encoding": "klingon"},
        {"encoding": "rot13"},
        {"time_zone": "Mars/Olympus"},
        {"time_zone": "../../etc/passwd"},
        {"time_zone": ""},
        {"time_format": "%H:%M:%S"},
        {"time_format": "%Y-%m-%d"},
        {"time_format": "%Y-%m-%d %q"},
        {"time_format": "%Y-%m-%d %H:%M:%S %f"},
        {"time_format": "%d.%m.%Y %I:%M"},
        {"time_format": "epoch"},
        {"time_format": ""},
    ],
    ids=str,
)
def test_sources_that_cannot_work_are_refused_when_they_are_made(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match=r"\w"):
        logs_of(**{"log_format": "csv"} | wrong)
