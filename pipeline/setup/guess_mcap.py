"""Guesses at the channels among the topics and fields of an MCAP file, and at their time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.config.field_paths import FieldPath, path_text
from pipeline.ingest.mcap.decoding import NANOSECONDS, SECONDS
from pipeline.ingest.mcap.topics import Topic, read_topics
from pipeline.messages import counted
from pipeline.setup.guess_channels import best_by_channel, channel_of, preference, unit_of, words_of
from pipeline.setup.guess_layout import VALUE_WORDS, GuessedSource
from pipeline.setup.guess_times import TimeGuess, guess_time, is_stamp, is_time_name, number_format
from pipeline.setup.motor_groups import groups_of
from pipeline.units import QUANTITIES

_FIELDS_SHOWN = 40
_SAMPLES_SHOWN = 3
# Fields beside a reading that are none.
_NO_READINGS = {
    *("seq", "sequence", "sec", "secs", "nanosec", "nsec", "nsecs", "nanos", "seconds"),
    *("nanoseconds", "variance", "covariance", "id", "status", "quality", "index", "stamp"),
}
# Units that messages of ROS 2's sensor_msgs are in by their definition.
_STANDARD_UNITS = {
    ("FluidPressure", "fluid_pressure"): "Pa",
    ("Temperature", "temperature"): "degC",
}


@dataclass(frozen=True, slots=True)
class McapGuess:
    """Channels and time of an MCAP file."""

    listing: tuple[str, ...]  # a line a topic, and one a field of it
    time: str  # of the messages, to go by
    remark: str  # what speaks for another time
    stamp: str  # path of a stamp in all messages of the channels, or nothing
    stamp_format: TimeGuess | None  # None for a pair of seconds and nanoseconds
    sources: tuple[GuessedSource, ...]
    unused: Mapping[str, tuple[str, ...]]  # samples of fields that no channel was found for
    # Where topics or fields are of several motors: those of each, by what their names begin with.
    motors: Mapping[str, tuple[GuessedSource, ...]]


@dataclass(frozen=True, slots=True)
class _Reading:
    """A field that may be a channel's."""

    topic: Topic
    path: FieldPath
    channel: str | None

    @property
    def name(self) -> str:
        return f"{self.topic.name} {path_text(self.path)}"

    @property
    def told(self) -> str:
        """The topic, with the field where that is called something."""
        field = path_text(self.path)
        return self.topic.name if field in VALUE_WORDS else f"{self.topic.name}.{field}"

    @property
    def samples(self) -> tuple[str, ...]:
        return _shown(self.topic.fields[self.path])


def guess_mcap(path: Path) -> McapGuess:
    """Topics of a file, and the channels that they seem to be."""
    topics = read_topics(path)
    readings = [one for topic in topics for one in _readings(topic)]
    motors = _motors(readings)
    chosen = [one for own in (motors or {"": _best(readings)}).values() for one in own]
    of_channels = list({one.topic.name: one.topic for one in chosen}.values())
    stamp, stamp_format = _stamp(of_channels)
    time, remark = ("log_time", "") if stamp else _time(of_channels)
    return McapGuess(
        listing=tuple(_listing(topics)),
        time=time,
        remark=remark,
        stamp=stamp,
        stamp_format=stamp_format,
        sources=tuple(_source(one) for one in _best(readings)),
        unused={one.name: one.samples for one in readings if one not in chosen},
        motors={name: tuple(map(_source, own)) for name, own in motors.items()},
    )


def _best(readings: Sequence[_Reading]) -> list[_Reading]:
    return list(best_by_channel((one.channel, _merit(one), one) for one in readings).values())


def _motors(readings: Sequence[_Reading]) -> dict[str, list[_Reading]]:
    """Readings of each motor, told by what repeats in topics and fields; none of a lone motor."""
    by_path = {one.told: one for one in readings if one.channel is not None}
    groups, _ = groups_of(list(by_path), {})
    if len(groups) < 2:
        return {}
    found = {}
    for group in groups:
        own = _best([by_path[name] for name in group.signals])
        topics = {one.topic.name for one in own}
        # Of fields of one topic, the motor's part is that of the fields.
        name = group.name.removeprefix(f"{topics.pop()}.") if len(topics) == 1 else group.name
        found[name] = own
    return found


def _merit(reading: _Reading) -> tuple[int, int]:
    is_value = bool(VALUE_WORDS & set(words_of(path_text(reading.path))))
    return preference(reading.channel or "", reading.name), int(is_value)


def _readings(topic: Topic) -> Iterator[_Reading]:
    stamps = {path[:-1] for path in _stamp_paths(topic)}
    paths = [
        path
        for path, numbers in topic.fields.items()
        if path[:-1] not in stamps
        and _name(path).lower() not in _NO_READINGS
        and not (is_time_name(_name(path)) and number_format(_finite(numbers)))
    ]
    for path in paths:
        has_reading = bool(_finite(topic.fields[path]))
        channel = _channel(topic.name, path, len(paths) == 1) if has_reading else None
        yield _Reading(topic, path, channel)


def _name(path: FieldPath) -> str:
    """The last key of a path."""
    return next(step for step in reversed(path) if isinstance(step, str))


def _channel(topic: str, path: FieldPath, is_lone: bool) -> str | None:
    """Channel of a field, by its own name, else with those around it, else by its topic's."""
    steps = [path_text((step,)) for step in path if isinstance(step, str)]
    field = " ".join(steps)
    names = (" ".join(steps[i:]) for i in reversed(range(len(steps))))
    of_field = next((channel for name in names if (channel := channel_of(name))), None)
    of_topic, both = channel_of(topic), channel_of(f"{topic} {field}")
    if of_field is not None:
        # The topic tells which pressure it is, where the field says no more than that it is one.
        return both if both and QUANTITIES[both] == QUANTITIES[of_field] else of_field
    if both != of_topic:
        return both
    return of_topic if is_lone or VALUE_WORDS & set(words_of(field)) else None


def _stamp_paths(topic: Topic) -> list[FieldPath]:
    """Paths of the seconds of stamps that have nanoseconds beside them."""
    return [
        path
        for path in topic.fields
        if path[-1] in SECONDS and any((*path[:-1], name) in topic.fields for name in NANOSECONDS)
    ]


def _stamp(topics: Sequence[Topic]) -> tuple[str, TimeGuess | None]:
    """Path of a stamp that all messages have, and how it is written."""
    found = [_stamps_of(topic) for topic in topics]
    common = [path for path in (found[0] if found else {}) if all(path in one for one in found)]
    for path in common:
        if len({guess.formats if (guess := one[path]) else None for one in found}) == 1:
            return path_text(path), found[0][path]
    return "", None


def _stamps_of(topic: Topic) -> dict[FieldPath, TimeGuess | None]:
    """Stamps within the messages: pairs of numbers first, then counts and text."""
    found: dict[FieldPath, TimeGuess | None] = {}
    for path in _stamp_paths(topic):
        seconds = _finite(topic.fields[path])
        if path[:-1] and number_format(seconds) == "epoch_s":
            found[path[:-1]] = None
    for path, numbers in topic.fields.items():
        form = number_format(_finite(numbers)) if is_time_name(str(path[-1])) else None
        if form:
            found[path] = TimeGuess((form,), form != "excel_days")
    for path, text in topic.texts.items():
        if is_stamp(text):
            found[path] = guess_time([text])
    return found


def _time(topics: Sequence[Topic]) -> tuple[str, str]:
    """Log or publish time, and a remark where they differ."""
    log = np.array([t for one in topics for t in one.log_ns], dtype=np.float64)
    publish = np.array([t for one in topics for t in one.publish_ns], dtype=np.float64)
    if not log.size or (log == publish).all() or not (publish > 0).all():
        return "log_time", ""
    behind_ms = float(np.median(log - publish)) / 1e6
    return (
        "log_time",
        f"publish_time is {behind_ms:.3g} ms before it: which is when it was measured?",
    )


def _source(reading: _Reading) -> GuessedSource:
    topic, channel = reading.topic, reading.channel or ""
    text = path_text(reading.path)
    standard = _STANDARD_UNITS.get((topic.schema.split("/")[-1].split(".")[-1], text))
    beside = [
        said
        for path, said in topic.texts.items()
        if str(path[-1]).lower() in ("unit", "units") and path[:-1] == reading.path[:-1]
    ]
    told = (unit_of(channel, said) for said in (*beside, text, topic.name))
    unit = standard or next((one for one in told if one), None)
    return GuessedSource(channel, topic.name, unit, reading.samples, text)


def _listing(topics: Sequence[Topic]) -> Iterator[str]:
    yield "topics:"
    for topic in topics:
        count = "" if topic.count is None else f", {counted(topic.count, 'message')}"
        schema = f" {topic.schema}" if topic.schema else ""
        yield f"  {topic.name}: {topic.encoding}{schema}{count}"
        if topic.fault:
            yield f"    not read: {topic.fault}"
        for path in list(topic.fields)[:_FIELDS_SHOWN]:
            yield f"    {path_text(path)}: {'; '.join(_shown(topic.fields[path])[:_SAMPLES_SHOWN])}"
        for path, text in list(topic.texts.items())[:_FIELDS_SHOWN]:
            yield f'    {path_text(path)}: "{text[:40]}"'


def _finite(numbers: Sequence[float]) -> list[float]:
    return [number for number in numbers if np.isfinite(number)]


def _shown(numbers: Sequence[float]) -> tuple[str, ...]:
    return tuple(f"{number:.6g}" for number in numbers)
