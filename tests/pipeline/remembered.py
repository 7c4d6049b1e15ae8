"""What the state file of an output remembers, for tests to see and to change."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pipeline.logs.processed import ProcessedLogs, read_processed
from pipeline.store.state import STATE_FILE, open_state
from pipeline.trends.tasks import Record, read_records

# Files and folders of an output that outlive a run.
LASTING = {
    *("tables", "lock", "heartbeat.json", "views.sql", STATE_FILE),
}


def processed_of(output: Path, motor_id: str = "M1") -> ProcessedLogs:
    """Record of processed logs of a motor."""
    with open_state(output) as state:
        return read_processed(state, motor_id)


def record_of(output: Path, motor_id: str = "M1") -> Record | None:
    """Record of a motor's trends."""
    with open_state(output) as state:
        return read_records(state).get(motor_id)


def change(output: Path, statement: str, *values: Any) -> None:
    """Change something of what is remembered."""
    with open_state(output) as state:
        state.write(statement, *values)
