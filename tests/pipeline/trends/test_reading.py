"""What is kept of a motor's nights: it saves reading and fitting, and changes no byte."""

from __future__ import annotations

import datetime as dt
import hashlib
import os
import shutil
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from pipeline.config import load_fleet
from pipeline.decisions import record_decision
from pipeline.fleet import RunRequest, run_fleet
from pipeline.retention import old_files, prune
from pipeline.schema import ALARMS, BLOCK_STATISTICS, FITS, TREND_TABLES, Table
from pipeline.store import night_file, write_table
from pipeline.trends import kept_nights, reading, stage
from pipeline.trends.record import note_touched
from pipeline.verification import verify_tables
from tests.pipeline.simulated import motor_toml, write_configs
from tests.pipeline.trends.blocks import POOR, blocks_of
from tests.pipeline.trends.nights import Nights, night_of, publish, ramp, reset

QUICK = '[estimation]\nstarting_points = 0\n[execution]\nbackend = "sequential"\n'
N = 41
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
    """

    folder: Path
    forgetful: bool = False
    motors: dict[str, Nights] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.config = configure(self.folder)
        m1, m2 = load_fleet(self.config).motors
        self.motors = {
            # Groups of three, one of them across the end of the first run; and no log.
            "M1": Nights(
                m1,
                N,
                {"piston_ring": ramp(N, 25, 0.5)},
                changes=dict.fromkeys((3, 4, 5, 24, 25, 26, 27, 28, 31, 32, 33), POOR)
                | dict.fromkeys((21, 22, 23, 34, 35, 36), NOTHING),
                absent=frozenset((13, 14)),
            ),
            "M2": Nights(m2, N, seed=2, changes=dict.fromkeys((34, 35, 36), POOR)),
        }

    @property
    def output(self) -> Path:
        return self.folder / "out"

    def publish(self, *places: int) -> None:
        """Publish some nights of all motors; those of others stay."""
        labels = [night_of(place) for place in places]
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
    fleet.publish(*range(32))


def night(place: int) -> Callable[[Fleet], None]:
    return lambda fleet: fleet.publish(place)


def late_log(fleet: Fleet) -> None:
    """Of a night amid groups of the first motor, which is not poor any more."""
    old = fleet.motors["M1"]
    changes = {place: one for place, one in old.changes.items() if place != 25}
    fleet.motors["M1"] = replace(old, changes=changes)
    fleet.publish(25)
    note_touched(fleet.output, "M1", night_of(25))


def late_log_of_the_other(fleet: Fleet) -> None:
    """In files that hold nights of a group of the first motor."""
    changes = fleet.motors["M2"].changes
    fleet.motors["M2"] = replace(fleet.motors["M2"], changes={**changes, 27: POOR, 28: POOR})
    fleet.publish(27, 28)
    note_touched(fleet.output, "M2", night_of(27))


def refit(fleet: Fleet) -> None:
    """Rows of many nights anew, with other figures."""
    fleet.motors = {name: replace(one, seed=one.seed + 5) for name, one in fleet.motors.items()}
    fleet.publish(*range(20, 34))
    for name in fleet.motors:
        note_touched(fleet.output, name, night_of(20))


def written_anew(fleet: Fleet) -> None:
    """The same rows in other files, as `migrate` leaves them, and a night more."""
    fleet.publish(*range(20, 35))


def a_reset_and_a_setting(fleet: Fleet) -> None:
    record_decision(fleet.output, reset(4))
    configure(fleet.folder, more="[trend]\nmerge_nights = 2\n")


def damaged(fleet: Fleet) -> None:
    for number, path in enumerate(fleet.kept()):
        whole = bytearray(path.read_bytes())
        whole[(len(whole) * (number % 7)) // 7] ^= 4
        path.write_bytes(whole[: len(whole) // 2] if number % 3 == 1 else whole)
    fleet.publish(35)


def pruned(fleet: Fleet) -> None:
    """The blocks of the older nights: those too poor alone have no figures any more."""
    prune(fleet.output, old_files(fleet.output, {"block_statistics": 8}))
    fleet.publish(36)


def a_lost_file(fleet: Fleet) -> None:
    """Of a night long ago."""
    night_file(fleet.output, FITS, night_of(21)).unlink()
    fleet.publish(37)


def one_motor_less(fleet: Fleet) -> None:
    configure(fleet.folder, ["M1"])
    fleet.publish(38)


def and_back(fleet: Fleet) -> None:
    configure(fleet.folder)
    fleet.publish(39)


STEPS: tuple[Callable[[Fleet], None], ...] = (
    first,
    night(32),
    night(33),
    late_log,
    late_log_of_the_other,
    refit,
    written_anew,
    damaged,
    pruned,
    a_reset_and_a_setting,
    a_lost_file,
    one_motor_less,
    and_back,
    night(40),
)


@pytest.fixture(
    params=[True, pytest.param(False, marks=pytest.mark.full)], ids=["folders tell", "files tell"]
)
def settled(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Folders that were just changed are believed where the disk counts fine enough, or not."""
    if request.param:
        monkeypatch.setattr(kept_nights, "SETTLED_NS", 0)


@pytest.mark.usefixtures("settled")
def test_whatever_happens_the_bytes_are_those_without_it(tmp_path: Path) -> None:
    fleets = [Fleet(tmp_path / "kept"), Fleet(tmp_path / "anew", forgetful=True)]
    for step in STEPS:
        for fleet in fleets:
            step(fleet)
            fleet.run()
        assert fleets[0].tables() == fleets[1].tables(), step
        assert [one for one in verify_tables(fleets[0].output) if "history" in one.path] == []
    assert len(fleets[0].tables()) > N
