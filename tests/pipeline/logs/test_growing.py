"""A log that is written to while it is read: left out, with its nights, until the next run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pipeline.logs.files
import pipeline.logs.motor_logs
from pipeline.config import load_fleet
from pipeline.config.hashes import config_hash
from pipeline.logs.files import change_of, look_at
from pipeline.setup.check import check_fleet
from tests.pipeline.calling import Call
from tests.pipeline.logs.growing_logs import MINUTES, ROWS, WRITERS, Cells, Logger, Site, logger
from tests.pipeline.simulated import NIGHT, load_motor, motor_toml, operate
from tests.pipeline.workshop import DAY, MINI, Workshop, check_same_figures


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
        """Half of one, too, which would fail."""
        site = site_of("parquet")
        self.configured(site, 3600.0)
        site.write(NIGHT)
        path = site.path(NIGHT)
        whole = path.read_bytes()
        path.write_bytes(whole[:-100])
        outcome = site.workshop.run()
        assert (outcome.status, outcome.nights, outcome.files["growing"]) == ("no_new_data", (), 1)
        assert "logs.settle_s is 3600" in outcome.growing[0]
        path.write_bytes(whole)
        an_hour_ago = path.stat().st_mtime - 3601
        os.utime(path, (an_hour_ago, an_hour_ago))
        assert site.workshop.run().nights == (NIGHT,)

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
    site_of: Callable[[str], Site], monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    site = site_of("csv")
    site.write(NIGHT)
    real = pipeline.logs.files.content_hash

    def hashed(path: Path) -> str:
        with path.open("a") as file:
            file.write("2026")
        return real(path)

    monkeypatch.setattr(pipeline.logs.files, "content_hash", hashed)
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
