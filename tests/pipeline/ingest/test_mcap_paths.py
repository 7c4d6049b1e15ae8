"""Paths to a field within a message."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from pipeline.config.motors import Channel, Logs
from pipeline.errors import UsageError
from pipeline.ingest import ChannelSource, LogSource
from pipeline.ingest.mcap_paths import FieldPath, field_path, path_text


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
        lambda: ChannelSource("speed", "n", "rpm", field=field),
        lambda: LogSource("mcap", (ChannelSource("speed", "n", "rpm"),), stamp=field or "."),
    ):
        with pytest.raises(UsageError) as raised:
            refused()
        assert raised.value.code == "field_path"


@given(
    st.text(min_size=1).filter(lambda key: not key.startswith("/")),
    st.lists(st.text(min_size=1) | st.integers(0, 999), max_size=5),
)
def test_written_paths_read_back(first: str, steps: list[str | int]) -> None:
    path = (first, *steps)
    assert field_path(path_text(path)) == path


def test_a_config_is_told_of_a_wrong_path_and_passes_the_keys_on() -> None:
    with pytest.raises(ValidationError, match="is no path"):
        Channel(source="dp", unit="bar", field="a..b")
    with pytest.raises(ValidationError, match="is no path"):
        Logs(format="mcap", files=("*.mcap",), stamp="header.")
    logs = Logs(format="mcap", files=("*.mcap",), stamp="header.stamp", salvage=True)
    source = logs.source((ChannelSource("speed", "n", "rpm"),))
    assert (source.stamp, source.salvage) == ("header.stamp", True)
