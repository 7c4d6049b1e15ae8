"""The conformance kit: what a reader of any format has to do, as checks that need no test runner.

A package that gives a reader runs every check on a `Format`, each in an empty folder::

    @pytest.mark.parametrize("check", checks_of(FORMAT), ids=lambda check: check.__name__)
    def test_conformance(check, tmp_path):
        check(FORMAT, tmp_path)

A check raises an AssertionError, or what the reader raised, where the reader does not conform.
"""

from __future__ import annotations

import pickle
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.config.channels import Channel, Channels
from pipeline.config.logs import Logs
from pipeline.errors import LogError
from pipeline.ingest import RawLog, read_log, time_span
from pipeline.ingest.contract import validate

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

Cell = float | str | None
"""A number, text that is none, or nothing; a channel not logged at a time has no cell then."""


@dataclass(frozen=True)
class Row:
    """Cells logged at one time."""

    time_us: int
    cells: Mapping[str, Cell]


@dataclass(frozen=True)
class Format:
    """A format, and a way to write a log in it.

    Attributes
    ----------
    log_format
        Value of ``logs.format``.
    write
        Writes rows to a path, with the columns, topics or signals that are named.
    wide
        All channels share the rows.
    holds_text
        A reading may be written that is no number.
    is_checked
        Checksums cover all samples.
    names_channels
        A log without samples says which channels it has.
    has_whole_rows
        What stands before the place where a file was cut can be told to be whole.
    keys
        Other keys of ``[logs]``.
    survives_damage
        No damage ends the process. Set it to False where the library beneath crashes: that costs a
        run the motor, not the others.
    """

    name: str
    log_format: str
    write: Callable[[Path, Sequence[Row], Sequence[str]], None]
    wide: bool = True
    holds_text: bool = True
    is_checked: bool = False
    names_channels: bool = True
    has_whole_rows: bool = False
    keys: Mapping[str, Any] = field(default_factory=dict)
    survives_damage: bool = True

    @property
    def logs(self) -> Logs:
        """The config that reads it."""
        return Logs(format=self.log_format, files=("*",), **self.keys)


Check = Callable[[Format, Path], None]


def many_rows(count: int = 200) -> list[Row]:
    """Pressure and flow at 10 Hz, temperature every second."""
    rng = random.Random(7)  # noqa: S311
    rows = []
    for i in range(count):
        cells = {"dp": rng.gauss(200.0, 30.0), "q": rng.gauss(1.3, 0.1)}
        if i % 10 == 0:
            cells["T"] = round(rng.gauss(50.0, 1.0), 1)
        rows.append(Row(T0_US + i * STEP_US, cells))
    return rows


def written(form: Format, folder: Path, rows: Sequence[Row], names: Sequence[str] = NAMES) -> Path:
    """Path of a log of a format with these rows."""
    path = folder / f"log.{form.log_format}"
    form.write(path, rows, names)
    return path


def row(time_us: int, pressure: Cell, temperature: Cell = 50.0, flow: Cell = 1.0) -> Row:
    """A row with a cell of each channel."""
    return Row(time_us, {"dp": pressure, "T": temperature, "q": flow})


def pressures(pressures: Sequence[Cell]) -> list[Row]:
    """Rows with these pressures, at the kit's steps."""
    return [row(T0_US + i * STEP_US, cell) for i, cell in enumerate(pressures)]


def samples(log: RawLog, channel: str) -> list[tuple[int, float]]:
    """Samples of a channel that are not missing."""
    raw = log.channels[channel]
    pairs = zip(raw.time_us[~raw.missing], raw.value[~raw.missing], strict=True)
    return [(int(time), float(value)) for time, value in pairs]


def expected(rows: Sequence[Row], name: str) -> list[tuple[int, float]]:
    """Samples of a column that its rows hold."""
    cells = ((row.time_us, row.cells.get(name)) for row in rows)
    return [(time, cell) for time, cell in cells if isinstance(cell, float)]


def require_equal(one: RawLog, other: RawLog) -> None:
    """Refuse two logs that differ."""
    assert (one.rows, one.first_us, one.last_us) == (other.rows, other.first_us, other.last_us)
    assert one.channels.keys() == other.channels.keys()
    for name, channel in one.channels.items():
        np.testing.assert_array_equal(channel.time_us, other.channels[name].time_us)
        np.testing.assert_array_equal(channel.value, other.channels[name].value)
        np.testing.assert_array_equal(channel.missing, other.channels[name].missing)
        assert channel.unparsed == other.channels[name].unparsed


def outcome(read: Callable[[], object]) -> str:
    """Either "read", or the code of the error; one that is not the log's is raised."""
    try:
        read()
    except LogError as error:
        if error.code == "log_reader":
            raise
        return error.code
    return "read"


def error_of(form: Format, path: Path, channels: Channels = CHANNELS) -> LogError:
    """The error with which a log is refused."""
    try:
        read_log(path, form.logs, channels)
    except LogError as error:
        return error
    raise AssertionError(f"{path.name} is read, and not refused")


def span_code(form: Format, path: Path) -> str:
    """Outcome of asking for a log's span."""
    return outcome(lambda: time_span(path, form.logs, CHANNELS))


def every_sample_comes_back_to_the_last_digit(form: Format, folder: Path) -> None:
    """Times, values, order of channels, and no notes."""
    rows = many_rows()
    log = read_log(written(form, folder, rows), form.logs, CHANNELS)
    assert list(log.channels) == list(CHANNELS)
    for name, channel in CHANNELS.items():
        assert samples(log, name) == expected(rows, channel.source)
        assert log.channels[name].unparsed == 0
    assert (log.notes, log.refused_rows) == ((), 0)


def a_channel_logged_less_often_is_missing_in_between_or_not_there(
    form: Format, folder: Path
) -> None:
    """A blank cell where rows are shared, no sample where they are not."""
    log = read_log(written(form, folder, many_rows()), form.logs, CHANNELS)
    temperature = log.channels["oil_temperature"]
    assert temperature.time_us.size == (200 if form.wide else 20)
    assert temperature.missing.sum() == (180 if form.wide else 0)
    assert np.isnan(temperature.value[temperature.missing]).all()
    assert log.rows == (200 if form.wide else 420)


def it_keeps_the_contract(form: Format, folder: Path) -> None:
    """Types, lengths and ends, and arrays that cannot be written."""
    log = read_log(written(form, folder, many_rows()), form.logs, CHANNELS)
    validate(log, CHANNELS)
    for channel in log.channels.values():
        for values in (channel.time_us, channel.value, channel.missing):
            assert not values.flags.writeable


def scale_offset_and_unit_make_the_canonical_reading(form: Format, folder: Path) -> None:
    """A 4–20 mA transmitter for 0–400 bar, here in psi; °F; US gallons."""
    channels: Channels = {
        "pressure_difference": Channel(source="dp", unit="psi", scale=362.5943, offset=-1450.377),
        "oil_temperature": Channel(source="T", unit="degF"),
        "leakage_flow": Channel(source="q", unit="us_gal/min"),
    }
    log = read_log(written(form, folder, [row(T0_US, 12.0, 122.0)]), form.logs, channels)
    np.testing.assert_allclose(log.channels["pressure_difference"].value, [200.0], rtol=1e-6)
    np.testing.assert_allclose(log.channels["oil_temperature"].value, [50.0])
    np.testing.assert_allclose(log.channels["leakage_flow"].value, [3.785411784])


def a_reading_too_large_for_another_unit_is_not_finite(form: Format, folder: Path) -> None:
    """1e309 m3/s."""
    channels: Channels = {"leakage_flow": Channel(source="q", unit="m3/s", scale=10.0)}
    log = read_log(written(form, folder, [row(T0_US, 1.0, 1.0, 1e308)]), form.logs, channels)
    assert log.channels["leakage_flow"].value.tolist() == [np.inf]


def blank_and_null_are_missing_but_nan_and_infinity_are_readings(
    form: Format, folder: Path
) -> None:
    """Cleaning refuses what is not finite; a reader passes it on."""
    values = [1.0, None, float("nan"), float("inf"), float("-inf"), 2.0]
    log = read_log(written(form, folder, pressures(values)), form.logs, CHANNELS)
    channel = log.channels["pressure_difference"]
    assert channel.missing.tolist() == [False, True, False, False, False, False]
    np.testing.assert_array_equal(
        channel.value, [1.0, np.nan, np.nan, np.inf, -np.inf, 2.0], strict=True
    )
    assert channel.unparsed == 0


def a_channel_that_is_null_throughout_is_missing_throughout(form: Format, folder: Path) -> None:
    """No error: the others are good."""
    log = read_log(written(form, folder, pressures([None] * 5)), form.logs, CHANNELS)
    assert log.channels["pressure_difference"].missing.all()
    assert log.channels["pressure_difference"].unparsed == 0
    assert not log.channels["leakage_flow"].missing.any()


def text_that_is_no_number_is_missing_and_counted(form: Format, folder: Path) -> None:
    """Counted in its channel alone."""
    cells: list[Cell] = [1.0, "ERR", 2.0, "1.2.3", None, "0x10", "true", 3.0]
    log = read_log(written(form, folder, pressures(cells)), form.logs, CHANNELS)
    channel = log.channels["pressure_difference"]
    assert channel.unparsed == 4
    assert channel.value[~channel.missing].tolist() == [1.0, 2.0, 3.0]
    assert channel.missing.sum() == 5
    assert log.channels["leakage_flow"].unparsed == 0


def a_channel_without_one_number_is_an_error_of_type(form: Format, folder: Path) -> None:
    """With an example of what is there."""
    error = error_of(form, written(form, folder, pressures(["broken wire"] * 5)))
    assert error.code == "log_type"
    assert "'broken wire'" in error.message


def backward_and_repeated_time_stays_in_the_order_of_the_file(form: Format, folder: Path) -> None:
    """A reader sorts nothing."""
    offsets = [0, 5, 3, 3, 9, 1]
    rows = [row(T0_US + offset * STEP_US, float(i)) for i, offset in enumerate(offsets)]
    log = read_log(written(form, folder, rows), form.logs, CHANNELS)
    channel = log.channels["pressure_difference"]
    assert ((channel.time_us - T0_US) // STEP_US).tolist() == offsets
    assert channel.value.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert (log.first_us, log.last_us) == (T0_US, T0_US + 9 * STEP_US)


def time_span_is_that_of_the_samples(form: Format, folder: Path) -> None:
    """With and without reading everything."""
    path = written(form, folder, many_rows(3000))
    log = read_log(path, form.logs, CHANNELS)
    span = (T0_US, T0_US + 2999 * STEP_US)
    assert time_span(path, form.logs, CHANNELS) == (log.first_us, log.last_us) == span


def two_readings_are_equal_and_travel_between_processes(form: Format, folder: Path) -> None:
    """The same file gives the same log."""
    path = written(form, folder, many_rows())
    log = read_log(path, form.logs, CHANNELS)
    require_equal(log, read_log(path, form.logs, CHANNELS))
    require_equal(log, pickle.loads(pickle.dumps(log)))  # noqa: S301


def only_what_is_wanted_is_read(form: Format, folder: Path) -> None:
    """One channel of three."""
    wanted: Channels = {"pressure_difference": CHANNELS["pressure_difference"]}
    log = read_log(written(form, folder, many_rows()), form.logs, wanted)
    assert list(log.channels) == ["pressure_difference"]
    assert log.rows == 200


def one_source_may_feed_two_channels(form: Format, folder: Path) -> None:
    """In different units."""
    channels: Channels = {
        "high_port_pressure": Channel(source="dp", unit="kPa"),
        "pressure_difference": CHANNELS["pressure_difference"],
    }
    found = read_log(written(form, folder, many_rows()), form.logs, channels).channels
    np.testing.assert_allclose(
        found["high_port_pressure"].value * 100.0, found["pressure_difference"].value, rtol=1e-12
    )


def a_log_without_rows_has_channels_without_samples(form: Format, folder: Path) -> None:
    """It is read, and has no span."""
    path = written(form, folder, [])
    log = read_log(path, form.logs, CHANNELS)
    assert (log.rows, log.first_us, log.last_us) == (0, None, None)
    assert [channel.time_us.size for channel in log.channels.values()] == [0, 0, 0]
    assert span_code(form, path) == "log_empty"


def a_column_or_topic_that_is_not_there_is_named_with_those_that_are(
    form: Format, folder: Path
) -> None:
    """An error that says what could be meant."""
    error = error_of(form, written(form, folder, many_rows(5), ["dp", "q"]))
    assert error.code == "log_column_missing"
    assert "'T'" in error.message
    assert "'dp'" in error.message or "'q'" in error.message


def stamps_of_a_clock_that_was_never_set_are_left_out_and_noted(form: Format, folder: Path) -> None:
    """Of most rows, they are an error."""
    never = [row(3_600_000_000 + i, 1.0) for i in range(9)]
    path = written(form, folder, [*never[:3], *pressures([2.0] * 7)])
    log = read_log(path, form.logs, CHANNELS)
    left_out = 3 if form.wide else 9
    assert log.channels["pressure_difference"].value.tolist() == [2.0] * 7
    assert log.refused_rows == left_out
    assert any(note.startswith(f"{left_out} ") and "time" in note for note in log.notes)
    assert log.first_us == T0_US
    assert time_span(path, form.logs, CHANNELS) == (T0_US, T0_US + 6 * STEP_US)
    path = written(form, folder, never)
    error = error_of(form, path)
    assert (error.code, span_code(form, path)) == ("log_time", "log_time")
    assert "1990" in error.message
    assert path.name in error.message


def stamps_in_the_future_are_left_out_and_most_of_them_an_error(form: Format, folder: Path) -> None:
    """So that a logger that was set to 2150 does not end all that comes after it."""
    good = pressures([2.0] * 7)
    ahead = [row(5_680_281_600_000_000 + i, 1.0) for i in range(3)]
    path = written(form, folder, [*good[:4], *ahead, *good[4:]])
    log = read_log(path, form.logs, CHANNELS)
    assert log.channels["pressure_difference"].value.tolist() == [2.0] * 7
    assert log.refused_rows == (3 if form.wide else 9)
    assert [note.split(" ", 2)[2] for note in log.notes] == [
        "with a time more than a day in the future"
    ]
    assert time_span(path, form.logs, CHANNELS) == (T0_US, T0_US + 6 * STEP_US)
    path = written(form, folder, [*good[:2], *ahead])
    error = error_of(form, path)
    assert (error.code, span_code(form, path)) == ("log_time", "log_time")
    assert "in the future" in error.message
    assert path.name in error.message


def what_is_no_log_at_all_is_refused(form: Format, folder: Path) -> None:
    """Nothing, a folder, an empty file, a name that no file can have."""
    (folder / "folder").mkdir()
    (folder / "empty").touch()
    for name, code in (
        ("nothing", "log_missing"),
        ("folder", "log_not_readable"),
        ("empty", "log_empty"),
    ):
        error = error_of(form, folder / name)
        assert (error.code, span_code(form, folder / name)) == (code, code)
        assert name in error.message
        assert str(pickle.loads(pickle.dumps(error))) == str(error)  # noqa: S301
    for name in ("a\0b", "x" * 5000):
        assert error_of(form, Path(name)).code in {"log_missing", "log_not_readable"}


def random_bytes_are_an_error(form: Format, folder: Path) -> None:
    """Of any size."""
    path = folder / "log"
    rng = random.Random(3)  # noqa: S311
    for size in (1, 7, 8, 12, 37, 64, 1000, 100_000):
        path.write_bytes(rng.randbytes(size))
        assert error_of(form, path).code != "log_reader"
        assert span_code(form, path) != "read"


def a_cut_file_is_an_error_or_its_whole_rows(form: Format, folder: Path) -> None:
    """A copy that was broken off is never taken for a whole log with other samples."""
    rows = many_rows(40)
    path = written(form, folder, rows)
    data = path.read_bytes()
    for length in chain(range(8, len(data), max(1, len(data) // 150)), [len(data) - 1]):
        path.write_bytes(data[:length])
        span_code(form, path)
        code = outcome(lambda: read_log(path, form.logs, CHANNELS))
        assert code in {"log_truncated", "log_damaged", "log_empty", "read"}
        if code != "read":
            continue
        assert form.has_whole_rows, f"{length} of {len(data)} bytes are read as a whole log"
        log = read_log(path, form.logs, CHANNELS)
        for name, channel in CHANNELS.items():
            assert samples(log, name) == expected(rows[: log.rows], channel.source)
        assert log.refused_rows <= 1


def a_flipped_bit_never_raises_anything_else(form: Format, folder: Path) -> None:
    """Where checksums cover all samples, it changes none."""
    path = written(form, folder, many_rows(40))
    data = path.read_bytes()
    whole = read_log(path, form.logs, CHANNELS)
    rng = random.Random(11)  # noqa: S311
    for _ in range(150):
        damaged = bytearray(data)
        damaged[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        path.write_bytes(damaged)
        span_code(form, path)
        code = outcome(lambda: read_log(path, form.logs, CHANNELS))
        if code == "read" and form.is_checked:
            require_equal(read_log(path, form.logs, CHANNELS), whole)


def checks_of(form: Format) -> tuple[Check, ...]:
    """Checks that apply to a format; each takes the format and an empty folder."""
    text = _OF_TEXT if form.holds_text else ()
    named = (a_log_without_rows_has_channels_without_samples,) if form.names_channels else ()
    damage = (a_flipped_bit_never_raises_anything_else,) if form.survives_damage else ()
    return (*_OF_ALL, *text, *named, *damage)


_OF_ALL: tuple[Check, ...] = (
    every_sample_comes_back_to_the_last_digit,
    a_channel_logged_less_often_is_missing_in_between_or_not_there,
    it_keeps_the_contract,
    scale_offset_and_unit_make_the_canonical_reading,
    a_reading_too_large_for_another_unit_is_not_finite,
    blank_and_null_are_missing_but_nan_and_infinity_are_readings,
    a_channel_that_is_null_throughout_is_missing_throughout,
    backward_and_repeated_time_stays_in_the_order_of_the_file,
    time_span_is_that_of_the_samples,
    a_column_or_topic_that_is_not_there_is_named_with_those_that_are,
    stamps_of_a_clock_that_was_never_set_are_left_out_and_noted,
    stamps_in_the_future_are_left_out_and_most_of_them_an_error,
    two_readings_are_equal_and_travel_between_processes,
    only_what_is_wanted_is_read,
    one_source_may_feed_two_channels,
    what_is_no_log_at_all_is_refused,
    random_bytes_are_an_error,
    a_cut_file_is_an_error_or_its_whole_rows,
)
_OF_TEXT: tuple[Check, ...] = (
    text_that_is_no_number_is_missing_and_counted,
    a_channel_without_one_number_is_an_error_of_type,
)
