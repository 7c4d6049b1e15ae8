"""Pruning: the files that go, wherever it is broken off, and that nothing else changes."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import pytest

from pipeline.errors import UsageError
from pipeline.schema import BLOCKS, ERROR_BUDGET, NIGHT_TABLES, PREDICTIONS, TREND_TABLES
from pipeline.store.published import LOSSES, old_files, prune, require_prunable, verify_tables
from pipeline.store.state import open_state
from tests.pipeline.calling import contents
from tests.pipeline.store.made_rows import publish

# The nights lie on both sides of a month's end.
NIGHTS = tuple(dt.date(2026, 2, 26) + dt.timedelta(days=number) for number in range(6))
KEPT = {"predictions": 2, "error_budget": 2}


def pruned(output: Path) -> None:
    with open_state(output) as state:
        prune(state, old_files(output, KEPT, NIGHTS[-1]))


def test_old_nights_go_and_the_rest_is_byte_for_byte_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where pruning is broken off between its list and the files: pruning again does it."""

    def crash(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    rows = {
        table: {night: [{"motor_id": "A", "night": night}] for night in NIGHTS}
        for table in NIGHT_TABLES
    }
    publish(tmp_path, {"A": rows})
    before = contents(tmp_path / "tables")
    with monkeypatch.context() as patch:
        patch.setattr("pipeline.store.published.remove", crash)
        with pytest.raises(KeyboardInterrupt):
            pruned(tmp_path)
    assert list(verify_tables(tmp_path)) == []
    months, old = old_files(tmp_path, KEPT, NIGHTS[-1])
    february = dt.date(2026, 2, 1), dt.date(2026, 2, 28)
    assert (months.table, months.first, months.last) == ("error_budget", *february)
    assert (old.table, old.first, old.last) == ("predictions", NIGHTS[0], NIGHTS[3])
    pruned(tmp_path)
    gone = {f"predictions/month={night:%Y-%m}/{night}.parquet" for night in NIGHTS[:-2]}
    assert old.size_bytes == sum(len(before[name]) for name in gone)
    # A month is as old as its last night.
    gone.add("error_budget/month=2026-02/2026-02.parquet")
    after = {name: content for name, content in before.items() if name not in gone}
    assert contents(tmp_path / "tables") == after
    for table in (PREDICTIONS, ERROR_BUDGET):
        assert not (tmp_path / "tables" / table.name / "month=2026-02").exists()
    assert list(verify_tables(tmp_path)) == []


def test_blocks_of_a_baseline_in_force_stay(tmp_path: Path) -> None:
    publish(
        tmp_path, {"A": {BLOCKS: {night: [{"motor_id": "A", "night": night}] for night in NIGHTS}}}
    )
    (old,) = old_files(tmp_path, {"blocks": 2}, NIGHTS[-1], NIGHTS[1:3])
    assert [Path(name).stem for name in old.names] == [str(NIGHTS[0]), str(NIGHTS[3])]


def test_figures_trends_and_decisions_cannot_be_pruned(tmp_path: Path) -> None:
    assert old_files(tmp_path, KEPT, None) == ()
    made_from = {table.name for table in (*NIGHT_TABLES, *TREND_TABLES)} - LOSSES.keys()
    assert {"fits", "parameters", "nights", "quality", "log_files", "trends"} <= made_from
    for name in sorted(made_from):
        with pytest.raises(UsageError, match=f"{name} cannot be pruned"):
            require_prunable(["predictions", name])
    require_prunable(list(LOSSES))
