"""Workers that load the program while the command still does, and reads its config.

To load it takes a second on either side; one after the other would be two.
"""

from __future__ import annotations

import os
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pipeline.workers.local import Crew

MODULES = ("pipeline.run.motor_task", "pipeline.trends.stage")


def early_crew(config: Path, jobs: int | None) -> Crew:
    """The workers that a run will most likely have; it starts those that are missing."""
    from pipeline.workers.local import Crew

    return Crew(min(_n_workers(config, jobs), os.cpu_count() or 1), MODULES)


def _n_workers(config: Path, jobs: int | None) -> int:
    """A guess, which only costs time where it is wrong: faults of the config are told later."""
    try:
        execution = tomllib.loads(config.read_text("utf-8-sig")).get("execution", {})
        if execution.get("backend", "loky") != "loky":
            return 0
        return int(jobs or execution.get("workers", 2))
    except (OSError, ValueError, TypeError, AttributeError, OverflowError, RecursionError):
        return 0
