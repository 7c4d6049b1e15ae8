"""MCAP files of one topic, and what the format's own decoders read of them."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from mcap.decoder import DecoderFactory
from mcap.reader import make_reader
from mcap.records import Schema
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory as ProtobufDecoderFactory
from mcap_ros2.decoder import DecoderFactory as Ros2DecoderFactory

from pipeline.config.field_paths import field_path
from pipeline.errors import LogError
from pipeline.ingest import RawLog, read_log
from pipeline.ingest.conformance import T0_US
from pipeline.units import CHANNELS, canonical_unit

from .sources import Source, column

T0_NS = T0_US * 1000
TOPIC = "/hydraulics"
JSON = ("V", "jsonschema", b"{}")

Value = float | None
"""A reading; None where missing."""


class JsonDecoderFactory(DecoderFactory):
    """JSON by the standard library: the format's own packages have no decoder for it."""

    def decoder_for(
        self,
        message_encoding: str,
        schema: Schema | None,  # noqa: ARG002
    ) -> Callable[[bytes], Any] | None:
        """The decoder of a channel's messages."""
        return json.loads if message_encoding == "json" else None


FACTORIES = (ProtobufDecoderFactory, Ros2DecoderFactory, JsonDecoderFactory)


def mcap_of(
    payloads: Sequence[bytes], schema: tuple[str, str, bytes], encoding: str, **options: Any
) -> bytes:
    """A file of one topic, a message a millisecond."""
    buffer = io.BytesIO()
    writer = Writer(buffer, **{"chunk_size": 3000} | options)
    writer.start()
    number = writer.register_channel(TOPIC, encoding, writer.register_schema(*schema))
    for i, payload in enumerate(payloads):
        writer.add_message(number, T0_NS + i * 1_000_000, payload, T0_NS)
    writer.finish()
    return buffer.getvalue()


def source_of(*fields: str, topic: str = TOPIC, **options: Any) -> Source:
    """A source of up to eight fields of a topic."""
    channels = {
        name: column(topic, canonical_unit(name), field=field)
        for name, field in zip(CHANNELS, fields, strict=False)
    }
    return Source.of("mcap", channels, **options)


def read(folder: Path, data: bytes, source: Source) -> RawLog:
    """Log as read from a file with these bytes."""
    path = folder / "log.mcap"
    path.write_bytes(data)
    return read_log(path, *source)


def all_values(path: Path, fields: Sequence[str], topic: str = TOPIC) -> dict[str, list[Value]]:
    """Readings of any number of fields, in as many reads as they take."""
    found: dict[str, list[Value]] = {}
    for start in range(0, len(fields), len(CHANNELS)):
        some = fields[start : start + len(CHANNELS)]
        channels = read_log(path, *source_of(*some, topic=topic)).channels
        for field, channel in zip(some, channels.values(), strict=True):
            pairs = zip(channel.value.tolist(), channel.missing.tolist(), strict=True)
            found[field] = [None if missing else value for value, missing in pairs]
    return found


def values(folder: Path, data: bytes, field: str) -> list[Value]:
    """Readings of one field."""
    path = folder / "log.mcap"
    path.write_bytes(data)
    return all_values(path, [field])[field]


def error_of(folder: Path, data: bytes, field: str) -> LogError:
    """The error that reading a field ends in."""
    with pytest.raises(LogError) as raised:
        read(folder, data, source_of(field))
    return raised.value


def official_messages(path: Path, topic: str = TOPIC) -> list[Any]:
    """Messages of a topic as the format's own reader decodes them, in the order of the file."""
    with path.open("rb") as file:
        factories = [factory() for factory in FACTORIES]
        reader = make_reader(file, validate_crcs=True, decoder_factories=factories)
        decoded = reader.iter_decoded_messages([topic], log_time_order=False)
        return [message for *_, message in decoded]


def officially(path: Path, field: str, topic: str = TOPIC) -> list[Value]:
    """Readings of a field as the format's own reader gives them; None beyond an array's end."""
    return [followed(message, field) for message in official_messages(path, topic)]


def followed(message: Any, field: str) -> Value:
    """Value at a path in a decoded message."""
    for step in field_path(field):
        if isinstance(step, int):
            if step >= len(message):
                return None
            message = message[step]
        else:
            message = message[step] if isinstance(message, dict) else getattr(message, step)
    return float(message)
