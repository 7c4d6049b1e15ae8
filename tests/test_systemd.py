"""The systemd units in docs: systemd takes them, and they call commands that there are."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
import typer.main

from pipeline.cli import app

UNITS = sorted((Path(__file__).parent.parent / "docs" / "systemd").iterdir())
SERVICES = [path for path in UNITS if path.suffix == ".service"]


def test_each_timer_has_its_service() -> None:
    timers = {path.stem for path in UNITS if path.suffix == ".timer"}
    assert timers == {path.stem for path in SERVICES} != set()


@pytest.mark.parametrize("path", SERVICES, ids=lambda path: path.stem)
def test_services_call_commands_and_options_that_there_are(path: Path) -> None:
    known = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    calls = re.findall(r"^ExecStart=\S+/motor-leakage (.+)$", path.read_text("utf-8"), re.MULTILINE)
    assert calls
    for call in calls:
        name, *rest = call.split()
        options = {option for one in known[name].params for option in one.opts}
        assert {word for word in rest if word.startswith("--")} <= options
        assert "${FLEET}" in rest


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze here")
def test_systemd_takes_the_units(tmp_path: Path) -> None:
    command = shutil.which("true")
    assert command is not None
    copies = []
    for unit in UNITS:
        text = re.sub(r"/opt/\S+/motor-leakage ", f"{command} ", unit.read_text("utf-8"))
        copies.append(tmp_path / unit.name)
        copies[-1].write_text(text, "utf-8")
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", *map(str, copies)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    own = [line for line in done.stderr.splitlines() if "motor-leakage" in line]
    assert own == []
