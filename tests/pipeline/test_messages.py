"""Messages: one JSON object a line where programs read, of workers and of wrong usage, too."""

from __future__ import annotations

import io
import json
import logging
import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.config.logs import FieldPath, field_path, path_text
from pipeline.messages import FORM, JsonLine, error_line, speak_as_parent
from tests.pipeline.calling import Call, python


def test_a_record_is_one_line_with_its_traceback() -> None:
    stream = io.StringIO()
    handler = logging.StreamHandler(stream)
    handler.setFormatter(JsonLine())
    log = logging.Logger("pipeline.somewhere")
    log.addHandler(handler)
    try:
        int("two\nlines")
    except ValueError:
        log.exception("motor %s failed", "M1")
    (line,) = stream.getvalue().splitlines()
    record = json.loads(line)
    expected = {"event": "log", "level": "error", "logger": "pipeline.somewhere"}
    assert record.items() >= (expected | {"message": "motor M1 failed"}).items()
    assert record["time"].endswith("+00:00")
    assert "ValueError: invalid literal" in record["traceback"]
    line = error_line("config", "two\nlines", 2, as_json=True)
    assert "\n" not in line
    assert json.loads(line)["message"] == "two\nlines"


def test_errors_and_wrong_usage_are_objects(call: Call, tmp_path: Path) -> None:
    for arguments, code, words in (
        (("fit-fleet", "--json", "--no-such"), "usage", "No such option: --no-such"),
        (("fit-fleet", "--json", str(tmp_path / "none.toml")), "config", "cannot be read"),
        (("fit-fleet", "--json"), "usage", "CONFIG"),
    ):
        exit_code, out, err = call(*arguments)
        line = json.loads(err)
        assert (exit_code, out) == (2, "")
        assert (line["event"], line["code"], line["exit_code"]) == ("error", code, 2)
        assert words in line["message"]


@pytest.mark.parametrize("form", ["", "json"])
def test_a_worker_speaks_as_it_is_asked(form: str) -> None:
    code = (
        "import logging; from pipeline.messages import speak_as_parent as speak; speak(); speak();"
        "logging.getLogger('pipeline.x').warning('careful')"
    )
    done = python(code, env=os.environ | {FORM: form})
    if form:
        assert json.loads(done.stderr)["message"] == "careful"
    else:
        assert done.stderr == "WARNING pipeline.x: careful\n"


def test_a_program_that_logs_already_keeps_its_way() -> None:
    before = list(logging.getLogger().handlers)
    assert before, "pytest has put its own there"
    speak_as_parent()
    assert logging.getLogger().handlers == before


# Paths to a field within a message


@pytest.mark.parametrize(
    ("field", "topic", "path"),
    [
        ("value", "dp", ("value",)),
        ("hydraulics.pressure.a", "", ("hydraulics", "pressure", "a")),
        ("/hydraulics.pressure.a", "/motor", ("hydraulics", "pressure", "a")),
        ("/hydraulics.pressure.a", "/hydraulics", ("pressure", "a")),
        ("hydraulics.pressure.a", "hydraulics", ("hydraulics", "pressure", "a")),
        ("p[0]", "", ("p", 0)),
        ("p[10][2].x y", "", ("p", 10, 2, "x y")),
        (r"a\.b\[0\].c\\d", "", ("a.b[0]", "c\\d")),
        ("Öl-Druck/1", "", ("Öl-Druck/1",)),
    ],
)
def test_paths(field: str, topic: str, path: FieldPath) -> None:
    assert field_path(field, topic) == path


@pytest.mark.parametrize(
    "field", ["", "/", "a.", ".a", "a..b", "[0]", "a[", "a[x]", "a[-1]", "a[0]b", "a]", "a\\"]
)
def test_what_is_no_path_is_refused(field: str) -> None:
    with pytest.raises(ValueError, match="is no path"):
        field_path(field)


@given(
    st.text(min_size=1).filter(lambda key: not key.startswith("/")),
    st.lists(st.text(min_size=1) | st.integers(0, 999), max_size=5),
)
def test_written_paths_read_back(first: str, steps: list[str | int]) -> None:
    path = (first, *steps)
    assert field_path(path_text(path)) == path
