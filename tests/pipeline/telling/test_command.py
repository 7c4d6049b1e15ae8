"""A command takes deliveries; only its own end is waited for, and no shell sees a name."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import psutil
import pytest

from pipeline.telling.command import Command
from pipeline.telling.delivery import Delivery, UndeliveredError

CONTENT = '{"reason": "; rm -rf $HOME `id` ñ"}'.encode()
DELIVERY = Delivery("msg_1", CONTENT)
# Writes what it gets, and what it was called with.
KEEP = "import sys; open(sys.argv[1], 'wb').write(sys.stdin.buffer.read())"


def shell(script: str, *arguments: str | Path) -> tuple[str, ...]:
    return ("/bin/sh", "-c", script, "sh", *map(str, arguments))


def fault_of(command: tuple[str, ...], deadline_s: float = 30.0) -> UndeliveredError:
    with pytest.raises(UndeliveredError) as caught:
        Command(command, deadline_s).take(DELIVERY)
    return caught.value


def test_it_gets_the_delivery_on_its_standard_input_and_need_not_read_it(tmp_path: Path) -> None:
    target = tmp_path / "got; $(id).json"
    Command((sys.executable, "-c", KEEP, str(target))).take(DELIVERY)
    assert target.read_bytes() == CONTENT
    assert [path.name for path in tmp_path.iterdir()] == [target.name]
    Command(shell("exit 0")).take(Delivery("msg_1", b"x" * 10_000_000))


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (("/no/such/program",), "No such file or directory"),
        (shell("echo no ink >&2; exit 3"), "ended with 3: no ink"),
        (shell("kill -9 $$"), "ended with -9"),
        (("/bin/sh", "-c", "a\0b"), "embedded null byte"),
        (shell("printf 'a\\033[2J\\nb%9000d' 1 >&2; exit 3"), "ended with 3: "),
    ],
)
def test_one_that_fails_has_not_taken_it(command: tuple[str, ...], words: str) -> None:
    fault = fault_of(command)
    assert words in fault.why
    assert fault.why.isprintable()
    assert len(fault.why) < 1000
    assert not fault.hung


def test_a_child_that_holds_its_output_is_not_waited_for(tmp_path: Path) -> None:
    pid = tmp_path / "pid"
    Command(shell('sleep 600 & echo $! > "$1"', pid)).take(DELIVERY)
    os.kill(int(pid.read_text()), signal.SIGKILL)  # it ran on all the while


def test_one_that_hangs_is_killed_with_its_children(tmp_path: Path) -> None:
    pid = tmp_path / "pid"
    fault = fault_of(shell('sleep 600 & echo $! > "$1"; wait', pid), 0.5)
    assert fault.hung
    assert fault.why == "did not end within 0.5 s and was killed"
    try:
        child = psutil.Process(int(pid.read_text()))
        assert psutil.wait_procs([child], timeout=10)[1] == [] or child.status() == "zombie"
    except psutil.NoSuchProcess:
        pass
