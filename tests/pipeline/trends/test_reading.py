"""Stored nights of a motor save reading and fitting, and change no byte."""

from __future__ import annotations

import datetime as dt
import hashlib
import shutil
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import polars as pl
import pytest

from pipeline.config import load_fleet
from pipeline.errors import StoreError
from pipeline.run.fleet import RunRequest, run_fleet
from pipeline.run.verification import verify_tables
from pipeline.schema import ALARMS, BLOCK_STATISTICS, FITS, TREND_TABLES, Table
from pipeline.store.encoding import write_table
from pipeline.store.retention import old_files, prune
from pipeline.store.tables import night_file, read_rows
from pipeline.trends import stage
from pipeline.trends.nights import kept_nights, reading
from pipeline.trends.nights.decisions import record_decision
from pipeline.trends.nights.reading import read_nights
from pipeline.trends.nights.tonight import Tonight
from pipeline.trends.nights.trend_record import note_touched
from tests.pipeline.simulated import motor_toml, write_configs
from tests.pipeline.trends.blocks import POOR, blocks_of
from tests.pipeline.trends.nights import Nights, night_of, publish, ramp, reset

QUICK = '[estimation]\nstarting_points = 0\n[execution]\nbackend = "sequential"\n'
# Too few samples for any fit: what they are worth is in their blocks alone.
NOTHING = POOR | {
    "status": "insufficient_data",
    "reason": "24 minutes",
    "n_training": None,
    "sample_period_s": None,
    "model_hash": None,
}


def configure(folder: Path, motors: Collection[str] = ("M1", "M2"), more: str = "") -> Path:
    """Motors on one tank."""
    texts = {
        name: motor_toml(name).replace("[logs]", 'oil_circuit = "tank"\n[logs]') for name in motors
    }
    header = 'name = "Tests"\n[folders]\nlogs = "../logs"\noutput = "../out"\n'
    for path in (folder / "configs" / "motors").glob("*.toml"):
        path.unlink()
    return write_configs(folder, texts, fleet=f"{header}{QUICK}{more}")


@dataclass
class Fleet:
    """Two motors with poor nights, whose rows are published night by night.

    Parameters
    ----------
    folder
        Of its config and output.
    forgetful
        Whether nothing is kept from run to run.
    before
        Nights before those of which something is to be told; with thirty there are baselines.
    """

    folder: Path
    forgetful: bool = False
    before: int = 0
    motors: dict[str, Nights] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.config = configure(self.folder)
        m1, m2 = load_fleet(self.config).motors
        n = self.before + 24

        def these(*places: int) -> dict[int, dict[str, Any]]:
            return dict.fromkeys((self.before + place for place in places), POOR)

        nothing = dict.fromkeys(these(6, 7, 8, 19, 20, 21), NOTHING)
        zero = 0.05 * (np.arange(n) >= self.before + 12) + 0.001 * np.cos(np.arange(n))
        self.motors = {
            # Poor nights in rows, one of them across the end of the first run; and no log.
            "M1": Nights(
                m1,
                n,
                {"piston_ring": ramp(n, self.before + 9, 0.5)},
                changes=these(3, 4, 5, 9, 10, 11, 12, 13, 16, 17, 18) | nothing,
                absent=frozenset((self.before + 1, self.before + 14)),
                operation={"flow_zero_l_per_min": zero},
            ),
            "M2": Nights(m2, n, seed=2, changes=these(19, 20, 21)),
        }

    @property
    def output(self) -> Path:
        return self.folder / "out"

    def publish(self, *places: int) -> None:
        """Publish some nights of all motors, which count from those before."""
        labels = [night_of(self.before + place) for place in places]
        frames = [one.frames() for one in self.motors.values()]
        whole = {name: pl.concat([one[name] for one in frames]) for name in frames[0]}
        here = pl.col("night").is_in(labels)
        publish(self.output, {name: rows.filter(here) for name, rows in whole.items()})
        blocks = pl.concat([blocks_of(one) for one in self.motors.values()])
        for (night,), part in blocks.filter(here).partition_by("night", as_dict=True).items():
            write_table(
                night_file(self.output, BLOCK_STATISTICS, night), part.sort(BLOCK_STATISTICS.key)
            )

    def run(self) -> None:
        if self.forgetful:
            shutil.rmtree(self.output / "history", ignore_errors=True)
        assert run_fleet(RunRequest(load_fleet(self.config))).failed == ()

    def tables(self) -> dict[str, str]:
        """SHA-256 of the files of trends."""
        root = self.output / "tables"
        return {
            path.relative_to(root).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
            for table in TREND_TABLES
            for path in sorted((root / table.name).rglob("*.parquet"))
        }

    def kept(self) -> list[Path]:
        return sorted(path for path in (self.output / "history").rglob("*") if path.is_file())


def first(fleet: Fleet) -> None:
    fleet.publish(*range(-fleet.before, 17))


def night(place: int) -> Callable[[Fleet], None]:
    return lambda fleet: fleet.publish(place)


def late_log(fleet: Fleet) -> None:
    """Of a night amid groups of the first motor, which is not poor any more."""
    old = fleet.motors["M1"]
    changes = {place: one for place, one in old.changes.items() if place != fleet.before + 10}
    fleet.motors["M1"] = replace(old, changes=changes)
    fleet.publish(10)
    note_touched(fleet.output, "M1", night_of(fleet.before + 10))


def late_log_of_the_other(fleet: Fleet) -> None:
    """In files that hold poor nights of the first motor."""
    changes = fleet.motors["M2"].changes
    poor = dict.fromkeys((fleet.before + 12, fleet.before + 13), POOR)
    fleet.motors["M2"] = replace(fleet.motors["M2"], changes={**changes, **poor})
    fleet.publish(12, 13)
    note_touched(fleet.output, "M2", night_of(fleet.before + 12))


def refit(fleet: Fleet) -> None:
    """Rows of many nights anew, with other figures."""
    fleet.motors = {name: replace(one, seed=one.seed + 5) for name, one in fleet.motors.items()}
    fleet.publish(*range(8, 19))
    for name in fleet.motors:
        note_touched(fleet.output, name, night_of(fleet.before + 8))


def written_anew(fleet: Fleet) -> None:
    """The same rows in other files, and a night more."""
    fleet.publish(*range(8, 20))


def a_reset_and_a_setting(fleet: Fleet) -> None:
    """And a motor less."""
    record_decision(fleet.output, reset(fleet.before + 4))
    configure(fleet.folder, ["M1"], more="[trend]\nbaseline_nights = 40\n")


def damaged(fleet: Fleet) -> None:
    for number, path in enumerate(fleet.kept()):
        whole = bytearray(path.read_bytes())
        whole[(len(whole) * (number % 7)) // 7] ^= 4
        path.write_bytes(whole[: len(whole) // 2] if number % 3 == 1 else whole)
    fleet.publish(20)


def pruned(fleet: Fleet) -> None:
    """The blocks of the older nights: those too poor alone have no figures any more."""
    prune(
        fleet.output, old_files(fleet.output, {"block_statistics": 8}, night_of(fleet.before + 20))
    )
    fleet.publish(21)


def a_lost_file(fleet: Fleet) -> None:
    """Of a night long ago."""
    night_file(fleet.output, FITS, night_of(fleet.before + 6)).unlink()
    fleet.publish(22)


def and_back(fleet: Fleet) -> None:
    configure(fleet.folder)
    fleet.publish(23)


STEPS: tuple[Callable[[Fleet], None], ...] = (
    night(17),
    night(18),
    late_log,
    late_log_of_the_other,
    refit,
    written_anew,
    damaged,
    pruned,
    a_reset_and_a_setting,
    a_lost_file,
    and_back,
)


@pytest.mark.parametrize(
    ("settled_ns", "before", "steps_a_run"),
    [
        # The nights lie in two months.
        pytest.param(0, 8, 2, id="folders tell"),
        pytest.param(0, 8, 1, id="folders tell each step", marks=pytest.mark.full),
        pytest.param(kept_nights.SETTLED_NS, 8, 1, id="files tell", marks=pytest.mark.full),
        pytest.param(0, 30, 1, id="with baselines", marks=pytest.mark.full),
    ],
)
def test_whatever_happens_the_bytes_are_those_without_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, settled_ns: int, before: int, steps_a_run: int
) -> None:
    """Folders that were just changed are believed only where the disk counts fine enough."""
    monkeypatch.setattr(kept_nights, "SETTLED_NS", settled_ns)
    fleets = [
        Fleet(tmp_path / "kept", before=before),
        Fleet(tmp_path / "anew", forgetful=True, before=before),
    ]
    first(fleets[0])
    fleets[0].run()
    shutil.copytree(fleets[0].output, fleets[1].output)
    for place in range(0, len(STEPS), steps_a_run):
        steps = STEPS[place : place + steps_a_run]
        for fleet in fleets:
            for step in steps:
                step(fleet)
            fleet.run()
        assert fleets[0].tables() == fleets[1].tables(), steps
        assert [one for one in verify_tables(fleets[0].output) if "history" in one.path] == []
    assert any(name.startswith("alarms") for name in fleets[0].tables())


Reads = list[tuple[str, list[dt.date]]]


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> Reads:
    """Nights that trends read, by table."""
    found: Reads = []

    def watched(output: Path, table: Table, *more: Any, nights: Collection[dt.date]) -> Any:
        if nights:
            found.append((table.name, sorted(nights)))
        return read_rows(output, table, *more, nights=nights)

    monkeypatch.setattr(reading, "read_rows", watched)
    monkeypatch.setattr(stage, "read_rows", watched)
    return found


@pytest.mark.parametrize("settled_ns", [0, kept_nights.SETTLED_NS])
def test_a_night_reads_what_is_new(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reads: Reads, settled_ns: int
) -> None:
    monkeypatch.setattr(kept_nights, "SETTLED_NS", settled_ns)
    fleet = Fleet(tmp_path)
    first(fleet)
    fleet.run()
    assert {name for name, _ in reads} == {"fits", "parameters", "operation", "block_statistics"}
    reads.clear()
    fleet.run()
    # The alarms that were published after they had been looked at, and no other table.
    assert {name for name, _ in reads} <= {"alarms"}
    reads.clear()
    fleet.run()
    assert reads == []
    for place in (17, 18):
        fleet.publish(place)
        fleet.run()
        tonight = [night_of(place)]
        # Both are nights without intervals of one motor, whose blocks inform the filter.
        tables = ("fits", "parameters", "operation", "block_statistics")
        expected = dict.fromkeys(tables, tonight)
        assert {name: nights for name, nights in reads if name != "alarms"} == expected
        reads.clear()


@pytest.fixture
def two_months(tmp_path: Path) -> Fleet:
    """Nights from 28 January on, read and kept."""
    fleet = Fleet(tmp_path, before=26)
    fleet.publish(*range(9))
    read(fleet)
    return fleet


def read(fleet: Fleet) -> list[str]:
    """Nights of the first motor as the next run sees them."""
    (spec, _) = load_fleet(fleet.config).motors
    tonight = Tonight(night_of(fleet.before + 8))
    found = read_nights(fleet.output, [spec], {"M1": ()}, {}, tonight)["M1"]
    found.keep("M1", None)
    assert found.history is not None
    return [str(night) for night in found.history.nights]


def test_nights_of_a_month_that_is_gone_are_gone(two_months: Fleet) -> None:
    assert read(two_months)[0] == "2026-01-28"
    for table in (FITS, ALARMS):
        shutil.rmtree(two_months.output / "tables" / table.name / "month=2026-01", True)
    assert read(two_months)[0] == "2026-02-01"


@pytest.mark.parametrize(
    "change",
    [
        lambda _: b"",
        lambda whole: whole[:-9],
        lambda whole: whole[:32] + lz4.frame.compress(b"{}\n"),
    ],
)
def test_what_cannot_be_understood_is_read_again(
    two_months: Fleet, reads: Reads, change: Callable[[bytes], bytes]
) -> None:
    (old, _) = two_months.kept()
    old.write_bytes(change(old.read_bytes()))
    before = read(two_months)
    assert ("fits", [night_of(26 + place) for place in range(4)]) in reads
    reads.clear()
    assert read(two_months) == before
    assert reads == []


def test_what_a_killed_run_left_is_no_month(two_months: Fleet) -> None:
    (old, _) = two_months.kept()
    shutil.copy(old, old.with_name(".writing-0011"))
    assert read(two_months) == read(two_months)
    assert len(set(read(two_months))) == len(read(two_months))


def test_of_a_motor_without_nights_nothing_is_read_again(tmp_path: Path, reads: Reads) -> None:
    """Or every night would read the whole history of the others for it."""
    fleet = Fleet(tmp_path)
    fleet.publish(*range(4))
    configure(tmp_path, ["M1", "M2", "M3"])
    fleet.run()
    fleet.run()
    reads.clear()
    fleet.publish(4)
    fleet.run()
    assert ("fits", [night_of(4)]) in reads


def test_a_disk_that_takes_nothing_costs_no_trends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(*_: object) -> None:
        raise StoreError("store_write", "2026-01 cannot be written: no space")

    monkeypatch.setattr(reading, "write_month", full)
    fleet = Fleet(tmp_path)
    fleet.publish(*range(4))
    fleet.run()
    assert fleet.kept() == []
    assert len(fleet.tables()) == 4
    assert "no space; the next run reads the nights again" in caplog.text
