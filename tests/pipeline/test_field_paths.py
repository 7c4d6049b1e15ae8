"""Paths to a field within a message."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.config.channels import Channel
from pipeline.config.dialect import FieldPath, field_path, path_text
from pipeline.config.logs import Logs


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
    for refused in (
        lambda: field_path(field),
        lambda: Channel(source="dp", unit="bar", field=field),
        lambda: Logs(format="mcap", files=("*.mcap",), stamp=field or "."),
    ):
        with pytest.raises(ValueError, match=r"is no path|at least 1 character"):
            refused()


@given(
    st.text(min_size=1).filter(lambda key: not key.startswith("/")),
    st.lists(st.text(min_size=1) | st.integers(0, 999), max_size=5),
)
def test_written_paths_read_back(first: str, steps: list[str | int]) -> None:
    path = (first, *steps)
    assert field_path(path_text(path)) == path
