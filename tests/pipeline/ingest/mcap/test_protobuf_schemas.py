"""Any schema of Protobuf, against the format's own decoder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.pipeline.ingest.mcap.protobuf_files import (
    KEYS,
    NUMBERS,
    WRAPPERS,
    Field,
    Member,
    by_its_json,
    class_of,
    declared,
    made_of,
    protobuf,
    set_of,
)
from tests.pipeline.ingest.mcap_files import all_values, official_messages


@st.composite
def schemas(draw: st.DrawFn) -> tuple[str, dict[str, list[Member]]]:
    """A syntax, and members by name of the message; the last message holds no other."""
    syntax = draw(st.sampled_from(["proto2", "proto3"]))
    types: list[tuple[int, str]] = [
        (kind, ".motor.Mode" if kind == Field.TYPE_ENUM else "") for kind in NUMBERS
    ]
    types += [(Field.TYPE_STRING, ""), (Field.TYPE_BYTES, "")]
    types += [(Field.TYPE_MESSAGE, f".google.protobuf.{name}") for name in WRAPPERS]
    last = "default" if syntax == "proto2" else "plain"
    roles = st.sampled_from(["plain", "optional", "oneof", "many", "map", last])
    messages: dict[str, list[Member]] = {}
    for name, inner in (("Port", []), ("Hydraulics", [(Field.TYPE_MESSAGE, ".motor.Port")] * 6)):
        drawn = draw(
            st.lists(
                st.tuples(st.sampled_from(types + inner), roles, st.sampled_from(list(KEYS))),
                min_size=1,
                max_size=6,
            )
        )
        messages[name] = [
            Member(f"f{i}", kind, type_name, role, key)
            for i, ((kind, type_name), role, key) in enumerate(drawn)
        ]
    return syntax, messages


def content(messages: Mapping[str, Sequence[Member]], name: str) -> st.SearchStrategy[Any]:
    """Keyword arguments of a message, in which anything may be left out."""
    each = {}
    for member in messages[name]:
        one = of_one(messages, member)
        each[member.name] = {
            "many": st.lists(one, max_size=3),
            "map": st.dictionaries(KEYS.get(member.key, st.none()), one, max_size=3),
        }.get(member.role, one)
    return st.fixed_dictionaries({}, optional=each)


def of_one(messages: Mapping[str, Sequence[Member]], member: Member) -> st.SearchStrategy[Any]:
    if member.type_name == ".motor.Port":
        return content(messages, "Port")
    wrapped = WRAPPERS.get(member.type_name.rpartition(".")[2])
    if wrapped is not None:
        return st.fixed_dictionaries({"value": NUMBERS[wrapped]})
    if member.kind == Field.TYPE_STRING:
        return st.text(max_size=4)
    return NUMBERS.get(member.kind, st.binary(max_size=4))


def paths_of(messages: Mapping[str, Sequence[Member]], name: str) -> list[str]:
    """Paths to all numbers: of arrays the first and one that may not be there, of maps some key."""
    paths = []
    for member in messages[name]:
        at = [member.name]
        if member.role == "many":
            at = [f"{member.name}[0]", f"{member.name}[2]"]
        elif member.role == "map":
            at = [f"{member.name}.{key}" for key in keys_of(member.key)]
        if member.type_name == ".motor.Port":
            paths += [f"{one}.{two}" for one in at for two in paths_of(messages, "Port")]
        elif member.kind in NUMBERS or member.type_name.startswith(".google"):
            paths += at
    return paths


def keys_of(kind: int) -> tuple[str, ...]:
    if kind == Field.TYPE_STRING:
        return (r"oil", r"a\.b", r"\[1\]")
    return ("true", "false") if kind == Field.TYPE_BOOL else ("0", "1")


@settings(max_examples=80)
@given(data=st.data(), schema=schemas())
def test_any_schema_is_read_as_by_the_official_reader(
    tmp_path_factory: pytest.TempPathFactory,
    data: st.DataObject,
    schema: tuple[str, dict[str, list[Member]]],
) -> None:
    syntax, messages = schema
    all_declared = [declared(name, members, syntax) for name, members in messages.items()]
    descriptors = set_of(syntax, *all_declared)
    made = class_of(descriptors)
    contents = data.draw(st.lists(content(messages, "Hydraulics"), min_size=1, max_size=4))
    path = tmp_path_factory.mktemp("protobuf") / "log.mcap"
    path.write_bytes(protobuf([made_of(made, one) for one in contents], descriptors))
    decoded = official_messages(path)
    for field, found in all_values(path, paths_of(messages, "Hydraulics")[:24]).items():
        wanted = [by_its_json(one, field) for one in decoded]
        np.testing.assert_equal(found, wanted, err_msg=field)
