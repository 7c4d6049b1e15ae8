"""Payloads of ROS 2 messages as the format's own writer makes them, and files of them."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from unittest.mock import patch

import mcap_ros2._dynamic
from mcap_ros2._cdr import CdrWriter, EncapsulationKind
from mcap_ros2._dynamic import serialize_dynamic

from tests.pipeline.ingest.mcap_files import error_of, mcap_of

NAME = "motor_msgs/msg/Hydraulics"


def encoded(
    definition: str, messages: Sequence[Any], kind: EncapsulationKind = EncapsulationKind.CDR_LE
) -> list[bytes]:
    """Payloads as the format's own writer makes them, in either byte order."""
    in_order = functools.partial(CdrWriter, kind=kind)
    encode = serialize_dynamic(NAME, definition)[NAME]
    with patch.object(mcap_ros2._dynamic, "CdrWriter", in_order):
        return [encode(one) for one in messages]


def ros2(definition: str, messages: Sequence[Any], **options: Any) -> bytes:
    return ros2_of(definition, encoded(definition, messages), **options)


def ros2_of(
    definition: str, payloads: Sequence[bytes], language: str = "ros2msg", **options: Any
) -> bytes:
    return mcap_of(payloads, (NAME, language, definition.encode()), "cdr", **options)


def code(folder: Path, data: bytes, field: str) -> str:
    return error_of(folder, data, field).code
