"""Slow measurements; `make bench` runs them and puts their tables into `benchmarks/results/`.

Pages of results without a benchmark here were measured once; each says when and how.
"""

from __future__ import annotations

import datetime as dt
import os
import platform
from pathlib import Path

from validation.tables import Table

RESULTS = Path(__file__).parent / "results"


def made(**how: str) -> Table:
    """When and where the figures of a page were made, and how."""
    now = f"{dt.datetime.now(dt.UTC):%Y-%m-%d %H:%M} UTC"
    on = f"Python {platform.python_version()}, {platform.machine()}, load {os.getloadavg()[0]:.1f}"
    return Table("made", [{"made": now, "on": on, **how}])
