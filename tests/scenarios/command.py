"""The command as a user runs it: as a process, or, where starting costs too much, in this one."""

from __future__ import annotations

import contextlib
import gc
import io
import json
import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

ROOT = Path(__file__).parents[2]
# Calls of the test that is running: what `covers` of conftest.py holds declarations against.
CALLS: list[Result] = []


@dataclass
class Result:
    """What a command ended with and said; knows whether more of it than its code was read."""

    arguments: tuple[str, ...]
    code: int
    _out: str
    _err: str
    is_examined: bool = field(default=False)

    @property
    def out(self) -> str:
        """Standard output."""
        self.is_examined = True
        return self._out

    @property
    def err(self) -> str:
        """Standard error."""
        return self._err

    @property
    def lines(self) -> list[dict[str, Any]]:
        """Objects of `--json`, of both streams."""
        self.is_examined = True
        texts = (self._out + self._err).splitlines()
        return [json.loads(line) for line in texts if line.startswith("{")]

    def events(self, event: str) -> list[dict[str, Any]]:
        """Objects of `--json` of a kind."""
        return [line for line in self.lines if line["event"] == event]


def run_command(
    *arguments: object, folder: Path | None = None, process: bool = False, **variables: str
) -> Result:
    """Run `motor-leakage` with arguments, and with environment variables by name."""
    texts = tuple(map(str, arguments))
    run = _in_process if process else _here
    result = Result(texts, *run(texts, folder or Path.cwd(), {"NO_COLOR": "1"} | variables))
    CALLS.append(result)
    return result


def examined() -> None:
    """Note that a table was read: what calls did so far is looked at, not their code alone."""
    for call in CALLS:
        call.is_examined = True


def run_line(line: str, folder: Path) -> Result:
    """Run a line of a page, such as ``motor-leakage status configs/fleet.toml``."""
    program, *arguments = shlex.split(line)
    assert program.endswith("motor-leakage"), line
    return run_command(*arguments, folder=folder)


Ended = tuple[int, str, str]


def _in_process(arguments: tuple[str, ...], folder: Path, variables: dict[str, str]) -> Ended:
    environment = os.environ | {"PYTHONPATH": str(ROOT)} | variables
    command = [sys.executable, "-m", "pipeline.cli", *arguments]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    return done.returncode, done.stdout, done.stderr


def _here(arguments: tuple[str, ...], folder: Path, variables: dict[str, str]) -> Ended:
    from pipeline.cli import main
    from pipeline.messages import FORM

    out, err, handler, thresholds = (
        io.StringIO(), io.StringIO(), signal.getsignal(signal.SIGTERM), gc.get_threshold(),
    )  # fmt: skip
    # Not by patch.dict, which at its end takes every variable away and sets it again: a thread of
    # a native library that asks for one in between may end the process.
    with (
        pytest.MonkeyPatch.context() as patched,
        patch.object(sys, "argv", ["motor-leakage", *arguments]),
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        # The command sets the form of its messages, too.
        for name, value in ({FORM: os.environ.get(FORM, "")} | variables).items():
            patched.setenv(name, value)
        code = _code_of(main)
    signal.signal(signal.SIGTERM, handler)
    gc.set_threshold(*thresholds)
    return code, out.getvalue(), err.getvalue()


def _code_of(main: Callable[[], object]) -> int:
    try:
        main()
    except SystemExit as ended:
        return int(ended.code or 0)
    raise AssertionError("the command ended without an exit code")
