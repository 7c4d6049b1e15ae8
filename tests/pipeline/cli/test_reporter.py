"""Progress of a run, as the command tells it."""

from __future__ import annotations

import json

import pytest

from pipeline.cli.reporter import Reporter
from pipeline.run.tasks import MotorOutcome


def tell(n: int, as_json: bool) -> None:
    with Reporter(as_json, 1) as reporter:
        for number in range(1, n + 1):
            chunk = f"chunks/CB400-01@{number}"
            reporter.motor(MotorOutcome("CB400-01", "ok", chunk=chunk, chunks_done=(number, n)))


@pytest.mark.parametrize(("n", "told"), [(3, [1, 2, 3]), (40, [*range(4, 41, 4)])])
def test_chunks_of_a_motor_take_at_most_ten_lines(
    n: int, told: list[int], capsys: pytest.CaptureFixture[str]
) -> None:
    tell(n, as_json=False)
    lines = capsys.readouterr().out.splitlines()
    assert lines == [f"CB400-01: {number} of {n} chunks" for number in told]
    tell(n, as_json=True)
    found = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert found == [
        {"event": "chunks", "motor_id": "CB400-01", "done": number, "of": n} for number in told
    ]
