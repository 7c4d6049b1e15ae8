"""MCAP logs: messages a second, ours beside the format's own reader, and the memory of a long day.

The speed is that of one process on a file of JSON messages, three topics of one reading each, read
in turn: by ours, and by the format's own reader in the order of the file with `polars.read_ndjson`
over all payloads. The same for ROS 2 and Protobuf messages, which the format's own decoders take
one by one. The two are run in turn, and both the wall clock and the time of all processors are
taken, which other work on the machine changes less. The memory is that of a process that does
nothing but read a day at 100 Hz: messages of four readings, of all eight that there can be, and
four topics of one reading, each with its own time stamps.
"""

from __future__ import annotations

import io
import json
import math
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
from pipeline.config.motors import Channel, Channels, Logs
from pipeline.ingest import read_log
from pipeline.units import CHANNELS, canonical_unit

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
LOGS = Logs(format="mcap", files=("*.mcap",))
JSON_CHANNELS: Channels = {
    "pressure_difference": Channel(source="dp", unit="bar"),
    "leakage_flow": Channel(source="q", unit="l/min"),
    "speed": Channel(source="n", unit="rpm"),
}
DAYS = {
    "a topic of 4 readings": (1, 4),
    "a topic of 8 readings": (1, 8),
    "4 topics of one reading": (4, 1),
}
"""Topics, and readings of each message."""

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
        for name, (topics, readings) in DAYS.items():
            day = Path(folder) / "day.mcap"
            write_day(day, topics, readings)
            rows += _memory(name, day, topics, readings)
    header = ("what", "ours", "the format's own reader", "ratio", "ratio of processor time")
    write_results("mcap_reading", "MCAP: messages a second, and memory", header, rows)


def _speed(name: str, path: Path, ours: Reader, officially: Reader) -> list[str]:
    """Medians of rounds in which both are run, one after the other."""
    seconds: dict[Reader, list[tuple[float, float]]] = {ours: [], officially: []}
    for _ in range(ROUNDS):
        sums = []
        for reader, taken in seconds.items():
            start = time.perf_counter(), time.process_time()
            sums.append(reader(path))
            taken.append((time.perf_counter() - start[0], time.process_time() - start[1]))
        if not math.isclose(*sums):
            raise ArithmeticError(f"{name}: the readers differ, {sums}")
    medians = np.median(list(seconds.values()), axis=1)
    rates = [f"{MESSAGES / wall:,.0f}/s" for wall, _ in medians]
    ratios = [f"{ratio:.1f}" for ratio in medians[1] / medians[0]]
    return [f"{name}, {MESSAGES} messages", *rates, *ratios]


def ours_json(path: Path) -> float:
    """Three topics."""
    return float(read_log(path, LOGS, JSON_CHANNELS).channels["speed"].value.sum())


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
    channels: Channels = {"speed": Channel(source="motor", unit="rpm", field=field)}
    return lambda path: float(read_log(path, LOGS, channels).channels["speed"].value.sum())


def _officially(factory: type[DecoderFactory], field: str) -> Reader:
    def read(path: Path) -> float:
        with path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[factory()])
            decoded = reader.iter_decoded_messages(log_time_order=False)
            return float(np.sum([getattr(message, field) for *_, message in decoded]))

    return read


def _memory(name: str, path: Path, topics: int, readings: int) -> list[list[str]]:
    """Peak of a process that reads a day, less that of one that only imports."""
    command = [sys.executable, "-m", __name__]
    shape = [str(path), str(topics), str(readings)]
    idle, whole = (int(subprocess.check_output([*command, *what])) for what in ([], shape))
    arrays = DAY_MESSAGES * topics * (8 + readings * 8)
    peak = (
        f"peak of a process that reads 24 h at 100 Hz, {name}, {path.stat().st_size / 1e6:.0f} MB"
    )
    return [
        [f"{peak} of JSON", f"{whole / 2**20:.0f} MiB", "", "", ""],
        ["of this before it reads", f"{idle / 2**20:.0f} MiB", "", "", ""],
        ["of this the arrays that it gives", f"{arrays / 2**20:.0f} MiB", "", "", ""],
    ]


def write_json(path: Path, count: int) -> None:
    """Three topics of one reading each."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        ids = [
            writer.register_channel(channel.source, "json", 0) for channel in JSON_CHANNELS.values()
        ]
        for i, value in enumerate(_values(count)):
            payload = json.dumps({"sensor": i % 3, "unit": "bar", "value": value}).encode()
            writer.add_message(ids[i % 3], T0_NS + i * 3_333_333, payload, T0_NS)
        writer.finish()


def write_day(path: Path, topics: int, readings: int) -> None:
    """A day at 100 Hz; all topics are logged one after the other, a microsecond apart."""
    line = "{" + ", ".join(f'"{name}": %.4f' for name in CHANNELS[:readings]) + "}"
    values = np.fromiter(_values(100_000 * readings), float).reshape(-1, readings).tolist()
    payloads = [(line % tuple(row)).encode() for row in values]
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        numbers = [writer.register_channel(f"motor {i}", "json", 0) for i in range(topics)]
        for i in range(DAY_MESSAGES):
            time_ns = T0_NS + i * 10_000_000
            for k, number in enumerate(numbers):
                payload = payloads[(i + 777 * k) % len(payloads)]
                writer.add_message(number, time_ns + 1000 * k, payload, time_ns)
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


def _read_day(path: str, topics: str, readings: str) -> None:
    fields = CHANNELS[: int(readings)]
    names = CHANNELS[: int(readings) * int(topics)]
    channels: Any = {
        name: Channel(
            source=f"motor {i // len(fields)}",
            unit=canonical_unit(name),
            field=fields[i % len(fields)],
        )
        for i, name in enumerate(names)
    }
    read_log(Path(path), LOGS, channels)


def _print_peak() -> None:
    # Not getrusage, whose peak holds that of the process that started this one.
    status = Path("/proc/self/status").read_text("utf-8")
    peak_kib = next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM"))
    sys.stdout.write(f"{int(peak_kib) * 1024}\n")


if __name__ == "__main__":
    if sys.argv[1:]:
        _read_day(*sys.argv[1:])
    _print_peak()
