"""Names of pages and folders, one per motor, valid on any file system and for any id."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Iterable

# What every file system takes; the ids of a config match it, those of a stranger's table may not.
PLAIN = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
# Names of devices on Windows, whatever their ending.
DEVICES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.IGNORECASE)


def file_names(motor_ids: Iterable[str]) -> dict[str, str]:
    """A name without ending for each motor: its id, wherever that is a safe one."""
    ids = sorted(motor_ids)
    sharing = Counter(motor_id.casefold() for motor_id in ids)
    return {
        motor_id: motor_id
        if _is_safe(motor_id) and sharing[motor_id.casefold()] == 1
        else f"motor-{hashlib.sha256(motor_id.encode()).hexdigest()[:12]}"
        for motor_id in ids
    }


def _is_safe(motor_id: str) -> bool:
    return bool(
        PLAIN.fullmatch(motor_id) and not DEVICES.match(motor_id) and not motor_id.endswith(".")
    )
