"""A motor that is in alarm from its first night on, by a limit of its type."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pipeline.config import load_fleet
from tests.pipeline.trends.nights import Nights, configure, publish

QUICK = '[execution]\nbackend = "sequential"\n'
# The leakage is 1.4 l/min.
LIMITS = "[limits]\nwarning_l_per_min = 0.5\nalarm_l_per_min = 1.0\n"
N = 3


def keep(path: Path) -> str:
    """A command that appends each delivery to a file, as a line."""
    script = 'cat >> "$0"; echo >> "$0"'
    return f"command = {json.dumps(['/bin/sh', '-c', script, str(path)])}"


def told(folder: Path) -> list[dict[str, Any]]:
    """Deliveries in the file `told` of a folder."""
    path = folder / "told"
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def told_fleet(folder: Path, alarms: str) -> Path:
    """Publish some nights and write the config, with lines of `[alarms]`; the fleet's file."""
    fleet = f"{QUICK}[alarms]\n{alarms}\n"
    config = configure(folder, fleet=fleet, limits=LIMITS)
    (spec,) = load_fleet(config).motors
    publish(folder / "out", Nights(spec, N).frames())
    return config
