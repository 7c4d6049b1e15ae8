"""Protobuf messages in MCAP, against the format's own decoder."""

from __future__ import annotations

import random
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from google.protobuf import descriptor_pb2

from pipeline.ingest.conformance import T0_US
from tests.pipeline.ingest.mcap.protobuf_files import NAME, class_of, made_of, protobuf, set_of
from tests.pipeline.ingest.mcap_files import (
    Value,
    all_values,
    error_of,
    mcap_of,
    officially,
    read,
    source_of,
    values,
)

HYDRAULICS = (
    "google.protobuf.Timestamp stamp; motor.Port port; repeated motor.Port ports; "
    "repeated float values; int64 total; bool running; string name; optional double maybe; "
    "motor.Mode mode; google.protobuf.DoubleValue wrapped; map double by_name; "
    "oneof double bar; oneof int32 raw; motor.Hydraulics itself"
)
DESCRIPTORS = set_of("proto3", Port="double pressure; uint32 side", Hydraulics=HYDRAULICS)


@pytest.fixture(scope="module")
def hydraulics() -> Callable[..., bytes]:
    """Maker of payloads."""
    made = class_of(DESCRIPTORS)
    return lambda **fields: made_of(made, fields)


def test_messages_are_read_as_by_the_official_reader(
    tmp_path: Path, hydraulics: Callable[..., bytes]
) -> None:
    rng = random.Random(5)  # noqa: S311
    payloads = [
        hydraulics(
            port={"pressure": rng.gauss(100, 20), "side": i % 2},
            ports=[{"pressure": rng.random()} for _ in range(rng.randrange(4))],
            values=[rng.random() for _ in range(rng.randrange(4))],
            total=rng.randrange(-(2**63), 2**63),
            running=bool(i % 3),
            mode=(0, 1, 7)[i % 3],
            name="x" * (i % 5),
        )
        for i in range(200)
    ]
    path = tmp_path / "log.mcap"
    path.write_bytes(protobuf(payloads, DESCRIPTORS))
    fields = ("port.pressure", "port.side", "ports[2].pressure", "values[0]", "total")
    for field, found in all_values(path, (*fields, "running", "mode")).items():
        assert found == officially(path, field)
        assert any(found)


def test_what_is_not_set_is_missing_where_that_can_be_told(
    tmp_path: Path, hydraulics: Callable[..., bytes]
) -> None:
    full = hydraulics(
        port={},
        maybe=0.0,
        values=[1.0],
        wrapped=0.0,
        by_name={"oil": 50.5},
        bar=0.0,
        itself={"itself": {"total": 8}},
    )
    path = tmp_path / "log.mcap"
    path.write_bytes(protobuf([hydraulics(), full], DESCRIPTORS))
    wanted: dict[str, list[Value]] = {
        "total": [0.0, 0.0],
        "running": [0.0, 0.0],
        "mode": [0.0, 0.0],
        "port.pressure": [None, 0.0],
        "maybe": [None, 0.0],
        "values[0]": [None, 1.0],
        "wrapped.value": [None, 0.0],
        "bar": [None, 0.0],
        "raw": [None, None],
        "itself.itself.total": [None, 8.0],
    }
    assert all_values(path, list(wanted)) == wanted


def test_a_default_that_proto2_names_is_no_reading(tmp_path: Path) -> None:
    """A field absent from the message was not measured, whatever its default."""
    descriptors = set_of("proto2", Hydraulics="default double oil")
    made = class_of(descriptors)
    data = protobuf([made_of(made, {}), made_of(made, {"oil": 20.5})], descriptors)
    assert values(tmp_path, data, "oil") == [None, 20.5]
    assert officially(tmp_path / "log.mcap", "oil") == [20.5, 20.5]


def test_stamps_within_messages_are_cut_off_to_microseconds(
    tmp_path: Path, hydraulics: Callable[..., bytes]
) -> None:
    texts = ("2025-03-01T06:00:00.000001999Z", "2025-03-01T06:00:01Z", None)
    payloads = [
        hydraulics(total=i, **({"stamp": text} if text else {})) for i, text in enumerate(texts)
    ]
    log = read(tmp_path, protobuf(payloads, DESCRIPTORS), source_of("total", time="stamp"))
    times = log.channels["pressure_difference"].time_us
    assert (times - T0_US).tolist() == [1, 1_000_000]
    assert log.notes == ("1 message without a readable time",)


def test_payloads_that_are_no_protobuf_are_missing_and_counted(
    tmp_path: Path, hydraulics: Callable[..., bytes]
) -> None:
    payloads = [hydraulics(total=5), b"\xff\xff", hydraulics(port={"pressure": 1})[:-1]]
    data = protobuf(payloads, DESCRIPTORS)
    channel = read(tmp_path, data, source_of("total")).channels["pressure_difference"]
    assert channel.missing.tolist() == [False, True, True]
    assert channel.unparsed == 2


@pytest.mark.parametrize(
    ("field", "wrong"),
    [
        ("pressure", "log_column_missing"),
        ("port.bar", "log_column_missing"),
        ("total.a", "log_column_missing"),
        ("total[0]", "log_column_missing"),
        ("ports.pressure", "log_column_missing"),
        ("wrapped.pressure", "log_column_missing"),
        ("values", "log_type"),
        ("by_name", "log_type"),
        ("by_name.oil", "log_type"),
        ("wrapped", "log_type"),
        ("port", "log_type"),
        ("name", "log_type"),
        ("stamp", "log_type"),
    ],
)
def test_fields_that_do_not_serve_are_told(
    tmp_path: Path, hydraulics: Callable[..., bytes], field: str, wrong: str
) -> None:
    data = protobuf([hydraulics(total=1)], DESCRIPTORS)
    assert error_of(tmp_path, data, field).code == wrong


def test_a_field_that_is_not_there_is_told_with_those_that_are(
    tmp_path: Path, hydraulics: Callable[..., bytes]
) -> None:
    message = error_of(tmp_path, protobuf([hydraulics()], DESCRIPTORS), "pressure").message
    for there in ("port.pressure", "ports[0].side", "wrapped.value", "itself.total"):
        assert f"'{there}'" in message
    assert "'name'" not in message


def test_descriptors_that_contradict_themselves_are_damage(tmp_path: Path) -> None:
    whole = DESCRIPTORS.SerializeToString()
    one_missing = descriptor_pb2.FileDescriptorSet(file=DESCRIPTORS.file[:1]).SerializeToString()
    twice = descriptor_pb2.FileDescriptorSet(file=[*DESCRIPTORS.file, DESCRIPTORS.file[0]])
    for name, data in (
        (NAME, b"\xff"),
        (NAME, b""),
        (NAME, one_missing),
        (NAME, twice.SerializeToString()),
        ("motor.Unknown", whole),
    ):
        broken = mcap_of([b""], (name, "protobuf", data), "protobuf")
        assert error_of(tmp_path, broken, "total").code == "log_damaged"


def test_without_the_extra_the_error_says_which(
    tmp_path: Path, hydraulics: Callable[..., bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mcap_protobuf.decoder", None)
    wrong = error_of(tmp_path, protobuf([hydraulics(total=1)], DESCRIPTORS), "total")
    assert wrong.code == "log_extra_missing"
    assert "motor-leakage[protobuf]" in wrong.message
