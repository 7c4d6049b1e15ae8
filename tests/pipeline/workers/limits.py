"""Limits of tasks that misbehave."""

from __future__ import annotations

import time
from collections.abc import Callable

from pipeline.config import Execution

# Enough for the libraries, and little to eat.
MEMORY_MIB = 700
TIMEOUT_S = 5.0


def execution(workers: int = 2, timeout_s: float = TIMEOUT_S) -> Execution:
    return Execution(workers=workers, timeout_s=timeout_s, memory_limit_mib=MEMORY_MIB)


def wait_until(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it has not come to that"
        time.sleep(0.02)
