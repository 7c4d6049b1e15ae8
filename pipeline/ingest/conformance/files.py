"""Checks of what a reader makes of times and files that are not as they should be."""

from __future__ import annotations

import pickle
import random
from itertools import chain
from pathlib import Path

from pipeline.ingest import read_log, time_span
from pipeline.ingest.conformance.formats import (
    CHANNELS,
    STEP_US,
    T0_US,
    Format,
    error_of,
    expected,
    many_rows,
    outcome,
    pressures,
    require_equal,
    row,
    samples,
    span_code,
    written,
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
