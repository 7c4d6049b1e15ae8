"""What is in an MCAP log: topics and their fields as columns, and the time of its messages."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.config.field_paths import FieldPath, path_text
from pipeline.ingest.mcap.decoding import NANOSECONDS, SECONDS
from pipeline.ingest.mcap.topics import Topic, read_topics
from pipeline.setup.cells import TimeFormats, count_format, is_stamp, is_time_name, time_formats
from pipeline.setup.names import is_in, unit_named, words_of
from pipeline.setup.tables import Column, Question, Table, set_formats

# Fields beside a reading that are none.
_NO_READINGS = {
    *("seq", "sequence", "sec", "secs", "nanosec", "nsec", "nsecs", "nanos", "seconds"),
    *("nanoseconds", "variance", "covariance", "id", "status", "quality", "index", "stamp"),
}
# Units that messages of ROS 2's sensor_msgs are in by their definition.
_STANDARD_UNITS = {("FluidPressure", "fluid_pressure"): "Pa", ("Temperature", "temperature"): "°C"}


def sniff_mcap(path: Path) -> Table:
    topics = read_topics(path)
    columns = [one for topic in topics for one in _fields(topic, is_lone=len(topics) == 1)]
    logs: dict[str, Any] = {"format": "mcap", "time": "log_time"}
    questions: list[Question] = []
    of_readings = [one for one in topics if any(c.keys["source"] == one.name for c in columns)]
    stamp, formats = _stamp(of_readings)
    if stamp:
        logs["stamp"] = stamp
        if formats is not None:
            set_formats(logs, questions, formats)
    else:
        questions += _time_of_messages(of_readings)
    return Table(logs, tuple(questions), tuple(columns), ())


def _fields(topic: Topic, *, is_lone: bool) -> Iterator[Column]:
    stamps = {path[:-1] for path in _stamp_paths(topic)}
    paths = [
        path
        for path, numbers in topic.fields.items()
        if path[:-1] not in stamps and _key(path).lower() not in _NO_READINGS and _finite(numbers)
        if not (is_time_name(_key(path)) and count_format(_finite(numbers)))
    ]
    for path in paths:
        text = path_text(path)
        # A field that is called nothing of its own is its topic's reading.
        is_value = is_in(words_of(_key(path)), "column", "value")
        whole = text if is_lone and len(paths) > 1 else f"{topic.name}.{text}"
        name = topic.name if is_value and len(path) == 1 else whole
        texts = topic.texts.items()
        beside = [
            said for at, said in texts if at[:-1] == path[:-1] and at[-1] in ("unit", "units")
        ]
        kind = topic.schema.split("/")[-1].split(".")[-1]
        unit = _STANDARD_UNITS.get((kind, text)) or next(iter(beside), "")
        cells = tuple(f"{number:.6g}" for number in _finite(topic.fields[path]))
        keys = {"source": topic.name} | ({"field": text} if text != "value" else {})
        yield Column(name, cells, "number", unit or (text if unit_named(text) else ""), keys)


def _key(path: FieldPath) -> str:
    return next(step for step in reversed(path) if isinstance(step, str))


def _finite(numbers: Sequence[float]) -> list[float]:
    return [number for number in numbers if np.isfinite(number)]


def _stamp_paths(topic: Topic) -> list[FieldPath]:
    """Paths of the seconds of stamps that have nanoseconds beside them."""
    return [
        path
        for path in topic.fields
        if path[-1] in SECONDS and any((*path[:-1], name) in topic.fields for name in NANOSECONDS)
    ]


def _stamp(topics: Sequence[Topic]) -> tuple[str, TimeFormats | None]:
    """Path of a stamp that all messages have, and how it is written; None: as a pair of numbers."""
    found = [_stamps_of(topic) for topic in topics]
    for path, formats in found[0].items() if found else ():
        if all(one.get(path, TimeFormats({"": ""})) == formats for one in found):
            return path_text(path), formats
    return "", None


def _stamps_of(topic: Topic) -> dict[FieldPath, TimeFormats | None]:
    found: dict[FieldPath, TimeFormats | None] = {}
    for path in _stamp_paths(topic):
        if path[:-1] and count_format(_finite(topic.fields[path])) == "epoch_s":
            found[path[:-1]] = None
    for path, numbers in topic.fields.items():
        form = count_format(_finite(numbers)) if is_time_name(str(path[-1])) else None
        if form:
            found[path] = TimeFormats({form: ""}, form != "excel_days")
    for path, text in topic.texts.items():
        if is_stamp(text):
            found[path] = time_formats([text])
    return found


def _time_of_messages(topics: Iterable[Topic]) -> Iterator[Question]:
    """A question where messages were recorded later than they were published."""
    log = np.array([t for one in topics for t in one.log_ns], dtype=np.float64)
    publish = np.array([t for one in topics for t in one.publish_ns], dtype=np.float64)
    if log.size and (log != publish).any() and (publish > 0).all():
        text = (
            f"publish_time is {float(np.median(log - publish)) / 1e6:.3g} ms before log_time: "
            "which is when it was measured?"
        )
        yield Question("time", text, ("log_time", "publish_time"))
