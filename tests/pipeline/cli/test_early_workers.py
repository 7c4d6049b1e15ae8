"""Workers that start before the config is read: a guess that must never be in the way."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.cli.early_workers import MODULES, _n_workers, early_crew
from pipeline.workers.process import Loss


@pytest.mark.parametrize(
    ("text", "jobs", "expected"),
    [
        ("", None, 2),
        ("", 3, 3),
        ("[execution]\nworkers = 5\n", None, 5),
        ("[execution]\nworkers = 5\n", 1, 1),
        ('[execution]\nbackend = "sequential"\n', 4, 0),
        ('[execution]\nbackend = "dask"\n', None, 0),
        ("not toml", None, 0),
        ("execution = 7", 2, 0),
        ("[execution]\nworkers = inf\n", None, 0),
        ("a = " + "[" * 5000, None, 0),
        ('[execution]\nworkers = "many"\n', None, 0),
    ],
)
def test_as_many_as_the_run_will_have(
    tmp_path: Path, text: str, jobs: int | None, expected: int
) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text(text, "utf-8")
    assert _n_workers(path, jobs) == expected


def test_none_where_there_is_no_config(tmp_path: Path) -> None:
    assert _n_workers(tmp_path / "fleet.toml", 2) == 0
    assert _n_workers(tmp_path, 2) == 0


def test_they_have_loaded_the_program(tmp_path: Path) -> None:
    from pipeline.config import Execution

    def lost(_: object, loss: Loss) -> set[str]:
        raise AssertionError(loss)

    path = tmp_path / "fleet.toml"
    path.write_text("", "utf-8")
    with early_crew(path, 1) as crew:
        (loaded,) = crew.run_tasks(modules_before, [MODULES], lost, Execution())
    assert loaded == set(MODULES)


def modules_before(names: tuple[str, ...]) -> set[str]:
    """Which modules are loaded in this process."""
    import sys

    return set(names) & set(sys.modules)
