"""A Dask scheduler and its workers as processes of their own on loopback."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipeline.config import Execution
from tests.pipeline.misbehaviour import wait_until

PATIENCE_S = 60.0
ROOT = Path(__file__).parents[2]


def start(*arguments: str) -> subprocess.Popen[str]:
    """A process of Dask's command, with the tests' modules to be found."""
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
        "POLARS_MAX_THREADS": "1",
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0",
    }
    return subprocess.Popen(
        [sys.executable, "-m", "dask", *arguments],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )


@dataclass(slots=True)
class Processes:
    """A scheduler and the workers that were started for it."""

    scheduler: subprocess.Popen[str]
    address: str
    workers: list[subprocess.Popen[str]] = field(default_factory=list)

    def add_worker(self, *options: str) -> None:
        self.workers.append(
            start("worker", self.address, "--nthreads", "1", "--no-dashboard", *options)
        )

    def wait_for(self, n_workers: int) -> None:
        from distributed import Client

        with Client(self.address, timeout=PATIENCE_S, set_as_default=False) as client:
            wait_until(lambda: len(client.run(os.getpid, on_error="ignore")) == n_workers)

    def execution(self, **changed: Any) -> Execution:
        settings = {"backend": self.address}
        return Execution.model_validate(settings | changed)

    def end(self) -> None:
        for process in (*self.workers, self.scheduler):
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@contextmanager
def scheduler_with(n_workers: int, *options: str) -> Iterator[Processes]:
    """A scheduler with some workers, all ended afterwards."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scheduler.json"
        where = ("--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file))
        found = Processes(start("scheduler", "--no-dashboard", *where), "")
        try:
            wait_until(file.exists)
            wait_until(lambda: file.read_text("utf-8").endswith("}"))
            found.address = json.loads(file.read_text("utf-8"))["address"]
            if n_workers == 1:
                found.add_worker(*options)
            elif n_workers:
                found.add_worker("--nworkers", str(n_workers), *options)
            if n_workers:
                found.wait_for(n_workers)
            yield found
        finally:
            found.end()
