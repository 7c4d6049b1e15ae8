"""Messages of ROS 2 in CDR, the encoding of DDS."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.config.field_paths import FieldPath
from pipeline.errors import LogError
from pipeline.ingest.assembly import Readings
from pipeline.ingest.mcap.cdr_walk import HEAD, ORDERS, Found, TooManySteps, walked
from pipeline.ingest.mcap.fields import wanted_kinds
from pipeline.ingest.mcap.layout import Schema
from pipeline.ingest.mcap.payloads import Decoded, Decoder, Payloads, stamps_of_parts
from pipeline.ingest.mcap.ros2_types import Message, Ros2Place
from pipeline.ingest.mcap.ros2idl import ros2idl_definitions
from pipeline.ingest.mcap.ros2msg import ros2msg_definitions

ROS2_LANGUAGES = {"ros2msg": ros2msg_definitions, "ros2idl": ros2idl_definitions}
"""Readers of definitions by the schema's encoding."""

_OTHER_REPRESENTATIONS = {
    **dict.fromkeys((0x02, 0x03, 0x12, 0x13), "PL_CDR"),
    0x04: "XML",
    **dict.fromkeys((0x06, 0x07, 0x10, 0x11), "CDR2"),
    **dict.fromkeys((0x08, 0x09, 0x14, 0x15), "D_CDR2"),
    **dict.fromkeys((0x0A, 0x0B), "PL_CDR2"),
}
"""Representation identifiers of DDSI-RTPS 2.5, 10.2, and of DDS-XTypes 1.3, 7.6.3.1.2, that are not
read; the two disagree on those of XCDR version 2."""


def cdr_decoder(
    path: Path,
    topic: str,
    schema: Schema,
    fields: Sequence[FieldPath],
    stamp: FieldPath | None,
    time_format: str,
) -> Decoder:
    """Decoder of the messages of a schema in one of `ROS2_LANGUAGES`.

    Raises
    ------
    LogError
        As `ros2_root` and `wanted_kinds`. The decoder raises ``log_encoding`` where all messages
        are in another representation of DDS, and ``log_too_large`` where they have no end of
        fields.
    """
    root = ros2_root(path, topic, schema)
    kinds, parts = wanted_kinds(path, topic, root, fields, stamp)

    def decode(payloads: Payloads) -> Decoded:
        identifier = _identifiers(payloads)
        _require_plain(path, topic, identifier)
        try:
            found = walked(payloads, identifier, root.definitions, kinds)
        except TooManySteps as error:
            raise LogError(
                "log_too_large",
                path,
                f"messages of topic {topic!r} have more fields, one in another, than are read",
                topic,
            ) from error
        readings = {one: _readings(found, one) for one in fields}
        stamps = [(found.values[one], found.there[one] & found.sound) for one in parts]
        return Decoded(readings, stamps_of_parts(stamps, time_format) if stamps else None)

    return decode


def ros2_root(path: Path, topic: str, schema: Schema) -> Ros2Place:
    """A message, as its schema lays it out.

    Raises
    ------
    LogError
        ``log_encoding`` for a type that is not read, ``log_damaged`` for a definition that is none.
    """
    try:
        definitions = ROS2_LANGUAGES[schema.encoding](schema)
        return Ros2Place(definitions, Message(definitions.root))
    except NotImplementedError as error:
        raise LogError(
            "log_encoding", path, f"messages of topic {topic!r} have {error}", topic
        ) from error
    except (ValueError, LookupError, RecursionError) as error:
        raise LogError(
            "log_damaged", path, f"the definition of {schema.name} cannot be read: {error}"
        ) from error


def _identifiers(payloads: Payloads) -> NDArray[np.int64]:
    """Representation that each message says it is in; -1 where it is too short to."""
    head = payloads.start
    text = payloads.text
    long_enough = payloads.length >= HEAD
    first, second = (text[np.where(long_enough, head + i, 0)].astype(np.int64) for i in (0, 1))
    return np.where(long_enough, first * 256 + second, -1)


def _require_plain(path: Path, topic: str, identifier: NDArray[np.int64]) -> None:
    there = set(np.unique(identifier).tolist())
    others = {_OTHER_REPRESENTATIONS[one] for one in there & _OTHER_REPRESENTATIONS.keys()}
    if others and not there & ORDERS.keys():
        raise LogError(
            "log_encoding",
            path,
            f"messages of topic {topic!r} are in {' or '.join(sorted(others))}, a representation "
            "of DDS that is not read; read is plain CDR of version 1, as ROS 2 writes it",
            topic,
        )


def _readings(found: Found, path: FieldPath) -> Readings:
    there = found.there[path] & found.sound
    raw = np.where(there, found.values[path].astype(np.float64), np.nan)
    example = None if found.sound.all() else "a message that is cut or not in CDR"
    return Readings(raw, ~there, ~found.sound, example)
