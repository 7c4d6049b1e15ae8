"""MCAP logs: messages a second, ours beside the format's own reader, and the memory of a long day.

The speed is that of one process on a file of JSON messages, three topics of one reading each, read
in turn: by ours, and by the format's own reader in the order of the file with `polars.read_ndjson`
over all payloads. The same for ROS 2 and Protobuf messages, which the format's own decoders take
one by one. The memory is that of a process that does nothing but read a day of messages of four
readings at 100 Hz.
"""

from __future__ import annotations

import io
import json
import math
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.decoder import DecoderFactory
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory as ProtobufDecoderFactory
from mcap_protobuf.writer import Writer as ProtobufWriter
from mcap_ros2.decoder import DecoderFactory as Ros2DecoderFactory

from benchmarks.results_file import write_results
from pipeline.ingest import ChannelSource, LogSource, read_log

T0_NS = 1_740_808_800_000_000_000
MESSAGES = 300_000
ROUNDS = 5
DAY_MESSAGES = 24 * 3600 * 100
ROS2 = b"""std_msgs/Header header
float64 pressure
float64 speed
===
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
===
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
TOPICS = {"dp": "pressure_difference", "q": "leakage_flow", "n": "speed"}
UNITS = {"pressure_difference": "bar", "leakage_flow": "l/min", "speed": "rpm"}
UNITS |= {"oil_temperature": "degC"}
JSON_SOURCE = LogSource(
    "mcap", tuple(ChannelSource(name, topic, UNITS[name]) for topic, name in TOPICS.items())
)
DAY_SOURCE = LogSource(
    "mcap",
    tuple(ChannelSource(name, "motor", unit, field=name) for name, unit in UNITS.items()),
)

Reader = Callable[[Path], float]
"""Reads a file and gives the sum of a channel's readings."""


def main() -> None:
    """Measure and write `benchmarks/results/mcap_reading.md`."""
    with tempfile.TemporaryDirectory() as folder:
        files = {
            "JSON": Path(folder) / "json.mcap",
            "ROS 2 (CDR)": Path(folder) / "ros2.mcap",
            "Protobuf": Path(folder) / "protobuf.mcap",
        }
        write_json(files["JSON"], MESSAGES)
        write_ros2(files["ROS 2 (CDR)"], MESSAGES)
        write_protobuf(files["Protobuf"], MESSAGES)
        rows = [_speed("JSON", files["JSON"], ours_json, officially_json)]
        for name, factory, field in (
            ("ROS 2 (CDR)", Ros2DecoderFactory, "pressure"),
            ("Protobuf", ProtobufDecoderFactory, "seconds"),
        ):
            rows.append(_speed(name, files[name], _ours(field), _officially(factory, field)))
        day = Path(folder) / "day.mcap"
        write_day(day)
        rows += _memory(day)
    header = ("what", "ours", "the format's own reader", "ratio")
    write_results("mcap_reading", "MCAP: messages a second, and memory", header, rows)


def _speed(name: str, path: Path, ours: Reader, officially: Reader) -> list[str]:
    """Medians of rounds in which both are run, one after the other."""
    seconds: dict[Reader, list[float]] = {ours: [], officially: []}
    for _ in range(ROUNDS):
        sums = []
        for reader, taken in seconds.items():
            start = time.perf_counter()
            sums.append(reader(path))
            taken.append(time.perf_counter() - start)
        if not math.isclose(*sums):
            raise ArithmeticError(f"{name}: the readers differ, {sums}")
    ours_s, officially_s = (statistics.median(taken) for taken in seconds.values())
    rates = [f"{MESSAGES / taken:,.0f}/s" for taken in (ours_s, officially_s)]
    return [f"{name}, {MESSAGES} messages", *rates, f"{officially_s / ours_s:.1f}"]


def ours_json(path: Path) -> float:
    """Three topics."""
    return float(read_log(path, JSON_SOURCE).channels["speed"].value.sum())


def officially_json(path: Path) -> float:
    """All payloads in the order of the file, parsed as one text."""
    topics: list[str] = []
    times: list[int] = []
    lines: list[bytes] = []
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            topics.append(channel.topic)
            times.append(message.log_time)
            lines.append(message.data)
    frame = pl.read_ndjson(io.BytesIO(b"\n".join(lines)), schema={"value": pl.Float64})
    frame = frame.with_columns(topic=pl.Series(topics), time=pl.Series(times))
    return float(frame.filter(pl.col("topic") == "n")["value"].sum())


def _ours(field: str) -> Reader:
    source = LogSource("mcap", (ChannelSource("speed", "motor", "rpm", field=field),))
    return lambda path: float(read_log(path, source).channels["speed"].value.sum())


def _officially(factory: type[DecoderFactory], field: str) -> Reader:
    def read(path: Path) -> float:
        with path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[factory()])
            decoded = reader.iter_decoded_messages(log_time_order=False)
            return float(np.sum([getattr(message, field) for *_, message in decoded]))

    return read


def _memory(path: Path) -> list[list[str]]:
    """Peak of a process that reads a day, less that of one that only imports."""
    idle, whole = (
        int(subprocess.check_output([sys.executable, "-m", __name__, *what]))
        for what in ([], [str(path)])
    )
    arrays = DAY_MESSAGES * (8 + len(UNITS) * 9)
    peak = [f"peak of a process that reads 24 h at 100 Hz, {path.stat().st_size / 1e6:.0f} MB"]
    return [
        [f"{peak[0]} of JSON", f"{whole / 2**20:.0f} MiB", "", ""],
        ["of this before it reads", f"{idle / 2**20:.0f} MiB", "", ""],
        ["of this the arrays that it gives", f"{arrays / 2**20:.0f} MiB", "", ""],
    ]


def write_json(path: Path, count: int) -> None:
    """Three topics of one reading each."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        ids = [writer.register_channel(topic, "json", 0) for topic in TOPICS]
        for i, value in enumerate(_values(count)):
            payload = json.dumps({"sensor": i % 3, "unit": "bar", "value": value}).encode()
            writer.add_message(ids[i % 3], T0_NS + i * 3_333_333, payload, T0_NS)
        writer.finish()


def write_day(path: Path) -> None:
    """A day of messages of four readings each at 100 Hz."""
    line = '{"pressure_difference": %.4f, "oil_temperature": %.1f, "speed": %.3f, '
    line += '"leakage_flow": %.5f}'
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        number = writer.register_channel("motor", "json", 0)
        for i, value in enumerate(_values(DAY_MESSAGES)):
            payload = (line % (value, value / 4, value / 7, value / 150)).encode()
            time_ns = T0_NS + i * 10_000_000
            writer.add_message(number, time_ns, payload, time_ns)
        writer.finish()


def write_ros2(path: Path, count: int) -> None:
    """Messages with a header, whose text comes before the readings."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("motor_msgs/msg/Motor", "ros2msg", ROS2)
        number = writer.register_channel("motor", "cdr", schema)
        for i, value in enumerate(_values(count)):
            head = struct.pack("<4siII6s6x", b"\0\1\0\0", i, 0, 6, b"motor\0")
            payload = head + struct.pack("<dd", value, -value)
            writer.add_message(number, T0_NS + i, payload, T0_NS)
        writer.finish()


def write_protobuf(path: Path, count: int) -> None:
    """Messages of two numbers."""
    with path.open("wb") as file, ProtobufWriter(file) as writer:
        for i in range(count):
            message: Any = Timestamp(seconds=1_740_808_800 + i, nanos=i)
            writer.write_message("motor", message, T0_NS + i, T0_NS)


def _values(count: int) -> Iterator[float]:
    rng = np.random.default_rng(1)
    for start in range(0, count, 100_000):
        yield from (200 + 30 * rng.standard_normal(min(100_000, count - start))).tolist()


def _read_day(paths: list[str]) -> None:
    for path in paths:
        read_log(Path(path), DAY_SOURCE)
    # Not getrusage, whose peak holds that of the process that started this one.
    status = Path("/proc/self/status").read_text("utf-8")
    peak_kib = next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM"))
    sys.stdout.write(f"{int(peak_kib) * 1024}\n")


if __name__ == "__main__":
    _read_day(sys.argv[1:])
