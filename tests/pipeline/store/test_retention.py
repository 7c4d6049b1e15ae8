"""Pruning: the message, the files that go, and that nothing else changes."""

from __future__ import annotations

import datetime as dt
import shutil
from collections.abc import Mapping
from pathlib import Path

import pytest

from pipeline.errors import UsageError
from pipeline.schema import NIGHT_TABLES, TREND_TABLES
from pipeline.store.published import LOSSES, old_files, prune, require_prunable, verify_tables
from pipeline.store.state import open_state
from tests.pipeline.calling import contents
from tests.pipeline.workshop import DAY, Workshop

# The nights lie on both sides of a month's end.
FIRST = dt.date(2026, 2, 26)
NIGHTS = tuple(FIRST + number * DAY for number in range(6))
HEAVY = ("predictions", "error_budget")
KEPT = dict.fromkeys(HEAVY, 2)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    workshop = Workshop.at(tmp_path_factory.mktemp("made"))
    for seed, night in enumerate(NIGHTS):
        workshop.log(night, seed=seed + 1)
    workshop.run()
    return workshop


@pytest.fixture
def workshop(made: Workshop, tmp_path: Path) -> Workshop:
    shutil.copytree(made.folder, tmp_path / "copy")
    return Workshop(tmp_path / "copy")


def pruned(workshop: Workshop, kept: Mapping[str, int] = KEPT) -> None:
    with open_state(workshop.output) as state:
        prune(state, old_files(workshop.output, kept, NIGHTS[-1]))


def test_old_nights_go_and_the_rest_is_byte_for_byte_as_it_was(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where pruning is broken off between its list and the files: pruning again does it."""

    def crash(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    before = contents(workshop.output / "tables")
    with monkeypatch.context() as patch:
        patch.setattr("pipeline.store.published.remove", crash)
        with pytest.raises(KeyboardInterrupt):
            pruned(workshop)
    assert list(verify_tables(workshop.output)) == []
    (_, old) = old_files(workshop.output, KEPT, NIGHTS[-1])
    assert (old.table, old.first, old.last) == ("predictions", NIGHTS[0], NIGHTS[3])
    pruned(workshop)
    after = contents(workshop.output / "tables")
    gone = {f"predictions/month={night:%Y-%m}/{night}.parquet" for night in NIGHTS[:-2]}
    assert old.size_bytes == sum(len(before[name]) for name in gone)
    # A month is as old as its last night.
    gone.add("error_budget/month=2026-02/2026-02.parquet")
    assert after == {name: content for name, content in before.items() if name not in gone}
    for table in HEAVY:
        assert not (workshop.output / "tables" / table / "month=2026-02").exists()
    assert list(verify_tables(workshop.output)) == []
    # No night is made anew; a late log makes its night whole again.
    assert workshop.run().nights == ()
    workshop.log(NIGHTS[0], seed=3)
    assert workshop.run().nights == NIGHTS[:1]
    assert sorted(set(workshop.rows("predictions")["night"])) == [NIGHTS[0], *NIGHTS[-2:]]
    assert list(verify_tables(workshop.output)) == []


def test_without_statistics_a_refit_reads_the_logs_where_they_are(workshop: Workshop) -> None:
    pruned(workshop, {"blocks": 3})
    (workshop.logs / f"{NIGHTS[0]}.parquet").unlink()
    workshop.configure(more="[override.reference]\nspeed_rpm = 31.0\n")
    assert workshop.run().n_refitted == 3
    speeds = dict(workshop.rows("fits").select("night", "reference_speed_rpm").iter_rows())
    assert speeds == {NIGHTS[0]: 30.0, **dict.fromkeys(NIGHTS[1:], 31.0)}


def test_figures_trends_and_decisions_cannot_be_pruned(tmp_path: Path) -> None:
    assert old_files(tmp_path, KEPT, None) == ()
    made_from = {table.name for table in (*NIGHT_TABLES, *TREND_TABLES)} - LOSSES.keys()
    assert {"fits", "parameters", "nights", "quality", "log_files", "trends"} <= made_from
    for name in sorted(made_from):
        with pytest.raises(UsageError, match=f"{name} cannot be pruned"):
            require_prunable(["predictions", name])
    require_prunable(list(LOSSES))
