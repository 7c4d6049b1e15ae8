"""A log that is written to while it is read: left out, with its nights, until the next run."""

from __future__ import annotations

import datetime as dt
import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.writer import Writer

import pipeline.logs.files
import pipeline.logs.motor_logs
from pipeline.config import load_fleet
from pipeline.config.hashes import config_hash
from pipeline.logs.files import change_of, look_at
from pipeline.logs.ledger import read_ledger
from pipeline.setup.check import check_fleet
from tests.pipeline.simulated import CANONICAL, NIGHT, load_motor, motor_toml, operate
from tests.pipeline.workshop import DAY, MINI, Workshop, check_same_figures

MINUTES = 24.0
ROWS = round(MINUTES * 60)
PIECE = 60
PATIENCE_S = 60.0
Cells = dict[str, np.ndarray[Any, Any]]


def csv_writer(path: Path, cells: Cells) -> Iterator[None]:
    """Appends a minute of rows each time it is asked; what is written is on the disk."""
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(["time", *CANONICAL]) + "\n")
        for begin in range(0, ROWS, PIECE):
            for i in range(begin, begin + PIECE):
                moment = dt.datetime.fromtimestamp(cells["time"][i] / 1e6, dt.UTC)
                numbers = (repr(float(cells[name][i])) for name in CANONICAL)
                file.write(",".join([moment.isoformat(), *numbers]) + "\n")
            file.flush()
            yield


def parquet_writer(path: Path, cells: Cells) -> Iterator[None]:
    """Row group by row group; without its end it is no Parquet yet."""
    schema = pa.schema(
        [("time", pa.timestamp("us", "UTC")), *((name, pa.float64()) for name in CANONICAL)]
    )
    with path.open("wb") as file, pq.ParquetWriter(file, schema) as writer:
        for begin in range(0, ROWS, PIECE):
            part = {name: cells[name][begin : begin + PIECE] for name in ("time", *CANONICAL)}
            writer.write_table(
                pa.table({n: pa.array(v, schema.field(n).type) for n, v in part.items()})
            )
            file.flush()
            yield


def mcap_writer(path: Path, cells: Cells) -> Iterator[None]:
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1000)
        writer.start()
        schema = writer.register_schema("Value", "jsonschema", b'{"type": "object"}')
        ids = {name: writer.register_channel(name, "json", schema) for name in CANONICAL}
        for begin in range(0, ROWS, PIECE):
            for i in range(begin, begin + PIECE):
                for name in CANONICAL:
                    message = json.dumps({"value": float(cells[name][i])}).encode()
                    writer.add_message(ids[name], int(cells["time"][i]) * 1000, message, 0)
            file.flush()
            yield
        writer.finish()


WRITERS: dict[str, Callable[[Path, Cells], Iterator[None]]] = {
    "csv": csv_writer,
    "parquet": parquet_writer,
    "mcap": mcap_writer,
}
every_format = pytest.mark.parametrize("log_format", WRITERS)


@dataclass
class Logger:
    """Another thread that writes a log, a minute of it at a time, and then closes it."""

    steps: Iterator[None]
    may_write: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))
    has_written: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))

    def work(self) -> None:
        for _ in self.steps:
            self.has_written.release()
            self.may_write.acquire()
        self.has_written.release()

    def write(self, pieces: int = 1) -> None:
        """Have it write on, and wait until that is done."""
        for _ in range(pieces):
            self.may_write.release()
            assert self.has_written.acquire(timeout=PATIENCE_S)


@contextmanager
def logger(log_format: str, path: Path, cells: Cells) -> Iterator[Logger]:
    one = Logger(WRITERS[log_format](path, cells))
    thread = threading.Thread(target=one.work, daemon=True)
    thread.start()
    assert one.has_written.acquire(timeout=PATIENCE_S)
    yield one
    while thread.is_alive():  # to its end
        one.may_write.release()
        thread.join(0.01)


@dataclass(frozen=True)
class Site:
    """A motor of one format, and what it did in two nights."""

    workshop: Workshop
    log_format: str
    nights: dict[dt.date, Cells]

    def path(self, label: dt.date) -> Path:
        return self.workshop.logs / f"{label}.{self.log_format}"

    def write(self, label: dt.date) -> None:
        for _ in WRITERS[self.log_format](self.path(label), self.nights[label]):
            pass

    def known_files(self) -> set[str]:
        output = self.workshop.folder / "out"
        return set(read_ledger(output, "M1").files)


@pytest.fixture
def site_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Site]:
    def made(log_format: str) -> Site:
        folder = tmp_path_factory.mktemp(log_format)
        text = motor_toml("M1", "MINI", files=f'"M1/*.{log_format}"')
        text = text.replace('format = "parquet"', f'format = "{log_format}"')
        workshop = Workshop(folder)
        workshop.take(text)
        (spec,) = load_fleet(workshop.fleet).motors
        nights = {}
        for label in (NIGHT, NIGHT + DAY):
            moving = operate(label, MINUTES, label.day)
            flow = moving.flow(spec.motor(label, "none"))
            noise = np.random.default_rng(label.day).normal(0.0, 0.01, ROWS)
            nights[label] = {"time": moving.time_us, **moving.channels(flow + noise)}
        return Site(workshop, log_format, nights)

    return made


def writing_during(
    monkeypatch: pytest.MonkeyPatch, place: str, one: Logger, *, before: bool = False
) -> None:
    """Have the logger write on while a file of its is read, at one of the places that read."""
    module, name = place.rsplit(".", 1)
    real = getattr(sys.modules[module], name)

    def read(path: Path, *more: Any) -> Any:
        if before:
            one.write()
        try:
            return real(path, *more)
        finally:
            if not before:
                one.write()

    monkeypatch.setattr(place, read)


@pytest.mark.parametrize(
    ("log_format", "place", "before"),
    [
        # Each format, place and side at least once; the others in the full run.
        pytest.param(*one, marks=() if number % 5 == 0 else pytest.mark.full)
        for number, one in enumerate(
            product(
                WRITERS,
                [
                    "pipeline.logs.files.content_hash",
                    "pipeline.logs.files.time_span",
                    "pipeline.logs.motor_logs.read_log",
                ],
                [True, False],
            )
        )
    ],
)
def test_what_grows_waits_and_the_next_run_reads_it(
    site_of: Callable[[str], Site],
    monkeypatch: pytest.MonkeyPatch,
    log_format: str,
    place: str,
    before: bool,
) -> None:
    """Wherever it is when another thread writes on: looked at, hashed, or read."""
    site, undisturbed = site_of(log_format), site_of(log_format)
    site.write(NIGHT)
    workshop = site.workshop
    assert workshop.run().nights == (NIGHT,)
    with logger(log_format, site.path(NIGHT + DAY), site.nights[NIGHT + DAY]) as other:
        other.write(2)
        with monkeypatch.context() as patch:
            if place == "pipeline.logs.motor_logs.read_log":
                # What it has so far reads: a log that is whole and then written on.
                patch.setattr(
                    pipeline.logs.files, "time_span", lambda *_: ends(site.nights[NIGHT + DAY])
                )
            writing_during(patch, place, other, before=before)
            outcome = workshop.run()
        assert (outcome.status, outcome.error_code) == ("no_new_data", None)
        assert outcome.nights == ()
        assert {fate: n for fate, n in outcome.files.items() if n} == {"unchanged": 1, "growing": 1}
        (said,) = outcome.growing
        assert site.path(NIGHT + DAY).name in said
        assert "bytes while it was read; the next run reads it" in said
        assert site.known_files() == {f"M1/{site.path(NIGHT).name}"}
        assert workshop.statuses() == {NIGHT: "ok"}
        assert workshop.rows("input_files").height == 1
    assert workshop.run().nights == (NIGHT + DAY,)
    for label in (NIGHT, NIGHT + DAY):
        undisturbed.write(label)
    undisturbed.workshop.run()
    check_same_figures(workshop, undisturbed.workshop)


def ends(cells: Cells) -> tuple[int, int]:
    return int(cells["time"][0]), int(cells["time"][-1])


APPEND = """
import sys
rows = sys.stdin.read().splitlines(keepends=True)
print("ready", flush=True)
while True:
    for row in rows:
        with open(sys.argv[1], "a") as file:
            file.write(row)
"""


def test_another_process_that_never_rests(
    site_of: Callable[[str], Site], monkeypatch: pytest.MonkeyPatch
) -> None:
    site = site_of("csv")
    site.write(NIGHT)
    site.write(NIGHT + DAY)
    path = site.path(NIGHT + DAY)
    rows = path.read_text().splitlines(keepends=True)[1:]
    with subprocess.Popen(
        [sys.executable, "-c", APPEND, str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write("".join(rows[:20]))
        process.stdin.close()
        assert process.stdout.readline() == "ready\n"
        try:
            outcome = site.workshop.run()
        finally:
            process.kill()
    assert outcome.nights == (NIGHT,)
    assert outcome.files["growing"] == 1
    # At rest, whatever it holds now is read; the rows that came again are duplicates.
    assert site.workshop.run().nights == (NIGHT + DAY,)


def test_a_night_with_a_growing_log_waits_as_a_whole(
    site_of: Callable[[str], Site], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half a night would be published, and corrected by the next run."""
    site = site_of("parquet")
    site.write(NIGHT)
    workshop = site.workshop
    site.write(NIGHT + DAY)
    more = workshop.logs / f"{NIGHT + DAY}_2.parquet"
    first_us, last_us = ends(site.nights[NIGHT + DAY])
    later = dict(site.nights[NIGHT + DAY]) | {
        "time": site.nights[NIGHT + DAY]["time"] + (last_us - first_us) + 1_000_000
    }
    with logger("parquet", more, later) as other, monkeypatch.context() as patch:
        real = pipeline.logs.files.content_hash

        def hashed(path: Path) -> str:
            found = real(path)
            if path == more:
                other.write()
            return found

        patch.setattr(pipeline.logs.files, "content_hash", hashed)
        outcome = workshop.run()
        assert outcome.nights == (NIGHT,)
        assert {fate: n for fate, n in outcome.files.items() if n} == {
            "read": 1,
            "growing": 1,
            "left": 1,
        }
    outcome = workshop.run()
    assert outcome.nights == (NIGHT + DAY,)
    assert {fate: n for fate, n in outcome.files.items() if n} == {"read": 2, "unchanged": 1}


def test_what_is_published_of_a_log_stays_while_it_grows(
    site_of: Callable[[str], Site], monkeypatch: pytest.MonkeyPatch
) -> None:
    site = site_of("csv")
    site.write(NIGHT)
    site.workshop.run()
    before = site.workshop.rows("fits")
    path = site.path(NIGHT)
    whole = path.read_bytes()
    path.write_bytes(whole + whole.splitlines(keepends=True)[-1])
    real = pipeline.logs.motor_logs.read_log

    def read(path: Path, *source: Any) -> Any:
        log = real(path, *source)
        with path.open("ab") as file:
            file.write(b"half a ro")
        return log

    with monkeypatch.context() as patch:
        patch.setattr(pipeline.logs.motor_logs, "read_log", read)
        outcome = site.workshop.run()
    assert (outcome.nights, outcome.files["growing"]) == ((), 1)
    assert site.workshop.rows("fits").equals(before)
    assert site.workshop.run().nights == (NIGHT,)


def test_nights_that_an_earlier_state_of_a_log_was_read_for_wait_too(
    site_of: Callable[[str], Site], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A log over a border, dropped from memory between its nights, and changed when read again."""
    site = site_of("parquet")
    moved = {
        label: cells | {"time": cells["time"] + round((8 * 60 - MINUTES / 2) * 60e6)}
        for label, cells in site.nights.items()
    }
    over_border = Site(site.workshop, "parquet", moved)
    over_border.write(NIGHT)
    path = over_border.path(NIGHT)
    real = pipeline.logs.motor_logs.read_log
    monkeypatch.setattr(pipeline.logs.motor_logs, "LOGS_IN_MEMORY", 0)
    reads: list[Path] = []

    def read(at: Path, *source: Any) -> Any:
        reads.append(at)
        if reads.count(path) == 2:
            os.utime(at, (1, 1))
        return real(at, *source)

    monkeypatch.setattr(pipeline.logs.motor_logs, "read_log", read)
    outcome = site.workshop.run()
    assert (outcome.nights, outcome.inputs) == ((), ())
    assert site.workshop.rows("fits").is_empty()
    assert site.workshop.run().nights == (NIGHT, NIGHT + DAY)


class TestChangeOf:
    def test_size_time_and_the_file_itself(self, tmp_path: Path) -> None:
        path = tmp_path / "a.csv"
        path.write_text("time,n\n")
        record = look_at("a.csv", path)
        assert change_of(record, path) is None
        os.utime(path, ns=(0, record.modified_ns + 1))
        why = change_of(record, path)
        assert why is not None
        assert (why.code, "it changed while" in why.message) == ("log_growing", True)
        with path.open("a") as file:
            file.write("x")
        os.utime(path, ns=(0, record.modified_ns))
        why = change_of(record, path)
        assert "went from 7 to 8 bytes" in str(why)

    def test_another_file_of_the_same_size_and_time(self, tmp_path: Path) -> None:
        path, new = tmp_path / "a.csv", tmp_path / "new"
        path.write_text("time,n\n")
        record = look_at("a.csv", path)
        new.write_text("time,m\n")
        os.utime(new, ns=(0, record.modified_ns))
        new.replace(path)
        assert change_of(record, path) is not None

    def test_one_that_is_gone_has_not_changed(self, tmp_path: Path) -> None:
        path = tmp_path / "a.csv"
        path.write_text("time,n\n")
        record = look_at("a.csv", path)
        path.unlink()
        assert change_of(record, path) is None


class TestSettling:
    """`logs.settle_s`: a file may rest between two pieces, and not be whole all the same."""

    def configured(self, site: Site, settle_s: float) -> None:
        text = motor_toml("M1", "MINI").replace(
            'format = "parquet"', f'format = "parquet"\nsettle_s = {settle_s}'
        )
        site.workshop.take(text)

    def test_a_file_written_to_a_moment_ago_waits(self, site_of: Callable[[str], Site]) -> None:
        site = site_of("parquet")
        self.configured(site, 3600.0)
        site.write(NIGHT)
        outcome = site.workshop.run()
        assert (outcome.nights, outcome.files["growing"]) == ((), 1)
        assert "logs.settle_s is 3600" in outcome.growing[0]
        path = site.path(NIGHT)
        an_hour_ago = path.stat().st_mtime - 3601
        os.utime(path, (an_hour_ago, an_hour_ago))
        assert site.workshop.run().nights == (NIGHT,)

    def test_a_half_written_one_does_not_fail_meanwhile(
        self, site_of: Callable[[str], Site]
    ) -> None:
        site = site_of("parquet")
        self.configured(site, 3600.0)
        site.write(NIGHT)
        whole = site.path(NIGHT).read_bytes()
        site.path(NIGHT).write_bytes(whole[:-100])
        assert site.workshop.run().status == "no_new_data"
        self.configured(site, 0.0)
        outcome = site.workshop.run()
        assert (outcome.status, outcome.error_code) == ("failed", "log_truncated")

    def test_a_clock_far_ahead_keeps_no_file_out(self, site_of: Callable[[str], Site]) -> None:
        site = site_of("parquet")
        self.configured(site, 60.0)
        site.write(NIGHT)
        ahead = site.path(NIGHT).stat().st_mtime + 86_400
        os.utime(site.path(NIGHT), (ahead, ahead))
        assert site.workshop.run().nights == (NIGHT,)

    def test_what_was_read_stays_read_and_no_figure_depends_on_it(
        self, site_of: Callable[[str], Site]
    ) -> None:
        site = site_of("parquet")
        site.write(NIGHT)
        site.workshop.run()
        self.configured(site, 3600.0)
        outcome = site.workshop.run()
        assert (outcome.nights, outcome.files["unchanged"]) == ((), 1)

    def test_it_is_off_unless_asked_for(self, tmp_path: Path) -> None:
        spec = load_motor(tmp_path, motor_toml("M1", "MINI"), {"MINI": MINI})
        assert spec.file.logs.settle_s == 0.0
        later = spec.file.logs.model_copy(update={"settle_s": 9.0})
        other = replace(spec, file=spec.file.model_copy(update={"logs": later}))
        assert config_hash(other) == config_hash(spec)


def test_the_check_notes_it_and_calls_it_no_fault(
    site_of: Callable[[str], Site], monkeypatch: pytest.MonkeyPatch
) -> None:
    site = site_of("csv")
    site.write(NIGHT)
    real = pipeline.setup.check.spanned

    def spanned(record: Any, path: Path, spec: Any) -> Any:
        found = real(record, path, spec)
        with path.open("a") as file:
            file.write("2026")
        return found

    monkeypatch.setattr(pipeline.setup.check, "spanned", spanned)
    (found,) = check_fleet(load_fleet(site.workshop.fleet))
    assert found.faults == ()
    assert any(note.startswith("log_growing: ") for note in found.notes)


def test_the_command_says_so_and_ends_with_0(
    site_of: Callable[[str], Site],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from pipeline import cli

    site = site_of("csv")
    site.write(NIGHT)
    real = pipeline.logs.files.content_hash

    def hashed(path: Path) -> str:
        with path.open("a") as file:
            file.write("2026")
        return real(path)

    def call(*arguments: str) -> tuple[object, str, str]:
        with monkeypatch.context() as patch:
            patch.setattr(pipeline.logs.files, "content_hash", hashed)
            patch.setattr(sys, "argv", ["motor-leakage", *arguments])
            with pytest.raises(SystemExit) as ended:
                cli.main()
        out, err = capsys.readouterr()
        return ended.value.code, out, err

    fleet = str(site.workshop.fleet)
    code, out, err = call("fit-fleet", fleet)
    assert code == 0
    assert "logs: 0 read, 0 unchanged, 1 growing, 0 failed, 0 left" in out
    assert err.startswith(f"M1: log_growing: {NIGHT}.csv: it went from ")
    _, out, _ = call("fit-fleet", fleet, "--json")
    motor, run = map(json.loads, out.splitlines())
    assert motor["files"] == run["files"]
    assert motor["files"]["growing"] == 1
    assert f"{NIGHT}.csv" in motor["growing"][0]
    outcomes = site.workshop.rows("motor_outcomes")
    assert outcomes["n_files_growing"].to_list() == [1, 1]
    assert outcomes["growing"].to_list()[0][0].startswith(f"{NIGHT}.csv: ")
    code, out, err = call("fit", fleet, "M1", str(NIGHT))
    assert (code, out) == (4, "")
    assert "log_growing: the night waits" in err
