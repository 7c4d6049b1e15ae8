"""The kit: what every reader of every format has to do alike."""

from __future__ import annotations

import pickle
import random
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from pipeline.config.motors import Channels
from pipeline.errors import LogError
from pipeline.ingest import RawLog, read_log, time_span

from .sources import Source, changed, column
from .writers import CHANNELS, FORMATS, STEP_US, T0_US, Format, Row, many_rows

NAMES = ["dp", "T", "q"]
PRESSURE: Channels = {"pressure_difference": CHANNELS["pressure_difference"]}


def formats(chosen: Sequence[Format]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("form", chosen, ids=lambda form: form.name)


every_format = formats(FORMATS)
formats_of_text = formats([form for form in FORMATS if form.holds_text])
formats_that_name_channels = formats([form for form in FORMATS if form.names_channels])


def written(form: Format, folder: Path, rows: Sequence[Row], names: Sequence[str] = NAMES) -> Path:
    path = folder / f"log.{form.source.logs.format}"
    form.write(path, rows, names)
    return path


def samples(log: RawLog, channel: str) -> list[tuple[int, float]]:
    """Samples of a channel that are not missing."""
    raw = log.channels[channel]
    pairs = zip(raw.time_us[~raw.missing], raw.value[~raw.missing], strict=True)
    return [(int(time), float(value)) for time, value in pairs]


def expected(rows: Sequence[Row], name: str) -> list[tuple[int, float]]:
    cells = ((row.time_us, row.cells.get(name)) for row in rows)
    return [(time, cell) for time, cell in cells if isinstance(cell, float)]


def assert_equal(one: RawLog, other: RawLog) -> None:
    assert (one.rows, one.first_us, one.last_us) == (other.rows, other.first_us, other.last_us)
    assert one.channels.keys() == other.channels.keys()
    for name, channel in one.channels.items():
        np.testing.assert_array_equal(channel.time_us, other.channels[name].time_us)
        np.testing.assert_array_equal(channel.value, other.channels[name].value)
        np.testing.assert_array_equal(channel.missing, other.channels[name].missing)
        assert channel.unparsed == other.channels[name].unparsed


def outcome(read: Callable[[], object]) -> str:
    """Either "read", or the code of the error; no other exception passes."""
    try:
        read()
    except LogError as error:
        return error.code
    return "read"


@every_format
def test_every_sample_comes_back_to_the_last_digit(form: Format, tmp_path: Path) -> None:
    rows = many_rows()
    log = read_log(written(form, tmp_path, rows), *form.source)
    assert list(log.channels) == list(CHANNELS)
    for name, channel in CHANNELS.items():
        assert samples(log, name) == expected(rows, channel.source)
        assert log.channels[name].unparsed == 0
    assert (log.notes, log.refused_rows) == ((), 0)


@every_format
def test_a_channel_logged_less_often_is_missing_in_between_or_not_there(
    form: Format, tmp_path: Path
) -> None:
    rows = many_rows()
    log = read_log(written(form, tmp_path, rows), *form.source)
    temperature = log.channels["oil_temperature"]
    assert temperature.time_us.size == (200 if form.wide else 20)
    assert temperature.missing.sum() == (180 if form.wide else 0)
    assert np.isnan(temperature.value[temperature.missing]).all()
    assert log.rows == (200 if form.wide else 420)


@every_format
def test_arrays_have_the_types_of_the_contract_and_cannot_be_written(
    form: Format, tmp_path: Path
) -> None:
    log = read_log(written(form, tmp_path, many_rows()), *form.source)
    for channel in log.channels.values():
        for values, dtype in (
            (channel.time_us, np.int64),
            (channel.value, np.float64),
            (channel.missing, np.bool_),
        ):
            assert values.dtype == dtype
            assert values.ndim == 1
            assert values.size == channel.time_us.size
            with pytest.raises(ValueError, match="read-only"):
                values[0] = 0


@every_format
def test_scale_offset_and_unit_make_the_canonical_reading(form: Format, tmp_path: Path) -> None:
    # A 4–20 mA transmitter for 0–400 bar, here in psi; a thermometer in °F; a meter in US gallons.
    channels = {
        "pressure_difference": column("dp", "psi", scale=362.5943, offset=-1450.377),
        "oil_temperature": column("T", "degF"),
        "leakage_flow": column("q", "us_gal/min"),
    }
    path = written(form, tmp_path, [Row(T0_US, {"dp": 12.0, "T": 122.0, "q": 1.0})])
    log = read_log(path, *form.source.but(channels=channels))
    assert log.channels["pressure_difference"].value == pytest.approx([200.0], rel=1e-6)
    assert log.channels["oil_temperature"].value == pytest.approx([50.0])
    assert log.channels["leakage_flow"].value == pytest.approx([3.785411784])


@every_format
def test_a_reading_too_large_for_another_unit_is_not_finite(form: Format, tmp_path: Path) -> None:
    channels = {"leakage_flow": column("q", "m3/s", scale=10.0)}
    path = written(form, tmp_path, [Row(T0_US, {"dp": 1.0, "T": 1.0, "q": 1e308})])
    log = read_log(path, *form.source.but(channels=channels))
    assert log.channels["leakage_flow"].value.tolist() == [np.inf]


@every_format
def test_blank_and_null_are_missing_but_nan_and_infinity_are_readings(
    form: Format, tmp_path: Path
) -> None:
    values = [1.0, None, float("nan"), float("inf"), float("-inf"), 2.0]
    rows = [
        Row(T0_US + i * STEP_US, {"dp": value, "T": 50.0, "q": 1.0})
        for i, value in enumerate(values)
    ]
    channel = read_log(written(form, tmp_path, rows), *form.source).channels["pressure_difference"]
    assert channel.missing.tolist() == [False, True, False, False, False, False]
    np.testing.assert_array_equal(
        channel.value, [1.0, np.nan, np.nan, np.inf, -np.inf, 2.0], strict=True
    )
    assert channel.unparsed == 0


@formats_of_text
def test_text_that_is_no_number_is_missing_and_counted(form: Format, tmp_path: Path) -> None:
    cells = [1.0, "ERR", 2.0, "1.2.3", None, "0x10", "true", 3.0]
    rows = [Row(T0_US + i * STEP_US, {"dp": c, "T": 5.0, "q": 1.0}) for i, c in enumerate(cells)]
    log = read_log(written(form, tmp_path, rows), *form.source)
    channel = log.channels["pressure_difference"]
    assert channel.unparsed == 4
    assert channel.value[~channel.missing].tolist() == [1.0, 2.0, 3.0]
    assert channel.missing.sum() == 5
    assert log.channels["leakage_flow"].unparsed == 0


@formats_of_text
def test_a_channel_without_one_number_is_an_error_of_type(form: Format, tmp_path: Path) -> None:
    rows = [Row(T0_US + i, {"dp": "broken wire", "T": 50.0, "q": 1.0}) for i in range(5)]
    with pytest.raises(LogError, match=r"'broken wire'") as error:
        read_log(written(form, tmp_path, rows), *form.source)
    assert error.value.code == "log_type"


@every_format
def test_a_channel_that_is_null_throughout_is_missing_throughout(
    form: Format, tmp_path: Path
) -> None:
    rows = [Row(T0_US + i * STEP_US, {"dp": None, "T": 50.0, "q": 1.0}) for i in range(5)]
    log = read_log(written(form, tmp_path, rows), *form.source)
    assert log.channels["pressure_difference"].missing.all()
    assert log.channels["pressure_difference"].unparsed == 0
    assert not log.channels["leakage_flow"].missing.any()


@every_format
def test_backward_and_repeated_time_stays_in_the_order_of_the_file(
    form: Format, tmp_path: Path
) -> None:
    offsets = [0, 5, 3, 3, 9, 1]
    rows = [
        Row(T0_US + offset * STEP_US, {"dp": float(i), "T": 50.0, "q": 1.0})
        for i, offset in enumerate(offsets)
    ]
    log = read_log(written(form, tmp_path, rows), *form.source)
    channel = log.channels["pressure_difference"]
    assert ((channel.time_us - T0_US) // STEP_US).tolist() == offsets
    assert channel.value.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert (log.first_us, log.last_us) == (T0_US, T0_US + 9 * STEP_US)


@every_format
def test_time_span_is_that_of_the_samples(form: Format, tmp_path: Path) -> None:
    rows = many_rows(3000)
    path = written(form, tmp_path, rows)
    log = read_log(path, *form.source)
    span = (T0_US, T0_US + 2999 * STEP_US)
    assert time_span(path, *form.source) == (log.first_us, log.last_us) == span


@formats_that_name_channels
def test_a_log_without_rows_has_channels_without_samples(form: Format, tmp_path: Path) -> None:
    path = written(form, tmp_path, [])
    log = read_log(path, *form.source)
    assert (log.rows, log.first_us, log.last_us) == (0, None, None)
    assert [channel.time_us.size for channel in log.channels.values()] == [0, 0, 0]
    with pytest.raises(LogError) as error:
        time_span(path, *form.source)
    assert error.value.code == "log_empty"


@every_format
def test_a_column_or_topic_that_is_not_there_is_named_with_those_that_are(
    form: Format, tmp_path: Path
) -> None:
    path = written(form, tmp_path, many_rows(5), ["dp", "q"])
    with pytest.raises(LogError, match=r"'T'.*'dp'.*|'T'.*'q'.*") as error:
        read_log(path, *form.source)
    assert error.value.code == "log_column_missing"


@every_format
def test_stamps_of_a_clock_that_was_never_set_are_left_out_and_noted(
    form: Format, tmp_path: Path
) -> None:
    rows = [Row(3_600_000_000 + i, {"dp": 1.0, "T": 50.0, "q": 1.0}) for i in range(3)]
    rows += [Row(T0_US + i * STEP_US, {"dp": 2.0, "T": 50.0, "q": 1.0}) for i in range(7)]
    path = written(form, tmp_path, rows)
    log = read_log(path, *form.source)
    left_out = 3 if form.wide else 9
    assert log.channels["pressure_difference"].value.tolist() == [2.0] * 7
    assert log.refused_rows == left_out
    assert any(note.startswith(f"{left_out} ") and "time" in note for note in log.notes)
    assert log.first_us == T0_US
    assert time_span(path, *form.source) == (T0_US, T0_US + 6 * STEP_US)


@every_format
def test_a_clock_that_was_never_set_at_all_is_an_error_of_time(
    form: Format, tmp_path: Path
) -> None:
    rows = [Row(3_600_000_000 + i, {"dp": 1.0, "T": 50.0, "q": 1.0}) for i in range(9)]
    path = written(form, tmp_path, rows)
    for read in (read_log, time_span):
        with pytest.raises(LogError, match="1990") as error:
            read(path, *form.source)
        assert error.value.code == "log_time"
        assert path.name in error.value.message


@every_format
def test_stamps_in_the_future_are_left_out_and_most_of_them_an_error(
    form: Format, tmp_path: Path
) -> None:
    """So that a logger that was set to 2099 does not end all that comes after it."""
    ahead_us = 5_680_281_600_000_000  # 2150-01-01
    good = [Row(T0_US + i * STEP_US, {"dp": 2.0, "T": 50.0, "q": 1.0}) for i in range(7)]
    ahead = [Row(ahead_us + i, {"dp": 1.0, "T": 50.0, "q": 1.0}) for i in range(3)]
    path = written(form, tmp_path, [*good[:4], *ahead, *good[4:]])
    log = read_log(path, *form.source)
    left_out = 3 if form.wide else 9
    assert log.channels["pressure_difference"].value.tolist() == [2.0] * 7
    assert log.refused_rows == left_out
    what = "rows" if form.wide else "messages"
    assert log.notes == (f"{left_out} {what} with a time more than a day in the future",)
    assert time_span(path, *form.source) == (T0_US, T0_US + 6 * STEP_US)
    path = written(form, tmp_path, [*good[:2], *ahead])
    for read in (read_log, time_span):
        with pytest.raises(LogError, match="in the future") as error:
            read(path, *form.source)
        assert error.value.code == "log_time"
        assert path.name in error.value.message


@every_format
def test_two_readings_are_equal_and_travel_between_processes(form: Format, tmp_path: Path) -> None:
    path = written(form, tmp_path, many_rows())
    log = read_log(path, *form.source)
    assert_equal(log, read_log(path, *form.source))
    assert_equal(log, pickle.loads(pickle.dumps(log)))  # noqa: S301


@every_format
def test_only_what_is_wanted_is_read(form: Format, tmp_path: Path) -> None:
    path = written(form, tmp_path, many_rows())
    log = read_log(path, *form.source.but(channels=PRESSURE))
    assert list(log.channels) == ["pressure_difference"]
    assert log.rows == 200


@every_format
def test_one_source_may_feed_two_channels(form: Format, tmp_path: Path) -> None:
    channels = {"high_port_pressure": column("dp", "kPa"), **PRESSURE}
    path = written(form, tmp_path, many_rows())
    log = read_log(path, *form.source.but(channels=channels))
    np.testing.assert_allclose(
        log.channels["high_port_pressure"].value * 100.0,
        log.channels["pressure_difference"].value,
        rtol=1e-12,
    )


@every_format
@pytest.mark.parametrize(
    ("place", "code"),
    [("nothing", "log_missing"), ("folder", "log_not_readable"), ("empty", "log_empty")],
)
def test_what_is_no_log_at_all(form: Format, tmp_path: Path, place: str, code: str) -> None:
    path = tmp_path / place
    if place == "folder":
        path.mkdir()
    elif place == "empty":
        path.touch()
    for read in (read_log, time_span):
        with pytest.raises(LogError, match=place) as error:
            read(path, *form.source)
        assert error.value.code == code
        assert str(pickle.loads(pickle.dumps(error.value))) == str(error.value)  # noqa: S301


@every_format
def test_a_name_that_no_file_can_have(form: Format) -> None:
    for name in ("a\0b", "x" * 5000):
        assert outcome(lambda name=name: read_log(Path(name), *form.source)) in {
            "log_missing",
            "log_not_readable",
        }


@every_format
def test_random_bytes_are_an_error(form: Format, tmp_path: Path) -> None:
    path = tmp_path / "log"
    rng = random.Random(3)  # noqa: S311
    for size in (1, 7, 8, 12, 37, 64, 1000, 100_000):
        path.write_bytes(rng.randbytes(size))
        assert outcome(lambda: read_log(path, *form.source)) != "read"
        assert outcome(lambda: time_span(path, *form.source)) != "read"


@every_format
def test_a_log_of_another_format_is_an_error(form: Format, tmp_path: Path) -> None:
    for other in FORMATS:
        if other.source.logs.format != form.source.logs.format:
            path = written(other, tmp_path, many_rows(20))
            assert outcome(lambda path=path: read_log(path, *form.source)) != "read"
            assert outcome(lambda path=path: time_span(path, *form.source)) != "read"


@every_format
def test_a_cut_file_is_an_error_or_its_whole_rows(form: Format, tmp_path: Path) -> None:
    rows = many_rows(40)
    path = written(form, tmp_path, rows)
    data = path.read_bytes()
    for length in [*range(8, len(data), max(1, len(data) // 150)), len(data) - 1]:
        path.write_bytes(data[:length])
        outcome(lambda: time_span(path, *form.source))
        code = outcome(lambda: read_log(path, *form.source))
        assert code in {"log_truncated", "log_damaged", "log_empty", "read"}
        if code != "read":
            continue
        assert form.source.logs.format == "csv"
        log = read_log(path, *form.source)
        for name, channel in CHANNELS.items():
            assert samples(log, name) == expected(rows[: log.rows], channel.source)
        assert log.refused_rows <= 1


@every_format
def test_a_flipped_bit_never_raises_anything_else(form: Format, tmp_path: Path) -> None:
    path = written(form, tmp_path, many_rows(40))
    data = path.read_bytes()
    whole = read_log(path, *form.source)
    rng = random.Random(11)  # noqa: S311
    for _ in range(150):
        damaged = bytearray(data)
        damaged[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        path.write_bytes(damaged)
        outcome(lambda: time_span(path, *form.source))
        try:
            log = read_log(path, *form.source)
        except LogError:
            continue
        if form.is_checked:
            assert_equal(log, whole)


@pytest.mark.parametrize(
    "wrong",
    [
        {"source": ""},
        {"scale": 0.0},
        {"scale": float("inf")},
        {"offset": float("nan")},
    ],
    ids=str,
)
def test_channels_that_cannot_be_read_are_refused_when_they_are_named(
    wrong: dict[str, Any],
) -> None:
    with pytest.raises(ValidationError, match=r"\w"):
        changed(CHANNELS["pressure_difference"], **wrong)


@pytest.mark.parametrize(
    "wrong",
    [
        {"format": "xlsx"},
        {"separator": ";;"},
        {"separator": '"'},
        {"separator": "·"},
        {"decimal": ","},
        {"decimal": ";"},
        {"skip_rows": -1},
        {"unit_rows": -1},
        {"thousands": "x"},
        {"thousands": ","},
        {"thousands": "."},
        {"layout": "tall"},
        {"encoding": "klingon"},
        {"encoding": "rot13"},
        {"time_zone": "Mars/Olympus"},
        {"time_zone": "../../etc/passwd"},
        {"time_zone": ""},
        {"time_format": "%H:%M:%S"},
        {"time_format": "%Y-%m-%d"},
        {"time_format": "%Y-%m-%d %q"},
        {"time_format": "%Y-%m-%d %H:%M:%S %f"},
        {"time_format": "%d.%m.%Y %I:%M"},
        {"time_format": "epoch"},
        {"time_format": ""},
    ],
    ids=str,
)
def test_sources_that_cannot_work_are_refused_when_they_are_made(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match=r"\w"):
        Source.of("csv", CHANNELS).but(**wrong)
