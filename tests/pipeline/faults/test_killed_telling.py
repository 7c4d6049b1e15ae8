"""SIGKILL of a run anywhere between its alarms and who is told of them: the next run tells."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from pipeline.config import load_fleet
from pipeline.telling.outbox import backlogs
from pipeline.telling.receivers import receivers_of
from tests.pipeline.faults.fleet import TinyFleet
from tests.pipeline.faults.test_killed import killer
from tests.pipeline.telling.fleet import keep, told, told_fleet

Kill = Callable[[Path, Path, str, int], None]


@pytest.fixture(scope="module")
def kill() -> Iterator[Kill]:
    with killer() as found:
        yield found


@pytest.mark.parametrize("stage", ["landing", "publishing the run", "taking up", "telling", "told"])
def test_the_next_run_tells(tmp_path: Path, kill: Kill, stage: str) -> None:
    config = told_fleet(tmp_path, keep(tmp_path / "told"))
    output, fleet = tmp_path / "out", TinyFleet(tmp_path)
    kill(tmp_path, output, stage, 1)
    times = int(stage == "told")
    assert len(told(tmp_path)) == times
    if times == 0 and stage != "landing":
        settings = load_fleet(config)
        receivers = receivers_of(settings.settings.alarms)
        assert [one.undelivered for one in backlogs(output, receivers)] == [int(stage == "telling")]
    fleet.run(output)
    # At least once; and what comes twice says so by its id.
    found = told(tmp_path)
    assert len(found) == times + 1
    assert len({one["id"] for one in found}) == 1
    assert [one["to_state"] for one in found[0]["changes"]] == ["alarm"]
    fleet.run(output)
    assert told(tmp_path) == found
