"""The conformance kit: what a reader of any format has to do, as checks that need no test runner.

A package that gives a reader runs every check on a `Format`, each in an empty folder::

    @pytest.mark.parametrize("check", checks_of(FORMAT), ids=lambda check: check.__name__)
    def test_conformance(check, tmp_path):
        check(FORMAT, tmp_path)

A check raises an AssertionError, or what the reader raised, where the reader does not conform.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.config.channels import Channel, Channels
from pipeline.config.logs import Logs
from pipeline.errors import LogError
from pipeline.ingest import RawLog, read_log, time_span

T0_US = 1_740_808_800_000_000
"""2025-03-01T06:00:00 UTC (``date -u -d @1740808800``)."""

STEP_US = 100_000
"""Between rows."""

NAMES = ("dp", "T", "q")
"""Columns, topics or signals of a log of the kit."""

CHANNELS: Channels = {
    "pressure_difference": Channel(source="dp", unit="bar"),
    "oil_temperature": Channel(source="T", unit="degC"),
    "leakage_flow": Channel(source="q", unit="l/min"),
}

STRANGE = (
    *(b"", b"\n", b"\r", b",", b'"', b'"\n', b"\x00", b"\xff", b"nan", b"9" * 400, b"[" * 200),
    *(b"\x1f\x8b\x08", b"\x28\xb5\x2f\xfd", b"PAR1", b"\x89MCAP0\r\n", b"time,dp,T,q\n"),
    *(b"9999-12-31T23:59:59Z", b"\x15\x80\x80\x80\x80\x10", b"\x19\xfc", b"\x1c" * 64),
)
"""What damage puts into a file: ends of lines and cells, marks of formats, counts beyond all."""

Cell = float | str | None
"""A number, text that is none, or nothing; a channel not logged at a time has no cell then."""


@dataclass(frozen=True)
class Row:
    """Cells logged at the same time."""

    time_us: int
    cells: Mapping[str, Cell]


@dataclass(frozen=True)
class Format:
    """A format, and a way to write a log in it."""

    name: str
    log_format: str  # value of ``logs.format``
    # Writes rows to a path, with the columns, topics or signals that are named.
    write: Callable[[Path, Sequence[Row], Sequence[str]], None]
    wide: bool = True  # all channels share the rows
    holds_text: bool = True  # a reading may be written that is no number
    is_checked: bool = False  # checksums cover all samples
    names_channels: bool = True  # a log without samples says which channels it has
    has_whole_rows: bool = False  # what stands before a cut can be known to be whole
    keys: Mapping[str, Any] = field(default_factory=dict)  # others of ``[logs]``
    # No damage ends the process. False where the library beneath crashes: that costs a run the
    # motor, not the others.
    survives_damage: bool = True

    @property
    def logs(self) -> Logs:
        """The config that reads it."""
        return Logs(format=self.log_format, files=("*",), **self.keys)

    def written(self, folder: Path, rows: Sequence[Row], names: Sequence[str] = NAMES) -> Path:
        """Return path of a log with these rows."""
        path = folder / f"log.{self.log_format}"
        self.write(path, rows, names)
        return path

    def read(self, folder: Path, rows: Sequence[Row], channels: Channels = CHANNELS) -> RawLog:
        """Return a log as it is written and read."""
        return read_log(self.written(folder, rows), self.logs, channels)

    def codes(self, path: Path) -> tuple[str, str]:
        """Return codes of the errors in which reading, and asking for the span, end.

        "" for none; what is no error of the log is raised.
        """
        return self._code(path, read_log), self._code(path, time_span)

    def _code(self, path: Path, read: Callable[..., object]) -> str:
        try:
            read(path, self.logs, CHANNELS)
        except LogError as error:
            if error.code == "log_reader" or path.name not in error.message:
                raise
            return error.code
        return ""


Check = Callable[[Format, Path], None]


def many_rows(count: int = 200) -> list[Row]:
    """Return pressure and flow at 10 Hz, temperature every second."""
    rng = random.Random(7)  # noqa: S311
    rows = []
    for i in range(count):
        cells = {"dp": rng.gauss(200.0, 30.0), "q": rng.gauss(1.3, 0.1)}
        if i % 10 == 0:
            cells["T"] = round(rng.gauss(50.0, 1.0), 1)
        rows.append(Row(T0_US + i * STEP_US, cells))
    return rows


def pressures(pressures: Sequence[Cell], first_us: int = T0_US) -> list[Row]:
    """Return rows with these pressures, at the kit's steps."""
    return [
        Row(first_us + i * STEP_US, {"dp": cell, "T": 50.0, "q": 1.0})
        for i, cell in enumerate(pressures)
    ]


def _holds(log: RawLog, rows: Sequence[Row]) -> bool:
    """Return True if a log has the samples of these rows, no more and no less."""
    for name, channel in CHANNELS.items():
        raw, source = log.channels[name], channel.source
        pairs = zip(raw.time_us[~raw.missing], raw.value[~raw.missing], strict=True)
        wanted = [(row.time_us, row.cells[source]) for row in rows if source in row.cells]
        if [(int(time), float(value)) for time, value in pairs] != wanted:
            return False
    return True


def every_sample_comes_back_to_the_last_digit(form: Format, folder: Path) -> None:
    """Times, values, order of channels, no notes; a slow channel is missing in between."""
    rows = many_rows()
    log = form.read(folder, rows)
    assert _holds(log, rows)
    assert list(log.channels) == list(CHANNELS)
    assert [channel.unparsed for channel in log.channels.values()] == [0, 0, 0]
    assert log.notes == ()
    temperature = log.channels["oil_temperature"]
    assert np.isnan(temperature.value[temperature.missing]).all()
    assert (temperature.time_us.size, log.rows) == ((200, 200) if form.wide else (20, 420))
    for channel in log.channels.values():
        for values in (channel.time_us, channel.value, channel.missing):
            assert not values.flags.writeable


def scale_offset_and_unit_make_the_canonical_reading(form: Format, folder: Path) -> None:
    """A 4-20 mA transmitter for 0-400 bar, here in psi; °F; a source may feed two channels."""
    rows = [Row(T0_US, {"dp": 12.0, "T": 122.0, "q": 1e308})]
    channels: Channels = {
        "high_port_pressure": Channel(source="dp", unit="kPa"),
        "pressure_difference": Channel(source="dp", unit="psi", scale=362.5943, offset=-1450.377),
        "oil_temperature": Channel(source="T", unit="degF"),
        "leakage_flow": Channel(source="q", unit="m3/s", scale=10.0),
    }
    raw_channels = form.read(folder, rows, channels).channels
    for name, value in zip(channels, (0.12, 200.0, 50.0, np.inf), strict=True):
        np.testing.assert_allclose(raw_channels[name].value, [value], rtol=1e-6)
    wanted_only: Channels = {"pressure_difference": CHANNELS["pressure_difference"]}
    assert form.read(folder, many_rows(), wanted_only).rows == 200


def blank_is_missing_but_nan_and_infinity_are_readings(form: Format, folder: Path) -> None:
    """Cleaning refuses what is not finite; a reader passes it on."""
    log = form.read(folder, pressures([1.0, None, math.nan, math.inf, -math.inf, 2.0]))
    channel = log.channels["pressure_difference"]
    assert channel.missing.tolist() == [False, True, False, False, False, False]
    np.testing.assert_array_equal(channel.value, [1, np.nan, np.nan, np.inf, -np.inf, 2])
    assert channel.unparsed == 0
    # Missing throughout is no error: the others are good.
    log = form.read(folder, pressures([None] * 5))
    assert log.channels["pressure_difference"].missing.all()
    assert log.channels["pressure_difference"].unparsed == 0
    assert not log.channels["leakage_flow"].missing.any()


def text_that_is_no_number_is_missing_and_counted(form: Format, folder: Path) -> None:
    """Counted in its channel alone; without any number it is an error."""
    log = form.read(folder, pressures([1.0, "ERR", 2.0, "1.2.3", None, "0x10", "true", 3.0]))
    channel = log.channels["pressure_difference"]
    assert (channel.unparsed, channel.missing.sum()) == (4, 5)
    assert channel.value[~channel.missing].tolist() == [1.0, 2.0, 3.0]
    assert log.channels["leakage_flow"].unparsed == 0
    assert form.codes(form.written(folder, pressures(["broken wire"] * 5)))[0] == "log_type"


def backward_and_repeated_time_stays_in_the_order_of_the_file(form: Format, folder: Path) -> None:
    """A reader sorts nothing."""
    offsets = [0, 5, 3, 3, 9, 1]
    rows = [pressures([float(i)], T0_US + at * STEP_US)[0] for i, at in enumerate(offsets)]
    log = form.read(folder, rows)
    channel = log.channels["pressure_difference"]
    assert ((channel.time_us - T0_US) // STEP_US).tolist() == offsets
    assert channel.value.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert log.ends() == (T0_US, T0_US + 9 * STEP_US)
    path = form.written(folder, many_rows(3000))
    assert time_span(path, form.logs, CHANNELS) == (T0_US, T0_US + 2999 * STEP_US)


def a_log_without_rows_has_channels_without_samples(form: Format, folder: Path) -> None:
    """It is read, and has no span."""
    log = form.read(folder, [])
    assert (log.rows, log.ends()) == (0, None)
    assert [channel.time_us.size for channel in log.channels.values()] == [0, 0, 0]
    assert form.codes(form.written(folder, [])) == ("", "log_empty")


def stamps_that_cannot_be_are_left_out_and_most_of_them_an_error(
    form: Format, folder: Path
) -> None:
    """Of a clock that was never set, or is set to 2150."""
    good = pressures([2.0] * 7)
    for first_us in (3_600_000_000, 5_680_281_600_000_000):
        wrong = pressures([1.0] * 9, first_us)
        log = form.read(folder, [*good[:4], *wrong[:3], *good[4:]])
        assert log.channels["pressure_difference"].value.tolist() == [2.0] * 7
        assert log.notes[0].startswith("3 " if form.wide else "9 ")
        assert "time" in log.notes[0]
        path = folder / f"log.{form.log_format}"
        assert time_span(path, form.logs, CHANNELS) == (T0_US, T0_US + 6 * STEP_US)
        assert form.codes(form.written(folder, wrong)) == ("log_time", "log_time")


def what_is_no_log_is_an_error(form: Format, folder: Path) -> None:
    """Nothing, a folder, an empty file, random bytes of any size, a column or topic too few."""
    (folder / "folder").mkdir()
    (folder / "empty").touch()
    known = {"nothing": "log_missing", "folder": "log_not_readable", "empty": "log_empty"}
    for name, code in known.items():
        assert form.codes(folder / name) == (code, code)
    rng = random.Random(3)  # noqa: S311
    for size in (1, 7, 8, 12, 37, 64, 1000, 100_000):
        (folder / "log").write_bytes(rng.randbytes(size))
        assert all(form.codes(folder / "log"))
    path = form.written(folder, many_rows(5), ["dp", "q"])
    assert form.codes(path)[0] == "log_column_missing"


def a_cut_file_is_an_error_or_its_whole_rows(form: Format, folder: Path) -> None:
    """A copy that was broken off is never taken for a whole log with other samples."""
    rows = many_rows(40)
    path = form.written(folder, rows)
    data = path.read_bytes()
    for length in [*range(8, len(data), max(1, len(data) // 80)), len(data) - 1]:
        path.write_bytes(data[:length])
        code, _ = form.codes(path)
        assert code in {"log_truncated", "log_damaged", "log_empty", ""}
        if not code:
            assert form.has_whole_rows, f"{length} of {len(data)} bytes are read as a whole log"
            log = read_log(path, form.logs, CHANNELS)
            assert _holds(log, rows[: log.rows])
            assert len(log.notes) <= 1


def damage_never_raises_anything_else(form: Format, folder: Path) -> None:
    """A flipped bit, or bytes in the place of others; checksums keep every sample they cover."""
    rows = many_rows(40)
    path = form.written(folder, rows)
    data = path.read_bytes()
    rng = random.Random(11)  # noqa: S311
    for _ in range(60):
        at, size = rng.randrange(len(data)), rng.choice([0, 1, 4, 8, 100])
        flipped = bytes([data[at] ^ 1 << rng.randrange(8)])
        for other, behind in ((flipped, at + 1), (rng.choice(STRANGE), at + size)):
            path.write_bytes(data[:at] + other + data[behind:])
            code, _ = form.codes(path)
            if not code and form.is_checked:
                assert _holds(read_log(path, form.logs, CHANNELS), rows)


def checks_of(form: Format) -> tuple[Check, ...]:
    """Return checks that apply to a format; each takes the format and an empty folder."""
    text = (text_that_is_no_number_is_missing_and_counted,) if form.holds_text else ()
    named = (a_log_without_rows_has_channels_without_samples,) if form.names_channels else ()
    damage = (damage_never_raises_anything_else,) if form.survives_damage else ()
    return (
        every_sample_comes_back_to_the_last_digit,
        scale_offset_and_unit_make_the_canonical_reading,
        blank_is_missing_but_nan_and_infinity_are_readings,
        backward_and_repeated_time_stays_in_the_order_of_the_file,
        stamps_that_cannot_be_are_left_out_and_most_of_them_an_error,
        what_is_no_log_is_an_error,
        a_cut_file_is_an_error_or_its_whole_rows,
        *text,
        *named,
        *damage,
    )
