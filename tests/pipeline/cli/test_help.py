"""Help that helps, imports that wait, and the installed command."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from pipeline.cli import app
from tests.pipeline.calling import Call, python, without_workers

COMMANDS = sorted(
    command.name or command.callback.__name__.replace("_", "-")
    for command in app.registered_commands
    if command.callback
)


def test_help_shows_an_example_and_all_that_is_written_in_it(
    call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "300")
    assert {"fit-fleet", "check", "demo"} <= set(COMMANDS)
    for command in COMMANDS:
        code, out, _ = call(command, "--help")
        shown = re.sub(r"\s+", " ", out)
        assert code == 0
        assert f"Example: motor-leakage {command} " in shown
        for parameter in get_command(app).commands[command].params:
            assert re.sub(r"\s+", " ", parameter.help) in shown


def test_examples_of_the_help_run_as_they_stand(
    call: Call, demo_folder: Path, fitted_output: Path, tmp_path: Path, monkeypatch: Any
) -> None:
    """Each line, pasted where `motor-leakage demo . --nights 3` was run."""
    shutil.copytree(demo_folder, tmp_path, dirs_exist_ok=True)
    shutil.copytree(fitted_output, tmp_path / "out")
    without_workers(tmp_path / "configs" / "fleet.toml")
    monkeypatch.chdir(tmp_path)
    docs = [
        command.callback.__doc__ or "" for command in app.registered_commands if command.callback
    ]
    examples = re.findall(r"Example: motor-leakage (.*)", "\n".join(docs))
    assert {example.split()[0] for example in examples} == set(COMMANDS)
    for example in examples:
        # The demo is there already; three nights raise no alarm that could be acknowledged and are
        # too few to compare.
        if example.startswith(("demo ", "ack ", "compare ")):
            continue
        code, _, err = call(*shlex.split(example))
        # The demo's logs leave questions open, which is 1.
        assert code == int(example.startswith("init ")), example
        # Piped, `status` says on stderr what is no motor's.
        said = ("last run without a failure: ", "newest samples: ")
        others = [line for line in err.splitlines() if not line.startswith(said)]
        assert (others if example.startswith("status ") else err.splitlines()) == [], example


NO_COMMAND_NEEDS = ("pandas", "plotly", "jinja2", "pyarrow.dataset")
EXTRAS = ("dask", "distributed", "obstore", "duckdb")
NOT_AT_ONCE = (*NO_COMMAND_NEEDS, "scipy", "pyarrow.compute", "rich")


STATUS = """
import contextlib, sys, pipeline.cli.state as s; from pathlib import Path; from typer import Exit
with contextlib.suppress(Exit): s.status(Path(sys.argv[1]))"""
RUN = """
import pipeline.run.fleet; from pipeline.cli.arguments import progress_bar
with progress_bar("nights"): pass"""


@pytest.mark.parametrize(
    ("code", "unused"),
    [
        ("import pipeline.cli", ("polars", "scipy", "pyarrow", "numpy", "pipeline.run.fleet")),
        # Each of these takes as long to import as a third of the program.
        (RUN, (*NOT_AT_ONCE, *EXTRAS, "pipeline.night.fit_night")),
        (STATUS, (*NOT_AT_ONCE, "pipeline.night.fit_night", "leakage.watch")),
    ],
)
def test_nothing_is_loaded_that_is_not_needed(
    fleet: Path, code: str, unused: Sequence[str]
) -> None:
    code += f"\nimport sys; print(*(name for name in {unused} if name in sys.modules))"
    assert python(code, fleet).stdout.splitlines()[-1] == ""


def test_the_command_is_installed() -> None:
    command = Path(sys.executable).with_name("motor-leakage")
    done = subprocess.run([command, "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"motor-leakage {version('motor-leakage')}\n"
