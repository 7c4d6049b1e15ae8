"""Round trip, sample by sample, of random logs in random dialects of text."""

from __future__ import annotations

import codecs
import random
import string
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.config.logs import THOUSANDS
from pipeline.ingest import read_log, time_span
from pipeline.ingest.conformance import T0_US
from pipeline.messages import counted
from pipeline.units import CHANNELS
from tests.dialects import PACKERS, Csv, Recorded

DAYS_US = 6 * 86_400_000_000  # behind `T0_US`, in which no zone changes its clocks
ZONES = ("UTC", "Europe/Stockholm", "America/St_Johns", "Asia/Kathmandu", "Etc/GMT-1")
EPOCHS = ("epoch_s", "epoch_ms", "epoch_us", "epoch_ns")
# Formats, and the step of the stamps that they can write [us].
STEPS = {
    "%d.%m.%Y %H:%M:%S": 1_000_000,
    "%m/%d/%y %I:%M:%S %p": 1_000_000,
    "%Y%m%dT%H%M%S%z": 1_000_000,
    "%d %b %Y %H:%M:%S,%f": 1,
    "%Y-%j %H:%M:%S.%f": 1,
    "%Y-%m-%d %H:%M": 60_000_000,
    "excel_days": 1000,
    **dict.fromkeys(("iso8601", *EPOCHS), 1),
}


def names_of(draw: random.Random) -> list[str]:
    """Names of the channels, and of the columns of time, date, channel and value."""
    letters = string.ascii_letters + "äß °[]/()"
    return [f"x{''.join(draw.choices(letters, k=6))}{i}x" for i in range(len(CHANNELS) + 4)]


def csv_dialect(draw: random.Random) -> tuple[Csv, int]:
    """Any combination of what a CSV may be, and the step of its stamps."""
    one_of = draw.choice
    decimal = one_of(".,")
    separator = one_of([mark for mark in ",;\t|" if mark != decimal])
    marks = [mark for mark in THOUSANDS if mark not in (decimal, separator) and mark.isascii()]
    time_format, encoding = one_of(list(STEPS)), one_of(["utf-8", "utf-8-sig", "latin-1", "utf-16"])
    *channels, time, date, name, value = names_of(draw)
    logs: dict[str, Any] = {
        "time": time,
        "time_format": time_format,
        "time_zone": one_of(ZONES),
        "layout": one_of(["wide", "long", "file_per_channel"]),
        "channel_column": name,
        "value_column": value,
        "encoding": encoding,
        "separator": separator,
        "decimal": decimal,
        "thousands": one_of(["", *marks]),
        "skip_rows": draw.randrange(4),
        "unit_rows": draw.randrange(3),
    }
    if " " in time_format and one_of([True, False]):
        logs["date_column"] = date
    dialect = Csv(
        logs,
        names=dict(zip(CHANNELS, channels, strict=True)),
        line_end=one_of(["\n", "\r\n", "\r"]),
        bom=one_of([b"", codecs.BOM_UTF8]) if encoding == "utf-8" else b"",
        quoted="," in time_format or one_of([True, False]),
        packed=one_of(list(PACKERS)),
        written_zone=one_of(["", *ZONES]),
        tokens=one_of([("",), ("---", "Bad", "NA"), ("", "null")]),
        header_every=one_of([0, 3]),
        reverse=one_of([True, False]),
        company=one_of([True, False]),
    )
    return dialect, STEPS[time_format]


def log_for(draw: random.Random, step_us: int) -> Recorded:
    """A few samples of some channels, whose time goes back here and there."""
    count = draw.randint(1, 12)
    steps = [draw.randrange(DAYS_US // step_us) for _ in range(count)]
    cells = [lambda: float(draw.randrange(-(2**20), 2**20)), lambda: np.nan]
    cells += [lambda: draw.gauss(0, 1e3), lambda: np.inf, lambda: -1e-300]
    readings = {
        name: np.array([draw.choice(cells)() for _ in range(count)])
        for name in draw.sample(CHANNELS, draw.randint(1, 4))
    }
    return Recorded(T0_US + step_us * np.array(steps), readings)


@pytest.mark.parametrize(
    "seed", [*range(20), *(pytest.param(seed, marks=pytest.mark.full) for seed in range(20, 60))]
)
def test_what_is_written_in_any_dialect_is_read_back(tmp_path: Path, seed: int) -> None:
    draw = random.Random(seed)  # noqa: S311
    dialect, step_us = csv_dialect(draw)
    log = log_for(draw, step_us)
    source, paths = dialect.source_of(log.values), dialect.write(tmp_path, "log", log)
    for name, value in log.values.items():
        (path,) = [path for path in paths if len(paths) == 1 or f"+{name}." in path.name]
        raw = read_log(path, *source)
        channel, known = raw.channels[name], ~np.isnan(value)
        assert channel.time_us[~channel.missing].tolist() == log.time_us[known].tolist()
        assert channel.value[~channel.missing].tolist() == value[known].tolist()
        assert channel.unparsed == 0
        # The header again, with its lines of units, is a row without a time.
        again = -(-raw.rows // dialect.header_every) - 1 if dialect.header_every else 0
        again *= 1 + dialect.logs["unit_rows"]
        assert raw.notes == ((f"{counted(again, 'row')} without a readable time",) if again else ())
        # Rows at the ends in which every channel is blank are in the span of the file alone.
        rows = int(log.time_us.min()), int(log.time_us.max())
        assert time_span(path, *source) in (raw.ends(), rows)
