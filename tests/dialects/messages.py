"""MCAP of JSON, Protobuf and ROS 2 messages, by the format's own writer and encoders."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from mcap.writer import Writer
from mcap_ros2._dynamic import serialize_dynamic

from pipeline.units import CHANNELS
from tests.dialects.dialect import Dialect
from tests.dialects.recorded import Recorded
from tests.pipeline.ingest.mcap.protobuf_files import (
    NAME,
    Field,
    class_of,
    declared,
    field_of,
    set_of,
)

RECORDED_AFTER_NS = 1_700_000_000
"""Between a reading and its record, where the message or its publication holds the stamp."""
TOPIC = "/winch/drive"

Reading = Mapping[str, float]
"""By channel; nan where there is none."""
Schema = tuple[str, str, bytes]


@dataclass(frozen=True, slots=True)
class Json:
    """Null where there is no reading."""

    together: bool = False  # all channels are in one message; else each has its own topic
    name: str = "json"  # of the encoding in MCAP
    schema: Schema | None = None  # name, encoding and text
    stamp: str = "header.stamp"  # field of the stamp
    says_blank: bool = True  # a message may state that it has no reading

    def place(self, channel: str) -> tuple[str, str]:
        """Topic and field of a channel."""
        topic = TOPIC if self.together else f"{TOPIC}/{channel}"
        return topic, f"hydraulics.{channel}.readings[1]"

    def payload(self, time_us: int, reading: Reading) -> bytes:
        """Content of a message of the readings of one time."""
        parts = {
            name: {"unit": "as configured", "readings": [0, None if math.isnan(value) else value]}
            for name, value in reading.items()
        }
        stamp = seconds_and_nanoseconds(time_us)
        return json.dumps({"header": {"stamp": stamp}, "hydraulics": parts}).encode()


@dataclass(frozen=True, slots=True)
class Protobuf:
    """Not set where there is no reading."""

    together: bool = False
    single: bool = False
    name: str = "protobuf"
    stamp: str = "stamp"
    says_blank: bool = True

    @property
    def schema(self) -> Schema:
        return NAME, "protobuf", _descriptors(self.single).SerializeToString()

    def place(self, channel: str) -> tuple[str, str]:
        return TOPIC if self.together else f"{TOPIC}/{channel}", f"readings.{channel}"

    def payload(self, time_us: int, reading: Reading) -> bytes:
        known = {name: value for name, value in reading.items() if not math.isnan(value)}
        message = _drive(self.single)(readings=known)
        message.stamp.FromNanoseconds(time_us * 1000)
        return message.SerializeToString()


@dataclass(frozen=True, slots=True)
class Ros2:
    """A message has its value: that there is none, it cannot say."""

    single: bool = False
    name: str = "cdr"
    stamp: str = "header.stamp"
    together: bool = False
    says_blank: bool = False

    @property
    def schema(self) -> Schema:
        return ROS2_NAME, "ros2msg", ROS2.format(kind=self._kind).encode()

    @property
    def _kind(self) -> str:
        return "float32" if self.single else "float64"

    def place(self, channel: str) -> tuple[str, str]:
        return f"{TOPIC}/{channel}", "value"

    def payload(self, time_us: int, reading: Reading) -> bytes:
        (value,) = reading.values()
        header = {"stamp": seconds_and_nanoseconds(time_us), "frame_id": "drive"}
        return _ros2(self._kind)({"header": header, "unit": "as configured", "value": value})


@dataclass(frozen=True)
class Mcap(Dialect):
    """Messages."""

    encoding: Json | Protobuf | Ros2 = field(default_factory=Json)
    stamped: str = "log_time"  # where the stamp is: "log_time", "publish_time", or "message"
    options: Mapping[str, Any] = field(default_factory=dict)  # of `mcap.writer.Writer`

    format: ClassVar[str] = "mcap"

    def source(self, channel: str) -> dict[str, Any]:
        topic, within = self.encoding.place(channel)
        return {"source": topic, "field": within, "unit": self.unit(channel)}

    def section(self) -> dict[str, Any]:
        keys = {**super().section(), "time": self.stamped}
        if self.stamped == "message":
            keys |= {"time": "log_time", "stamp": self.encoding.stamp}
        return keys

    def write(self, folder: Path, stem: str, log: Recorded) -> list[Path]:
        path = folder / f"{stem}.mcap"
        with path.open("wb") as file:
            writer = Writer(file, **{"chunk_size": 200_000} | dict(self.options))
            writer.start()
            schema = writer.register_schema(*self.encoding.schema) if self.encoding.schema else 0
            channels = {
                topic: writer.register_channel(topic, self.encoding.name, schema)
                for topic in dict.fromkeys(self.encoding.place(name)[0] for name in log.values)
            }
            for topic, time_us, reading in self._readings(self.in_units(log)):
                log_ns = publish_ns = time_us * 1000
                if self.stamped != "log_time":
                    log_ns += RECORDED_AFTER_NS
                if self.stamped == "message":
                    publish_ns = log_ns
                payload = self.encoding.payload(time_us, reading)
                writer.add_message(channels[topic], log_ns, payload, publish_ns)
            writer.finish()
        return [path]

    def holds(self, log: Recorded) -> bool:
        blank = any(np.isnan(value).any() for value in log.values.values())
        return (
            super().holds(log)
            and not (self.encoding.together and log.own_time_us)
            and not (blank and not self.encoding.says_blank and not log.own_time_us)
        )

    def _readings(self, log: Recorded) -> Iterator[tuple[str, int, Reading]]:
        """Topic, stamp and content of each message."""
        names = list(log.values)
        topics = [self.encoding.place(name)[0] for name in names]
        if self.encoding.together:
            time_us, columns = log.rows()
            rows = zip(*(column.tolist() for column in columns.values()), strict=True)
            for time, row in zip(time_us.tolist(), rows, strict=True):
                yield topics[0], time, dict(zip(names, row, strict=True))
            return
        for time, number, value in zip(*(part.tolist() for part in log.samples()), strict=True):
            yield topics[number], time, {names[number]: value}


def seconds_and_nanoseconds(time_us: int) -> dict[str, int]:
    """A stamp as ROS has it."""
    return {"sec": time_us // 1_000_000, "nanosec": time_us % 1_000_000 * 1000}


@cache
def _descriptors(single: bool) -> Any:
    """A message of a stamp and of readings, each of which may be absent."""
    kind = Field.TYPE_FLOAT if single else Field.TYPE_DOUBLE
    parts = {"stamp": ".google.protobuf.Timestamp", "readings": ".motor.Readings"}
    root = [field_of(name, Field.TYPE_MESSAGE, of) for name, of in parts.items()]
    readings = [field_of(channel, kind, role="optional") for channel in CHANNELS]
    kinds = {NAME.partition(".")[2]: root, "Readings": readings}
    return set_of("proto3", *(declared(*one, "proto3") for one in kinds.items()))


@cache
def _drive(single: bool) -> Any:
    return class_of(_descriptors(single))


ROS2_NAME = "motor_msgs/msg/Reading"
ROS2 = """\
std_msgs/Header header
string unit
{kind} value
===
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
===
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


@cache
def _ros2(kind: str) -> Any:
    return serialize_dynamic(ROS2_NAME, ROS2.format(kind=kind))[ROS2_NAME]
