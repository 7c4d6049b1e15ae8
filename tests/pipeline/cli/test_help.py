"""Help that helps, imports that wait, and the installed command."""

from __future__ import annotations

import datetime as dt
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from pipeline.cli import app
from pipeline.config import load_fleet
from pipeline.config.section import Section
from tests.pipeline.calling import Call, python, without_workers
from tests.reference_pages import FILES, PAGES, main

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


# In one process: what each loads is loaded for those behind it, too.
STEPS = (
    ("import pipeline.cli", ("polars", "scipy", "pyarrow", "numpy", "pipeline.run.fleet")),
    # Each of these takes as long to import as a third of the program.
    (STATUS, (*NOT_AT_ONCE, "pipeline.night.fit_night", "leakage.watch")),
    (RUN, (*NOT_AT_ONCE, *EXTRAS, "pipeline.night.fit_night")),
)


def test_nothing_is_loaded_that_is_not_needed(fleet: Path) -> None:
    shown = "print('loaded:', *(name for name in {} if name in sys.modules))"
    code = "\n".join(f"{step}\nimport sys; {shown.format(unused)}" for step, unused in STEPS)
    lines = python(code, fleet).stdout.splitlines()
    assert [line for line in lines if line.startswith("loaded:")] == ["loaded:"] * len(STEPS)


def test_the_command_is_installed() -> None:
    command = Path(sys.executable).with_name("motor-leakage")
    done = subprocess.run([command, "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"motor-leakage {version('motor-leakage')}\n"


# The generated pages


ROOT = Path(__file__).resolve().parents[3]
DOCS = ROOT / "docs"


def keys() -> dict[str, str]:
    """Keys on the page of the config files, those of a table with its name, and what they are."""
    found, prefix = {}, ""
    for line in PAGES["config.md"]().splitlines():
        if line.startswith("#"):
            table = re.search(r"`\[+([\w.<>]+)\]", line)
            prefix = f"{table[1]}." if table else ""
        elif key := re.match(r"- `([\w.]+)` \((.*?)\): ", line):
            found[prefix + key[1]] = key[2]
    return found


def test_pages_of_the_docs_are_those_of_the_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main([str(tmp_path)])
    for folder in (tmp_path, DOCS):
        main(["--check", str(folder)])
    (tmp_path / "config.md").unlink()
    with (tmp_path / "tables.md").open("a") as page:
        page.write("\n")
    with pytest.raises(SystemExit) as stopped:
        main(["--check", str(tmp_path)])
    assert stopped.value.code == 1
    stale = f"{tmp_path}/config.md, {tmp_path}/tables.md: out of date; run `make docs`\n"
    assert capsys.readouterr().err == stale
    assert [path.name for path in tmp_path.iterdir()] == ["tables.md"]


def test_every_key_of_every_model_is_on_the_page() -> None:
    page = PAGES["config.md"]()
    listed = {part for key in keys() for part in key.split(".")}
    listed |= set(re.findall(r"`\[+(\w+)", page)) | {"law", "value", "minimum", "maximum", "fixed"}
    shipped = (section for section in _below(Section) if section.__module__.startswith("pipeline."))
    stated = {key for model in (*FILES.values(), *shipped) for key in model.model_fields}
    assert stated - listed == set()


def _below(model: type[Section]) -> Iterator[type[Section]]:
    for child in model.__subclasses__():
        yield child
        yield from _below(child)


def test_the_example_is_a_fleet() -> None:
    fleet = load_fleet(DOCS / "example" / "fleet.toml")
    (motor,) = fleet.motors
    assert {path.law for path in motor.motor_type.path} == {"annular_gap", "speed_curve", "laminar"}
    assert motor.settings.cleaning.warm_up_minutes == 15.0
    assert motor.file.oil_on(dt.date(2026, 8, 31)) == "vg68"
    assert motor.file.oil_on(dt.date(2026, 9, 1)) == "vg46"
    assert motor.file.logs.separator == ";"
