"""A name of its own for each motor's page, on any file system, in any URL."""

from __future__ import annotations

import re

from hypothesis import given
from hypothesis import strategies as st

from pipeline.report.names import file_names

HOSTILE = ["../../x", "a/b", "a\\b", "", ".", "..", "CON", "nul.txt", "x.", "</script>", "a b", "é"]


@given(
    st.sets(st.text(max_size=80) | st.sampled_from([*HOSTILE, "a", "A", "CB560-01"]), max_size=8)
)
def test_names_are_harmless_and_differ(ids: set[str]) -> None:
    names = file_names(ids)
    assert set(names) == ids
    assert len({name.casefold() for name in names.values()}) == len(ids)
    for name in names.values():
        assert re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}", name)
        assert not name.endswith(".")


def test_a_hostile_id_is_no_part_of_its_name() -> None:
    for name in HOSTILE:
        assert re.fullmatch("motor-[0-9a-f]{12}", file_names([name])[name]), name


def test_ids_of_a_config_keep_their_name_unless_they_differ_in_case_alone() -> None:
    ids = ["CB560-01", "winch_1", "x.2"]
    assert file_names(ids) == {name: name for name in ids}
    assert set(file_names(["a-1", "A-1"]).values()).isdisjoint({"a-1", "A-1"})
