"""`init` of MCAP: what it proposes reads the log."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from mcap_ros2._dynamic import serialize_dynamic

from pipeline.ingest.conformance import T0_US
from pipeline.setup.propose import ProposedMotor, propose
from tests.pipeline.ingest.mcap_files import JSON, mcap_bytes
from tests.pipeline.setup.proposed import log_in, proposed, read_as_proposed

COUNT = 40
VALUES = {
    "pressure_difference": 180.0 + np.arange(COUNT),
    "oil_temperature": 50.0 + 0.25 * np.arange(COUNT),
    "speed": 20.0 + 0.5 * np.arange(COUNT),
    "leakage_flow": 1.0 + 0.125 * np.arange(COUNT),
}
TIMES_US = T0_US + 200_000 * np.arange(COUNT)
LATE_US = 3_000  # between a sample and its record


def json_log(folder: Path, topics: Mapping[str, Callable[[int], Any]]) -> Path:
    """A log of JSON messages, made by topic of a sample's number."""
    messages = [
        (topic, 1000 * (time_us + LATE_US), json.dumps(make(i)).encode())
        for i, time_us in enumerate(TIMES_US.tolist())
        for topic, make in topics.items()
    ]
    return log_in(folder, mcap_bytes(messages, JSON, chunk_size=2000), "log.mcap")


UNITS = {"pressure_difference": "bar", "leakage_flow": "l/min"}


def require_it_reads(path: Path, late_us: int) -> ProposedMotor:
    (motor,) = proposed(path, UNITS).motors
    (log,) = read_as_proposed(motor, path.parent)
    assert set(log.channels) == set(VALUES)
    for channel, values in VALUES.items():
        np.testing.assert_array_equal(log.channels[channel].time_us, TIMES_US + late_us)
        np.testing.assert_allclose(log.channels[channel].value, values, rtol=1e-6)
    return motor


def test_a_topic_a_channel(tmp_path: Path) -> None:
    names = {channel: f"/mill/m1/{channel}" for channel in VALUES}
    names["leakage_flow"] = "/mill/m1/drain_flow"
    topics = {
        topic: lambda i, channel=channel: {"value": VALUES[channel][i], "quality": 192}
        for channel, topic in names.items()
    }
    topics["/mill/m1/operator"] = lambda i: {"name": "me", "shift": i % 3}
    motor = require_it_reads(json_log(tmp_path, topics), LATE_US)
    assert {name: one.keys["source"] for name, one in motor.channels.items()} == names
    assert motor.logs["time"] == "log_time"


def test_one_topic_with_fields_within_fields_units_and_a_stamp(tmp_path: Path) -> None:
    def message(i: int) -> dict[str, Any]:
        return {
            "stamp": {"sec": int(TIMES_US[i]) // 10**6, "nanosec": int(TIMES_US[i]) % 10**6 * 1000},
            "hydraulics": {
                "pressure.diff": {"value": VALUES["pressure_difference"][i] * 100, "unit": "kPa"},
            },
            "readings": [{"drain_flow_lpm": VALUES["leakage_flow"][i], "ok": True}],
            "shaft": {"rpm": VALUES["speed"][i]},
            "temps": {"oil_degC": VALUES["oil_temperature"][i], "ambient_degC": 20.0},
        }

    motor = require_it_reads(json_log(tmp_path, {"/drive": message}), 0)
    assert motor.logs["stamp"] == "stamp"
    channels = {name: channel.keys for name, channel in motor.channels.items()}
    assert channels["pressure_difference"]["field"] == r"hydraulics.pressure\.diff.value"
    assert channels["pressure_difference"]["unit"] == "kPa"
    assert channels["leakage_flow"]["field"] == "readings[0].drain_flow_lpm"


@pytest.mark.parametrize(
    ("stamp", "form"),
    [
        (lambda us: us // 1000, "epoch_ms"),
        (lambda us: us / 1e6, "epoch_s"),
        (lambda us: f"{np.datetime64(us, 'us')}Z", "iso8601"),
    ],
)
def test_stamps_that_are_a_number_or_text(
    tmp_path: Path, stamp: Callable[[int], Any], form: str
) -> None:
    topics = {
        f"/{channel}": lambda i, values=values: {"t": stamp(int(TIMES_US[i])), "v": values[i]}
        for channel, values in VALUES.items()
    }
    found = require_it_reads(json_log(tmp_path, topics), 0).logs
    assert (found["stamp"], found["time_format"]) == ("t", form)


# ROS 2 and Protobuf

STAMPED = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
STANDARD = {
    "sensor_msgs/msg/FluidPressure": "std_msgs/Header header\nfloat64 fluid_pressure\n"
    "float64 variance\n",
    "sensor_msgs/msg/Temperature": "std_msgs/Header header\nfloat64 temperature\n"
    "float64 variance\n",
    "motor_msgs/msg/Shaft": "std_msgs/Header header\nfloat32[2] speeds\n",
    "motor_msgs/msg/Drain": "std_msgs/Header header\nfloat64 flow_m3_h\nstring note\n",
}


def test_ros_2_with_the_units_of_its_standard_messages(tmp_path: Path) -> None:
    encode = {
        name: serialize_dynamic(name, text + STAMPED)[name] for name, text in STANDARD.items()
    }
    topics = {
        "/dp": ("sensor_msgs/msg/FluidPressure", "pressure_difference", "fluid_pressure", 1e5),
        "/oil": ("sensor_msgs/msg/Temperature", "oil_temperature", "temperature", 1.0),
        "/shaft": ("motor_msgs/msg/Shaft", "speed", "speeds", 1.0),
        "/drain": ("motor_msgs/msg/Drain", "leakage_flow", "flow_m3_h", 0.06),
    }
    buffer = io.BytesIO()
    writer = Writer(buffer)
    writer.start()
    ids = {}
    for topic, (name, *_) in topics.items():
        schema = writer.register_schema(name, "ros2msg", (STANDARD[name] + STAMPED).encode())
        ids[topic] = writer.register_channel(topic, "cdr", schema)
    for i, time_us in enumerate(TIMES_US.tolist()):
        stamp = {"sec": time_us // 10**6, "nanosec": time_us % 10**6 * 1000}
        for topic, (name, channel, field, factor) in topics.items():
            value: Any = VALUES[channel][i] * factor
            content = {"header": {"stamp": stamp, "frame_id": "x"}, "note": "", "variance": 0.5}
            content[field] = [value, -1.0] if field == "speeds" else value
            writer.add_message(ids[topic], 1000 * time_us + 7000, encode[name](content), 0)
    writer.finish()
    motor = require_it_reads(log_in(tmp_path, buffer.getvalue(), "log.mcap"), 0)
    assert motor.logs["stamp"] == "header.stamp"
    units = {name: one.unit for name, one in motor.channels.items()}
    assert (units["pressure_difference"], units["oil_temperature"]) == ("Pa", "degC")


def test_what_is_no_motors(tmp_path: Path) -> None:
    schema = ("Thing", "flatbuffer", b"?")
    data = mcap_bytes([("/x", T0_US, b"abc")], schema, "flatbuffer")
    path = log_in(tmp_path, data, "log.mcap")
    assert propose(path, {}).faults[0].startswith("no_motor: log.mcap")
    fields = {"variance": 0.5, "sensor_id": 7, "x": 1.0}
    path = json_log(tmp_path, {"/drain_flow": lambda i: {"seq": i, **fields}})
    assert not propose(path, {}).motors
