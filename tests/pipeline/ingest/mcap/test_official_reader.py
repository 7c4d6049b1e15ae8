"""MCAP files of others, against the official reader."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from pipeline.errors import LogError
from pipeline.ingest import read_log, time_span
from tests.pipeline.ingest.mcap_files import (
    FACTORIES,
    all_values,
    followed,
    official_messages,
    source_of,
)


def numbers_of(message: Any, before: str = "") -> Iterator[str]:
    """Paths to the numbers of a decoded message of ROS 2, the first three of an array."""
    if isinstance(message, bool | int | float):
        yield before.removeprefix(".")
    elif isinstance(message, list | bytes):
        for i, one in enumerate(message[:3]):
            yield from numbers_of(one, f"{before}[{i}]")
    elif not isinstance(message, str):
        for name in message.__slots__:
            yield from numbers_of(getattr(message, name), f"{before}.{name}")


def test_all_numbers_of_real_recordings_are_read_as_by_the_official_reader(
    foreign_files: Path,
) -> None:
    compared = 0
    for path in sorted((foreign_files / "mcap").glob("*.mcap")):
        if path.stem == "test_bag_for_seek_0":
            continue
        with path.open("rb") as file:
            reader = make_reader(
                file, validate_crcs=True, decoder_factories=[f() for f in FACTORIES]
            )
            messages = list(reader.iter_decoded_messages(log_time_order=False))
        for topic in {channel.topic for _, channel, *_ in messages}:
            decoded = [m for _, channel, _, m in messages if channel.topic == topic]
            times = [m.log_time // 1000 for _, channel, m, _ in messages if channel.topic == topic]
            paths = sorted({one for message in decoded for one in numbers_of(message)})
            for field, found in all_values(path, paths, topic).items():
                np.testing.assert_equal(found, [followed(message, field) for message in decoded])
                compared += len(found)
            if paths:
                channel = read_log(path, *source_of(paths[0], topic=topic)).channels
                assert channel["pressure_difference"].time_us.tolist() == times
    assert compared > 500


def test_the_clock_of_a_real_recording_from_before_1990_is_refused(foreign_files: Path) -> None:
    """Its log times are some milliseconds after 1970, as of a logger whose clock was never set."""
    path = foreign_files / "mcap" / "test_bag_for_seek_0.mcap"
    field = next(iter(numbers_of(official_messages(path, "topic1")[0])))
    source = source_of(field, topic="topic1")
    for reader in (read_log, time_span):
        with pytest.raises(LogError, match="before 1990") as raised:
            reader(path, *source)
        assert raised.value.code == "log_time"
