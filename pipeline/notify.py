"""Tell people of changes of state: a command of their own, or a web hook; both off by default."""

from __future__ import annotations

import http.client
import json
import logging
import subprocess
import urllib.request
from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.config import Alarms
from pipeline.errors import one_line

log = logging.getLogger(__name__)

TIMEOUT_S = 30.0


def notify(settings: Alarms, fleet: str, rows: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """Pass on new rows of `alarms`; a receiver that fails costs nobody the run.

    Parameters
    ----------
    settings
        Command and web hook.
    fleet
        Name of the fleet.
    rows
        New rows of `alarms`; nothing is done without any.

    Returns
    -------
    tuple of str
        What went wrong, in words.
    """
    if not rows:
        return ()
    document = {"fleet": fleet, "changes": [dict(row) for row in rows]}
    content = json.dumps(document, default=str, sort_keys=True).encode()
    faults = []
    if settings.command and (fault := _run(settings.command, content)):
        faults.append(fault)
    if settings.webhook_url and (fault := _post(settings.webhook_url, content)):
        faults.append(fault)
    return tuple(faults)


def _run(command: Sequence[str], content: bytes) -> str:
    try:
        # The config names the program and its arguments; no shell, and nothing of a log among them.
        done = subprocess.run(  # noqa: S603
            list(command), input=content, capture_output=True, timeout=TIMEOUT_S, check=False
        )
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        return f"alarms.command: {error}"
    if done.returncode:
        words = one_line(done.stderr.decode("utf-8", "replace").strip(), 200)
        return f"alarms.command ended with {done.returncode}: {words}"
    return ""


def _post(url: str, content: bytes) -> str:
    headers = {"Content-Type": "application/json"}
    try:
        request = urllib.request.Request(url, content, headers, method="POST")  # noqa: S310
        with urllib.request.urlopen(request, timeout=TIMEOUT_S):  # noqa: S310 - http or https
            return ""
    except (OSError, ValueError, http.client.HTTPException) as error:
        return one_line(f"alarms.webhook_url: {error or type(error).__name__}", 200)
