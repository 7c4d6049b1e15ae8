"""Heartbeat of a run, ``heartbeat.json`` in the output folder: its progress, for monitors outside.

A run that died leaves a last beat that says ``running`` and grows old.
"""

from __future__ import annotations

import datetime as dt
import json
import logging
import os
import socket
import threading
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import AwareDatetime, TypeAdapter

from pipeline.errors import MotorLeakageError, StoreError
from pipeline.schema import RUNS
from pipeline.store.atomic_files import put
from pipeline.store.tables import files_of, read_table

log = logging.getLogger(__name__)

INTERVAL_S = 15.0
# A run is missing once so many beats in a row are.
MISSED_BEATS = 4
# Status of a run that went through all motors, and after which no failure stands.
GOOD_RUN = "ok"
RUNNING, FINISHED, INTERRUPTED, FAILED = "running", "finished", "interrupted", "failed"


@dataclass(frozen=True, slots=True)
class Beat:
    """State of a run; times are UTC."""

    state: str  # running, finished, interrupted or failed
    stage: str  # preparing, motors, publishing, trends, recording, notifying or copying
    # started_at, beaten_at: begin of the run, and time of this beat.
    started_at: AwareDatetime
    beaten_at: AwareDatetime
    # pid, host: the process.
    pid: int
    host: str
    # n_motors, n_motors_done: motors in the run, and those that are done.
    n_motors: int
    n_motors_done: int = 0
    run_id: str | None = None  # known once all motors are done: it is a hash of their inputs
    last_good_run: AwareDatetime | None = None  # end of the last run after which no failure stands
    error_code: str | None = None  # of a run that failed

    @property
    def is_finished(self) -> bool:
        """True of a run that went to its end."""
        return self.state == FINISHED

    def is_missing(self, now: dt.datetime) -> bool:
        """Return True if a run is said to be under way and its beats have stopped."""
        age_s = (now - self.beaten_at).total_seconds()
        return self.state == RUNNING and age_s > MISSED_BEATS * INTERVAL_S


def heartbeat_file(output: Path) -> Path:
    """Return file of the heartbeat."""
    return output / "heartbeat.json"


def read_heartbeat(output: Path) -> Beat | None:
    """Return the last beat; None without a valid beat."""
    try:
        return TypeAdapter(Beat).validate_json(heartbeat_file(output).read_bytes())
    except (OSError, ValueError):
        return None


class Heartbeat:
    """Context manager that writes a beat at every change, and every `INTERVAL_S` seconds."""

    def __init__(self, output: Path, n_motors: int, last_good_run: dt.datetime | None) -> None:
        now, host = dt.datetime.now(dt.UTC), socket.gethostname()
        self._beat = Beat(
            RUNNING, "preparing", now, now, os.getpid(), host, n_motors, last_good_run=last_good_run
        )
        self._file = heartbeat_file(output)
        self._changing = threading.Lock()
        self._over = threading.Event()
        self._told = False
        self._thread = threading.Thread(target=self._keep_beating, name="heartbeat", daemon=True)

    def __enter__(self) -> Heartbeat:
        self.say()
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, _: object) -> None:
        self._over.set()
        self._thread.join()
        if kind is not None:
            interrupted = issubclass(kind, KeyboardInterrupt)
            code = error.code if isinstance(error, MotorLeakageError) else None
            self.say(state=INTERRUPTED if interrupted else FAILED, error_code=code)

    def motor_done(self) -> None:
        """Count another motor as done, which the next beat tells."""
        with self._changing:
            self._beat = replace(self._beat, n_motors_done=self._beat.n_motors_done + 1)

    def finished(self, *, interrupted: bool, good: bool) -> None:
        """End the run; it is good if it went through all motors and no failure stands."""
        ended = dt.datetime.now(dt.UTC) if good else self._beat.last_good_run
        self.say(state=INTERRUPTED if interrupted else FINISHED, last_good_run=ended)

    def say(self, **changes: str | int | dt.datetime | None) -> None:
        """Write a beat; a failure is logged once and stops nothing."""
        with self._changing:
            now = dt.datetime.now(dt.UTC)
            self._beat = replace(self._beat, beaten_at=now, **changes)  # type: ignore[arg-type]
            text = json.dumps(asdict(self._beat), default=dt.datetime.isoformat, indent=1)
            try:
                put(self._file, f"{text}\n".encode(), durable=False)
            except StoreError as error:
                if not self._told:
                    log.warning("no heartbeat: %s", error)
                self._told = True

    def _keep_beating(self) -> None:
        while not self._over.wait(INTERVAL_S):
            self.say()


def last_good_run(output: Path) -> dt.datetime | None:
    """End of the last run after which no failure stands; None without a readable run."""
    ends = (run["finished_at"] for run in runs_back(output) if run["status"] == GOOD_RUN)
    return next(ends, None)


def runs_back(output: Path) -> Iterator[Mapping[str, Any]]:
    """Yield rows of `runs`, the newest first, up to a row that cannot be read."""
    try:
        for path in reversed(files_of(output, RUNS)):
            yield from reversed(read_table(path, RUNS).sort("started_at").to_dicts())
    except StoreError:  # which a run mends, or names
        return
