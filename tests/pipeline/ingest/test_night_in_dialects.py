"""One night as loggers of many makes would write it: the fit is the same."""

from __future__ import annotations

import gzip
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zstandard
from numpy.typing import NDArray

from pipeline.config import MotorSpec
from pipeline.ingest import ChannelSource, LogSource, RawChannel, read_log
from pipeline.motor_night import OK, fit_night
from pipeline.units import from_canonical
from tests.pipeline.simulated import CANONICAL, NIGHT, load_motor, motor_toml, night_of, operate

Array = NDArray[np.float64]
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
NAMES = tuple(CANONICAL)
SCALE = {"epoch_s": 1e-6, "epoch_ms": 1e-3, "epoch_us": 1.0, "epoch_ns": 1e3}


@dataclass(frozen=True)
class Dialect:
    """How a logger writes.

    Attributes
    ----------
    units
        Those that are not the tables'.
    settings
        Of the `LogSource`.
    """

    name: str
    units: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    line_end: str = "\n"
    pack: Callable[[bytes], bytes] = bytes
    header_every: int = 0
    zone: str = "UTC"
    order: tuple[str, ...] = NAMES
    bom: bytes = b""

    def source(self) -> LogSource:
        channels = tuple(
            ChannelSource(name, name, self.units.get(name, unit))
            for name, unit in CANONICAL.items()
        )
        if self.settings.get("layout") == "file_per_channel":
            channels = tuple(ChannelSource(c.channel, f"*_{c.channel}.*", c.unit) for c in channels)
        return LogSource(**{"format": "csv", "channels": channels, **self.settings})

    def stamp(self, time_us: int) -> str:
        form = self.settings.get("time_format", "iso8601")
        moment = (EPOCH + timedelta(microseconds=time_us)).astimezone(ZoneInfo(self.zone))
        if form in SCALE:
            return str(round(time_us * SCALE[form]))
        if form == "excel_days":
            days = (moment.replace(tzinfo=None) - datetime(1899, 12, 30)) / timedelta(days=1)
            return self.number(days)
        if form == "iso8601":
            return moment.isoformat() if "zone" in self.name else moment.isoformat()[:-6]
        return moment.strftime(form)

    def number(self, value: float) -> str:
        text = repr(float(value))
        if self.settings.get("thousands"):
            text = f"{value:,.30f}"
        marks = {".": self.settings.get("decimal", "."), ",": self.settings.get("thousands", "")}
        return text.translate(str.maketrans(marks))

    def text(self, rows: Sequence[Sequence[str]], head: Sequence[str]) -> bytes:
        separator = self.settings.get("separator", ",")
        lines = ["preamble of the logger"] * self.settings.get("skip_rows", 0)
        heads = [head, *[["unit"] * len(head)] * self.settings.get("unit_rows", 0)]
        for i, row in enumerate(rows):
            again = i == 0 or (self.header_every and i % self.header_every == 0)
            lines += map(separator.join, [*(heads if again else []), row])
        text = self.line_end.join([*lines, ""])
        return self.pack(self.bom + text.encode(self.settings.get("encoding", "utf-8")))

    def write(self, folder: Path, time_us: Array, values: Mapping[str, Array]) -> list[Path]:
        stamps = [self.stamp(int(time)) for time in time_us]
        cells = {name: [self.number(value) for value in values[name]] for name in self.order}
        date = self.settings.get("date_column")
        if date:
            stamps = [self.settings.get("separator", ",").join(s.split(" ")) for s in stamps]
        times = [date, "time"] if date else ["time"]
        path = folder / "log.csv"
        layout = self.settings.get("layout", "wide")
        if layout == "file_per_channel":
            paths = [folder / f"m_{name}.csv" for name in self.order]
            for one, name in zip(paths, self.order, strict=True):
                one.write_bytes(
                    self.text(list(zip(stamps, cells[name], strict=True)), [*times, "value"])
                )
            return paths
        if layout == "long":
            rows = [
                (stamp, name, cells[name][i])
                for i, stamp in enumerate(stamps)
                for name in self.order
            ]
            path.write_bytes(self.text(rows, [*times, "channel", "value"]))
            return [path]
        wide = list(zip(stamps, *cells.values(), strict=True))
        path.write_bytes(self.text(wide, [*times, *self.order]))
        return [path]


SEMICOLON = {"separator": ";", "decimal": ","}
GERMAN = {"time_format": "%d.%m.%Y %H:%M:%S", "time_zone": "Europe/Oslo"}
DIALECTS = (
    Dialect("plain"),
    Dialect("ISO with a zone", zone="Asia/Kolkata"),
    Dialect(
        "semicolon, decimal comma",
        {"pressure_difference": "kPa"},
        {"separator": ";", "decimal": ","},
    ),
    Dialect(
        "thousands",
        {"pressure_difference": "kPa"},
        {"separator": ";", "decimal": ",", "thousands": "."},
    ),
    Dialect("tab, psi, CRLF", {"pressure_difference": "psi"}, {"separator": "\t"}, "\r\n"),
    Dialect("°F, CR", {"oil_temperature": "degF"}, line_end="\r"),
    Dialect("K, units row", {"oil_temperature": "K"}, {"unit_rows": 1}, header_every=500),
    Dialect("m³/h, preamble", {"leakage_flow": "m3/h"}, {"skip_rows": 3}),
    Dialect("BOM", bom=b"\xef\xbb\xbf", order=NAMES[::-1]),
    Dialect("UTF-16", settings={"encoding": "utf-16"}),
    Dialect("UTF-16, no BOM", settings={"encoding": "utf-16-be", "separator": ";"}),
    Dialect("Latin-1", {"speed": "rad/s"}, {"encoding": "latin-1"}),
    Dialect("gzip, epoch_ms", settings={"time_format": "epoch_ms"}, pack=gzip.compress),
    Dialect(
        "zstd, epoch_ns",
        settings={"time_format": "epoch_ns"},
        pack=zstandard.ZstdCompressor().compress,
    ),
    Dialect("long, epoch_s", settings={"layout": "long", "time_format": "epoch_s"}),
    Dialect("file a channel", {"pressure_difference": "Pa"}, {"layout": "file_per_channel"}),
    Dialect(
        "spreadsheet",
        settings={
            "time_format": "excel_days",
            "time_zone": "Europe/Oslo",
            "separator": ";",
            "decimal": ",",
        },
        zone="Europe/Oslo",
    ),
    Dialect(
        "American clock",
        {"pressure_difference": "psi", "oil_temperature": "degF", "leakage_flow": "us_gal/min"},
        {"time_format": "%m/%d/%Y %I:%M:%S %p", "time_zone": "America/Chicago"},
        zone="America/Chicago",
    ),
    Dialect(
        "date and time apart",
        settings={
            "date_column": "date",
            "time_format": "%d.%m.%Y %H:%M:%S",
            "time_zone": "Europe/Oslo",
        },
        zone="Europe/Oslo",
    ),
)


@dataclass(frozen=True)
class Recorded:
    """A night, and what it comes to."""

    spec: MotorSpec
    time_us: NDArray[np.int64]
    values: Mapping[str, Array]
    fit: Mapping[str, float]


def figures(spec: MotorSpec, channels: Mapping[str, RawChannel]) -> dict[str, float]:
    """Every estimate and every figure of the fits of a night."""
    outcome = fit_night(spec, night_of(), channels, {})
    assert outcome.status == OK, outcome.reason
    found = {
        f"{i} {row['parameter']}": row["value"] for i, row in enumerate(outcome.rows["parameters"])
    }
    return {name: value for name, value in found.items() if value is not None}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    spec = load_motor(tmp_path_factory.mktemp("motor"), motor_toml("M1"))
    operation = operate()
    rng = np.random.default_rng(3)
    flow = operation.flow(spec.motor(NIGHT, "none"))
    values = operation.channels(flow + 0.01 * rng.standard_normal(flow.size))
    plain = tuple(ChannelSource(name, name, unit) for name, unit in CANONICAL.items())
    path = tmp_path_factory.mktemp("log") / "log.parquet"
    stamps = pa.array(operation.time_us, pa.timestamp("us", "UTC"))
    pq.write_table(pa.table({"time": stamps, **values}), path)
    log = read_log(path, LogSource("parquet", plain))
    return Recorded(spec, operation.time_us, values, figures(spec, log.channels))


def joined(paths: Sequence[Path], source: LogSource) -> dict[str, RawChannel]:
    logs = [read_log(path, source) for path in paths]
    channels = {}
    for name in CANONICAL:
        parts = [log.channels[name] for log in logs if log.channels[name].time_us.size]
        assert len(parts) == 1
        channels[name] = parts[0]
    return channels


def in_units(values: Mapping[str, Array], units: Mapping[str, str]) -> dict[str, Array]:
    return {
        name: from_canonical(name, value, units.get(name, CANONICAL[name]))
        for name, value in values.items()
    }


@pytest.mark.parametrize("dialect", DIALECTS, ids=lambda dialect: dialect.name)
def test_every_dialect_gives_the_same_fit(
    dialect: Dialect, recorded: Recorded, tmp_path: Path
) -> None:
    values = in_units(recorded.values, dialect.units)
    paths = dialect.write(tmp_path, recorded.time_us, values)
    found = figures(recorded.spec, joined(paths, dialect.source()))
    assert found == pytest.approx(recorded.fit, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("nested", [False, True])
def test_float32_gives_the_same_fit_to_its_precision(
    recorded: Recorded, tmp_path: Path, nested: bool
) -> None:
    path = tmp_path / "log.parquet"
    columns = {n: pa.array(v.astype(np.float32)) for n, v in recorded.values.items()}
    table: dict[str, Any] = {"time": pa.array(recorded.time_us * 1000, pa.timestamp("ns", "UTC"))}
    names = dict.fromkeys(NAMES, "")
    if nested:
        inner = pa.StructArray.from_arrays(list(columns.values()), names=list(columns))
        table["hydraulics"] = pa.StructArray.from_arrays([inner], names=["drive"])
        names = dict.fromkeys(NAMES, "hydraulics.drive.")
    else:
        table |= columns
    pq.write_table(pa.table(table), path, row_group_size=333)
    channels = tuple(ChannelSource(n, above + n, CANONICAL[n]) for n, above in names.items())
    found = figures(recorded.spec, read_log(path, LogSource("parquet", channels)).channels)
    # 2^-24 of each reading; what is estimated answers to many of them at once.
    assert found == pytest.approx(recorded.fit, rel=1e-5, abs=1e-6)
