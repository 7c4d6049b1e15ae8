"""JSON messages in MCAP against the `json` module, and what is read and refused of any topic."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer

import pipeline.ingest.mcap.log
from pipeline.ingest import time_span
from pipeline.ingest.conformance import T0_US
from tests.pipeline.ingest.mcap_files import (
    DP,
    ONE,
    T0_NS,
    TOPIC,
    channel_record,
    error_of,
    file_of,
    mcap_bytes,
    mcap_of,
    message_record,
    read,
    source_of,
    values,
)
from tests.pipeline.ingest.sources import Source, column

# Messages, and pairs of which neither is one but both together would be.
PAYLOADS = (
    *(b'{"value": 1}', b'{"value":-1.5e-3}', b' \n{ "value" :\t1.5\r\n} ', b'{"val\\u0075e": 5}'),
    b'{"unit": "bar", "value": 2, "nested": {"value": [3, {"value": 4}]}}',
    *('{"käse": "}{", "value": 6}'.encode(), b'{"text": "\\"value\\": 9", "value": 7}'),
    *(b'{"value": 12345678901234567890123}', b'{"value": 0.1234567890123456789}'),
    *(b'{"value": NaN}', b'{"value": -Infinity}', b'{"value": 1e999}', b'{"value": 1e-999}'),
    *(b'{"value": 1, "value": 2}', b'{"other": [1, 2, {"a": null}], "value": 8}'),
    *(b"", b" ", b"1", b"[1]", b'"value"', b"null", b'{"value": "1.5"}', b'{"value": true}'),
    *(b'{"value": [1]}', b'{"value": {"value": 1}}', b'{"value": 1} {"value": 2}'),
    *(b'{"value": 1}\n{"value": 2}', b'{"value": 1', b'{"value": 01}', b'{"value": +1}'),
    *(b'{"value": 1,}', b"{'value': 1}", b'{"value": 1}\x00', b'{"value"', b": 1}", b"\xff\xfe"),
    *(b"[" * 100_000, b'{"a":' * 50_000),
    (b'{"value":', b"1}"),
    (b'{"value": 2}{"value": 3}', b""),
    (b'{"value": 1}{"a": {}', b', "value": 2}'),
    (b'{"a":', b'{"b": 1}, "value": 2}{"value": 3}'),
    (b'{"value": 1} {"value"', b": 2}"),
    (b'{"a": "}', b'{", "value": 2}{"value": 3}'),
)


@pytest.mark.parametrize("payload", PAYLOADS)
def test_messages_are_read_as_by_the_json_module(
    tmp_path: Path, payload: bytes | tuple[bytes, ...]
) -> None:
    here = payload if isinstance(payload, tuple) else (payload,)
    for beside in ((), (b"?",)):
        _require_same(tmp_path, [b'{"value": 0}', *here, *beside, b'{"value": 4}'])


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=4,
)
payload_bytes = (
    st.binary(max_size=30)
    | json_values.map(lambda value: json.dumps(value).encode())
    | st.dictionaries(st.sampled_from(["value", "v", "values"]), json_values).map(
        lambda value: json.dumps(value).encode()
    )
)


alike = st.text("0123456789.-+e ", max_size=6).map(lambda cell: b'{"value":%s}' % cell.encode())


@given(st.lists(payload_bytes, min_size=1, max_size=12) | st.lists(alike, min_size=1, max_size=3))
def test_any_payloads_as_one_by_one(
    tmp_path_factory: pytest.TempPathFactory, payloads: list[bytes]
) -> None:
    _require_same(tmp_path_factory.mktemp("any"), [b'{"value": 0}', *payloads])


def _require_same(folder: Path, payloads: list[bytes]) -> None:
    """Readings are those of the `json` module, to which the integer -0 has no sign."""
    data = mcap_of(payloads, chunk_size=50)
    channel = read(folder, data).channels["pressure_difference"]
    wanted = [_by_json(payload) for payload in payloads]
    assert channel.missing.tolist() == [value is None for value in wanted]
    np.testing.assert_equal(channel.value + 0, [np.nan if v is None else v + 0 for v in wanted])


def _by_json(payload: bytes) -> float | None:
    try:
        value = json.loads(payload)["value"]
        return None if isinstance(value, bool | str | list | dict) else float(value)
    except (ValueError, TypeError, KeyError, IndexError, RecursionError):
        return None


def test_a_bad_message_among_many_pieces_costs_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipeline.ingest.mcap.log, "_PIECE", 2000)
    payloads = [b'{"value": %d.5}' % i for i in range(3000)]
    payloads[700] = b"?"
    channel = read(tmp_path, mcap_of(payloads, chunk_size=500)).channels["pressure_difference"]
    assert (np.flatnonzero(channel.missing).tolist(), channel.unparsed) == ([700], 1)
    assert channel.value[701:].tolist() == [i + 0.5 for i in range(701, 3000)]


def test_fields_of_one_topic_and_topics_of_other_shapes(tmp_path: Path) -> None:
    channels = {
        "pressure_difference": column("motor", "bar", field="dp"),
        "speed": column("motor", "rpm", field="n"),
        "oil_temperature": column("oil", "degC"),
    }
    sent = [
        ("motor", T0_NS, b'{"dp": 200, "n": 30, "value": "text here"}'),
        ("oil", T0_NS + 1000, b'{"value": 50, "dp": {"n": 1}}'),
        ("camera", T0_NS + 2000, bytes(range(256))),
        ("motor", T0_NS + 3000, b'{"n": 31, "dp": 201}'),
    ]
    log = read(tmp_path, mcap_bytes(sent), Source.of("mcap", channels))
    found = [(part.value.tolist(), part.unparsed) for part in log.channels.values()]
    assert found == [([200.0, 201.0], 0), ([50.0], 0), ([30.0, 31.0], 0)]
    assert (log.rows, log.channels["oil_temperature"].time_us.tolist()) == (3, [T0_US + 1])


# Stamps within the messages, and the time of publishing


def stamped(*stamps: str) -> bytes:
    return mcap_of([b'{"value": 1, "head": {"t": %s}}' % stamp.encode() for stamp in stamps])


def ros2_stamped() -> bytes:
    stamp = "===\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    text = f"string name\nbuiltin_interfaces/Time stamp\nfloat64 at\nint64 value\n{stamp}"
    payloads = [
        struct.pack("<4sI4siIdq", b"\0\1\0\0", 3, b"ab\0", 1740808800 + i, 999, 1740808800.25, i)
        for i in range(3)
    ]
    return mcap_of(payloads, ("m/msg/M", "ros2msg", text.encode()), "cdr")


SECONDS = '{"sec": 1740808800, "nsec": 1999}'


@pytest.mark.parametrize(
    ("data", "keys", "wanted"),
    [
        *(
            (stamped(*stamps), {"time": "head.t", "time_format": form}, wanted)
            for stamps, form, wanted in (
                (['"2025-03-01T06:00:00.5Z"', '"2025-03-01T06:00:01+00:00"'], "iso8601", [0.5, 1]),
                (['"2025-03-01T07:00:00"', '"2025-03-01T07:00:01"'], "iso8601", [0, 1]),
                (["1740808800.25", "1740808801"], "epoch_s", [0.25, 1]),
                (["1740808800", "1740808801.5"], "epoch_s", [0, 1.5]),
                (["1740808800000000999", "1740808800000001000"], "epoch_ns", [0, 1e-6]),
                (['"1740808800500"'], "epoch_ms", [0.5]),
                ([SECONDS], "iso8601", [1e-6]),
                (['{"seconds": 1740808801, "nanos": 5000}'], "iso8601", [1.000005]),
                ([SECONDS, '"2025-03-01T06:00:01Z"'], "iso8601", [1e-6, 1]),
                # One that does not parse sends the piece the slow way.
                ([SECONDS, "true", SECONDS], "iso8601", [1e-6] * 2),
                ([SECONDS, SECONDS.replace("1999", "1000000000")] * 2, "iso8601", [1e-6] * 2),
            )
        ),
        (ros2_stamped(), {"time": "stamp"}, [0, 1, 2]),
        (ros2_stamped(), {"time": "at", "time_format": "epoch_s"}, [0.25] * 3),
        (mcap_of([b'{"value": 1}'] * 2), {"time": "publish_time"}, [-5, -4.999]),
    ],
)
def test_stamps(tmp_path: Path, data: bytes, keys: dict[str, str], wanted: list[float]) -> None:
    source = source_of("value", time_zone="Europe/Berlin", **keys)
    log = read(tmp_path, data, source)
    times = log.channels["pressure_difference"].time_us
    assert times.tolist() == [T0_US + round(1e6 * seconds) for seconds in wanted]
    assert time_span(tmp_path / "log.mcap", *source) == (times.min(), times.max())
    assert log.rows == times.size


def test_a_stamp_may_be_a_reading_too(tmp_path: Path) -> None:
    numbers = mcap_of([b'{"t": 1740808800123}', b'{"t": 1740808801123}'])
    log = read(tmp_path, numbers, source_of("t", time="t", time_format="epoch_ms"))
    channel = log.channels["pressure_difference"]
    assert channel.value.tolist() == [1740808800123.0, 1740808801123.0]
    assert (channel.time_us - T0_US).tolist() == [123_000, 1_123_000]


# Paths, and what is refused


@pytest.mark.parametrize(
    ("field", "payloads", "wanted"),
    [
        ("hydraulics.pressure.a", [b'{"hydraulics": {"pressure": {"a": 1, "b": 2}}}'], [1]),
        ("/hydraulics.pressure.a", [b'{"pressure": {"a": 3}}'], [3]),
        ("p[1]", [b'{"p": [1, 2]}', b'{"p": [5]}', b'{"p": null}', b"{}"], [2, None, None, None]),
        ("p[0].x", [b'{"p": [{"x": 1, "y": []}, 7]}', b'{"p": [{"x": 2}]}'], [1, 2]),
        ("p[1][0]", [b'{"p": [[1], [2, 3]]}', b'{"p": [[], []]}'], [2, None]),
        (r"engine\.rpm", [b'{"engine.rpm": 30, "engine": {"rpm": 4}}'], [30]),
        ("a.b", [b'{"a": {"b": 1}}', b'{"a": 5}', b'{"a": null}', b'{"a": {}}'], [1, *[None] * 3]),
        ("a.b", [b'{"a": {"b": 1, "b": 2}}', b'{"a": {"b": 1}, "a": {"b": 3}}'], [2, 3]),
        ("value", [b"{}", b'{"value": null}', b'{"other": 2}', b'{"value": 1}'], [*[None] * 3, 1]),
    ],
)
def test_paths_into_json_messages(
    tmp_path: Path, field: str, payloads: list[bytes], wanted: list[float | None]
) -> None:
    for beside, more in (([], []), ([b"?"], [None])):
        assert values(tmp_path, mcap_of([*payloads, *beside]), field) == [*wanted, *more]


def test_a_value_and_a_part_of_it_are_both_read_where_they_are(tmp_path: Path) -> None:
    log = read(tmp_path, mcap_of([b'{"a": 1}', b'{"a": {"b": 2}}']), source_of("a", "a.b"))
    np.testing.assert_array_equal(log.channels["pressure_difference"].value, [1.0, np.nan])
    np.testing.assert_array_equal(log.channels["high_port_pressure"].value, [np.nan, 2.0])


def two_kinds(*, alike: bool) -> bytes:
    """A topic with two channels, of one kind or not."""
    if alike:
        return file_of(DP, channel_record(2), ONE, message_record(2, T0_NS, b'{"value": 2}'), ONE)
    buffer = io.BytesIO()
    writer = Writer(buffer)
    writer.start()
    writer.register_channel(TOPIC, "json", 0)
    writer.register_channel(TOPIC, "cdr", writer.register_schema("m/H", "ros2msg", b"float64 a"))
    writer.finish()
    return buffer.getvalue()


def test_two_channels_of_one_topic_are_one(tmp_path: Path) -> None:
    assert values(tmp_path, two_kinds(alike=True), "value") == [1.0, 2.0, 1.0]


NESTED = mcap_of([b'{"p": {"a": 1, "b": [2, {"c": 3}]}}'])
LATE = '{"sec": 1740808800, "nsec": 1000000000}'


@pytest.mark.parametrize(
    ("data", "keys", "code", "words"),
    [
        (NESTED, {"field": "p.c"}, "log_column_missing", "'p.a', 'p.b[0]', 'p.b[1].c'"),
        (mcap_of([b'{"bar": 1}', b'{"bar": 2}']), {}, "log_column_missing", "'value'; there are"),
        (stamped(LATE), {"time": "head.t"}, "log_time", "head.t"),
        (stamped(SECONDS), {"time": "head.none"}, "log_time", "head.none"),
        (stamped("1740808800"), {"time": "head.t"}, "log_time", "head.t"),
        (mcap_of([b'{"t": "2025-03-01T06:00:00Z"}']), {"field": "t", "time": "t"}, "log_type", ""),
        (two_kinds(alike=False), {}, "log_encoding", "two kinds"),
        *(
            (mcap_of([b""], schema, encoding), {}, "log_encoding", TOPIC)
            for schema, encoding in (
                (("H", "omgidl", b"struct H {}"), "cdr"),
                (("motor/srv/M_Event", "ros2msg", b"float64 value"), "cdr"),
                (("H", "ros2idl", b"module m { struct H { double value; }; };"), "cdr"),
                (("H", "ros1msg", b"float64 value"), "ros1"),
                (("H", "flatbuffer", b""), "flatbuffer"),
                (("H", "", b""), "protobuf"),
                (("H", "protobuf", b""), "cdr"),
                (("", "", b""), "cbor"),
            )
        ),
    ],
)
def test_what_is_refused(
    tmp_path: Path, data: bytes, keys: dict[str, Any], code: str, words: str
) -> None:
    wrong = error_of(tmp_path, data, **keys)
    assert wrong.code == code
    assert words in wrong.message
