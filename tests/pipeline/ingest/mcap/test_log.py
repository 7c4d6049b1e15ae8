"""Log features and faults specific to MCAP, against the official reader and the specification."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import pipeline.ingest.mcap.json
import pipeline.ingest.mcap.log
import pipeline.ingest.mcap.messages
from pipeline.ingest import read_log
from pipeline.ingest.conformance import T0_US
from tests.pipeline.ingest.mcap_files import (
    DP,
    ONE,
    SOURCE,
    T0_NS,
    channel_record,
    error_of,
    file_of,
    mcap_bytes,
    mcap_of,
    message_record,
    pressure,
    read,
)
from tests.pipeline.ingest.sources import Source, column


@pytest.mark.parametrize(
    ("payload", "value"),
    [
        (b'{"value": 1}', 1.0),
        (b'{"value":-1.5e-3}', -1.5e-3),
        (b' \n{ "value" :\t1.5\r\n} ', 1.5),
        (b'{"unit": "bar", "value": 2, "nested": {"value": [3, {"value": 4}]}}', 2.0),
        (b'{"val\\u0075e": 5}', 5.0),
        ('{"käse": "}{", "value": 6}'.encode(), 6.0),
        (b'{"text": "\\"value\\": 9", "value": 7}', 7.0),
        (b'{"value": 12345678901234567890123}', 12345678901234567890123.0),
        (b'{"value": 0.1234567890123456789}', 0.1234567890123456789),
        (b'{"value": NaN}', np.nan),
        (b'{"value": -Infinity}', -np.inf),
        (b'{"value": 1e999}', np.inf),
        (b'{"value": 1, "value": 2}', 2.0),
        (b'{"value": 1e-999}', 0.0),
        (b'{"other": [1, 2, {"a": null}], "value": 8}', 8.0),
    ],
)
def test_numbers_as_the_json_module_reads_them(
    tmp_path: Path, payload: bytes, value: float
) -> None:
    np.testing.assert_equal(float(json.loads(payload)["value"]), value)
    for beside in ([], [b"?"]):
        channel = pressure(tmp_path, [b'{"value": 0}', payload, *beside, b'{"value": 0}'])
        np.testing.assert_array_equal(channel.value[:2], [0.0, value])
        assert channel.missing[:2].tolist() == [False, False]
        assert channel.unparsed == len(beside)


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b" ",
        b"1",
        b"[1]",
        b'"value"',
        b"null",
        b'{"value": "1.5"}',
        b'{"value": true}',
        b'{"value": [1]}',
        b'{"value": {"value": 1}}',
        b'{"value": 1} {"value": 2}',
        b'{"value": 1}\n{"value": 2}',
        b'{"value": 1',
        b'{"value": 01}',
        b'{"value": +1}',
        b'{"value": 1,}',
        b"{'value': 1}",
        b'{"value": 1}\x00',
        b'{"value"',
        b": 1}",
        b"\xff\xfe",
        b"[" * 100_000,
        b'{"a":' * 50_000,
    ],
)
def test_what_holds_no_number_is_missing_and_counted(tmp_path: Path, payload: bytes) -> None:
    channel = pressure(tmp_path, [b'{"value": 1}', payload, b'{"value": 2}'])
    np.testing.assert_array_equal(channel.value, [1.0, np.nan, 2.0])
    assert channel.missing.tolist() == [False, True, False]
    assert channel.unparsed == 1


def test_halves_of_an_object_do_not_make_one_together(tmp_path: Path) -> None:
    for one, other in (
        (b'{"value":', b"1}"),
        (b'{"value": 2}{"value": 3}', b""),
        (b'{"value": 1}{"a": {}', b', "value": 2}'),
        (b'{"a":', b'{"b": 1}, "value": 2}{"value": 3}'),
        (b'{"value": 1} {"value"', b": 2}"),
        (b'{"a": "}', b'{", "value": 2}{"value": 3}'),
    ):
        channel = pressure(tmp_path, [one, other, b'{"value": 4}'])
        np.testing.assert_array_equal(channel.value, [np.nan, np.nan, 4.0])
        assert channel.unparsed == 2


def test_an_absent_field_is_missing_but_absent_throughout_it_is_an_error(tmp_path: Path) -> None:
    channel = pressure(tmp_path, [b"{}", b'{"value": null}', b'{"value": 1}', b'{"other": 2}'])
    assert channel.missing.tolist() == [True, True, False, True]
    assert channel.unparsed == 0
    assert pressure(tmp_path, [b"{}", b'{"value": null}']).missing.all()
    wrong = error_of(tmp_path, mcap_of([b'{"bar": 1, "t": 0}', b'{"bar": 2}']))
    assert wrong.code == "log_column_missing"
    assert "'value'" in wrong.message
    assert "'bar', 't'" in wrong.message


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
        ("oil", T0_NS + 4000, b'{"value": 51}'),
    ]
    log = read(tmp_path, mcap_bytes(sent), Source.of("mcap", channels))
    assert log.channels["pressure_difference"].value.tolist() == [200.0, 201.0]
    assert log.channels["speed"].value.tolist() == [30.0, 31.0]
    assert log.channels["oil_temperature"].value.tolist() == [50.0, 51.0]
    assert log.channels["oil_temperature"].time_us.tolist() == [T0_US + 1, T0_US + 4]
    assert [channel.unparsed for channel in log.channels.values()] == [0, 0, 0]
    assert log.rows == 4


def test_two_channels_of_one_topic_are_one(tmp_path: Path) -> None:
    other = message_record(2, T0_NS, b'{"value": 2}')
    log = read(tmp_path, file_of(DP, channel_record(2), ONE, other, ONE))
    assert log.channels["pressure_difference"].value.tolist() == [1.0, 2.0, 1.0]


def test_a_bad_message_among_many_pieces_costs_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipeline.ingest.mcap.log, "_PIECE", 2000)
    payloads = [b'{"value": %d.5}' % i for i in range(3000)]
    payloads[700] = b"?"
    data = mcap_of(payloads, chunk_size=500)
    channel = read(tmp_path, data).channels["pressure_difference"]
    assert np.flatnonzero(channel.missing).tolist() == [700]
    assert channel.unparsed == 1
    assert channel.value[701:].tolist() == [i + 0.5 for i in range(701, 3000)]


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
    path = tmp_path_factory.mktemp("any") / "log.mcap"
    path.write_bytes(mcap_of([b'{"value": 0}', *payloads], chunk_size=50))
    channel = read_log(path, *SOURCE).channels["pressure_difference"]
    wanted = [0.0, *(_by_json(payload) for payload in payloads)]
    for value, is_missing, by_json in zip(channel.value, channel.missing, wanted, strict=True):
        assert is_missing == (by_json is None)
        # The integer -0 has no sign to the `json` module.
        np.testing.assert_equal(float(value) + 0, np.nan if by_json is None else by_json + 0)


def _by_json(payload: bytes) -> float | None:
    try:
        value = json.loads(payload)["value"]
        return None if isinstance(value, bool | str | list | dict) else float(value)
    except (ValueError, TypeError, KeyError, IndexError):
        return None
