"""The command: exit codes, what goes to which stream, and help that helps."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from typer.main import get_command

import pipeline.cli
import pipeline.run.fleet
import pipeline.store.publishing
from pipeline.cli import app, main
from pipeline.config.fleet import OWN_FOLDERS
from pipeline.errors import StoreError
from pipeline.store.night_files import (
    NightFile,
    prepare_night,
)
from tests.conftest import OwnFleet

CSV, PARQUET = "CB400-01", "CB400-02"
COMMANDS = sorted(
    command.name or command.callback.__name__.replace("_", "-")
    for command in app.registered_commands
    if command.callback
)

Called = tuple[int, str, str]
Call = Callable[..., Called]


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Iterator[Call]:
    """Runs the command in this process; its code, and what it said on stdout and stderr."""
    before = signal.getsignal(signal.SIGTERM)

    def run(*arguments: str | Path) -> Called:
        monkeypatch.setattr(sys, "argv", ["motor-leakage", *map(str, arguments)])
        capfd.readouterr()
        with pytest.raises(SystemExit) as caught:
            main()
        out, err = capfd.readouterr()
        assert isinstance(caught.value.code, int)
        return caught.value.code, out, err

    yield run
    signal.signal(signal.SIGTERM, before)


def break_log(fleet: Path, motor: str) -> Path:
    path = max((fleet.parent.parent / "demo" / "logs" / motor).iterdir())
    path.write_bytes(b"nonsense" * 1000)
    return path


def change(fleet: Path, file: str, before: str, after: str) -> None:
    path = fleet.parent / file
    text = path.read_text(encoding="utf-8")
    assert before in text
    path.write_text(text.replace(before, after), encoding="utf-8")


def without_workers(fleet: Path) -> Path:
    """For tests of what the command says, not of how its work is spread."""
    change(fleet, "fleet.toml", "[execution]\n", '[execution]\nbackend = "sequential"\n')
    return fleet


@pytest.fixture
def fleet(own_fleet: OwnFleet) -> Path:
    """Two motors that are fitted already: a run over them is quick."""
    return without_workers(own_fleet(CSV, PARQUET, fitted=True))


# Exit codes


def test_0_with_nothing_new(call: Call, fleet: Path) -> None:
    code, out, err = call("fit-fleet", fleet)
    assert (code, err) == (0, "")
    lines = out.splitlines()
    done = [f"{motor}: no_new_data (nothing to do)" for motor in (CSV, PARQUET)]
    assert sorted(lines[:2]) == done
    assert lines[2].startswith("0 nights of 2 motors in ")
    assert "; logs: 0 read, 6 unchanged, 0 growing, 0 failed, 0 left; " in lines[2]
    assert lines[2].endswith(f"; tables in {fleet.parent.parent / 'out' / 'tables'}")


def test_1_when_a_motor_failed_and_the_other_is_done(call: Call, own_fleet: OwnFleet) -> None:
    fleet = without_workers(own_fleet(CSV, PARQUET))
    broken = break_log(fleet, PARQUET)
    code, out, err = call("fit-fleet", fleet)
    assert code == 1
    assert f"{CSV}: ok (3 ok)" in out
    assert f"{PARQUET}: failed (1 failed, 2 ok)" in out
    assert "6 nights of 2 motors" in out
    assert "1 motor failed" in out
    assert f"{PARQUET}: log_not_parquet: " in err
    assert broken.name in err
    assert "Traceback" not in err


def test_2_for_a_broken_config_before_anything_is_read(
    call: Call, fleet: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forbidden(*_: Any) -> None:
        raise AssertionError

    monkeypatch.setattr("pipeline.logs.locations.find_logs", forbidden)
    change(fleet, f"motors/{CSV}.toml", 'oil = "vg68"', 'oil = "vg99"')
    change(fleet, "fleet.toml", "workers = 2", "workers = 0")
    before = sorted(fleet.parent.parent.rglob("*"))
    for command in ("fit-fleet", "check"):
        code, out, err = call(command, fleet)
        assert (code, out) == (2, "")
        assert err.startswith("motor-leakage: config: 2 config faults\n")
        assert 'motors/CB400-01.toml: oil: got "vg99"; expected one of vg32, vg46, vg68' in err
        assert "fleet.toml: execution.workers: got 0" in err
    assert sorted(fleet.parent.parent.rglob("*")) == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--motors", "CB400-09"], "no motor CB400-09; there are CB400-01, CB400-02"),
        (["--motors", "CB400-01 x y"], "no motor x, y"),
        (["--since", "yesterday"], "--since: got 'yesterday'; expected YYYY-MM-DD"),
        (["--until", "2026-02-30"], "--until: got '2026-02-30'"),
        (["--since", "2026-02-02", "--until", "2026-02-01"], "--since 2026-02-02 is after"),
        (["--jobs", "0"], "--jobs"),
        (["--jobs", "two"], "--jobs"),
        (["--fast"], "--fast"),
        (["--output", "x" * 300], "expected a folder: File name too long"),
        (["another.toml"], "another.toml"),
    ],
)
def test_2_for_wrong_usage(call: Call, fleet: Path, arguments: list[str], words: str) -> None:
    code, out, err = call("fit-fleet", fleet, *arguments)
    assert (code, out) == (2, "")
    assert words in err


def test_2_for_no_config_no_command_and_no_such_file(call: Call, tmp_path: Path) -> None:
    assert call("fit-fleet")[0] == 2
    assert call("fit-feet", "x")[0] == 2
    assert call()[0] == 2
    code, _, err = call("fit-fleet", tmp_path / "none.toml")
    assert code == 2
    assert "none.toml: cannot be read: No such file or directory" in err


def test_2_where_the_root_of_the_logs_is_not_there(call: Call, fleet: Path) -> None:
    """A folder that is not mounted must not pass for a fleet without new logs."""
    logs = fleet.parent.parent / "demo" / "logs"
    logs.rename(logs.with_name("unmounted"))
    for command in ("fit-fleet", "check"):
        code, _, err = call(command, fleet)
        assert code == 2
        assert f"fleet.toml: folders.logs: expected a folder at {logs}" in err


def test_2_where_the_output_would_lie_among_the_logs(call: Call, fleet: Path) -> None:
    code, out, err = call("fit-fleet", fleet, "--output", fleet.parent.parent / "demo" / "logs")
    assert (code, out) == (2, "")
    assert err.startswith("motor-leakage: folder: --output: got ")
    assert "expected another folder than that of the logs" in err


def test_the_output_of_a_run_has_no_folders_but_those_that_are_known(fitted_output: Path) -> None:
    assert {path.name for path in fitted_output.iterdir() if path.is_dir()} <= set(OWN_FOLDERS)


def test_0_where_it_is_empty(call: Call, own_fleet: OwnFleet) -> None:
    fleet = without_workers(own_fleet(CSV, PARQUET))
    for path in (fleet.parent.parent / "demo" / "logs").rglob("*.*"):
        path.unlink()
    code, out, err = call("fit-fleet", fleet)
    assert (code, err) == (0, "")
    assert out.count("no_new_data (nothing to do): no file matches CB400-0") == 2


def test_3_while_another_run_holds_the_output(call: Call, fleet: Path) -> None:
    with pipeline.run.fleet.locked(fleet.parent.parent / "out"):
        code, out, err = call("fit-fleet", fleet)
    assert (code, out) == (3, "")
    assert re.search(
        rf"another run writes to this output: process {os.getpid()} on \S+ since 20\d\d-", err
    )
    assert call("fit-fleet", fleet)[0] == 0


def test_4_where_nothing_can_be_published(call: Call, own_fleet: OwnFleet, tmp_path: Path) -> None:
    fleet = own_fleet(CSV)
    (tmp_path / "file").write_text("")
    code, out, err = call("fit-fleet", fleet, "--output", tmp_path / "file")
    assert (code, out) == (4, "")
    assert err.startswith("motor-leakage: ")
    assert str(tmp_path / "file") in err
    assert call("fit-fleet", fleet, "--output", tmp_path / "file" / "below")[0] == 4


def test_4_where_the_disk_is_full(
    call: Call, own_fleet: OwnFleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> None:
        raise StoreError("store_write", "x.parquet cannot be written: No space left on device")

    fleet = without_workers(own_fleet(PARQUET))
    monkeypatch.setattr(pipeline.store.publishing, "prepare_night", full)
    code, _, err = call("fit-fleet", fleet)
    assert code == 4
    assert "No space left on device" in err
    assert "Traceback" not in err
    monkeypatch.undo()


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_130_and_143_while_publishing(
    call: Call,
    own_fleet: OwnFleet,
    monkeypatch: pytest.MonkeyPatch,
    number: signal.Signals,
    code: int,
) -> None:
    came: list[int] = []

    def interrupted(*arguments: Any) -> NightFile:
        if not came:
            came.append(number)
            os.kill(os.getpid(), number)
        return prepare_night(*arguments)

    fleet = without_workers(own_fleet(PARQUET))
    with monkeypatch.context() as patched:
        patched.setattr(pipeline.store.publishing, "prepare_night", interrupted)
        ended, out, err = call("fit-fleet", fleet)
    # What was begun is published whole, and nothing after it is begun.
    assert ended == code
    assert err.startswith(f"motor-leakage: interrupted: stopped by {number.name}")
    assert any(line.startswith("interrupted; 3 nights of 1 motor ") for line in out.splitlines())
    assert not (fleet.parent.parent / "out" / "tables" / "trends").exists()
    assert call("fit-fleet", fleet)[0] == 0
    assert (fleet.parent.parent / "out" / "tables" / "trends").exists()
    fits = pl.read_parquet(fleet.parent.parent / "out" / "tables" / "fits" / "**" / "*.parquet")
    assert fits["status"].to_list() == ["ok"] * 3


@pytest.mark.parametrize("as_json", [False, True])
def test_130_of_any_command_says_why(
    call: Call, fleet: Path, monkeypatch: pytest.MonkeyPatch, as_json: bool
) -> None:
    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("pipeline.report.status.fleet_status", interrupted)
    code, out, err = call("status", fleet, *(["--json"] if as_json else []))
    assert (code, out) == (130, "")
    if as_json:
        line = json.loads(err)
        assert (line["event"], line["code"], line["exit_code"]) == ("error", "interrupted", 130)
    else:
        assert err.strip().startswith("motor-leakage: interrupted: stopped by SIGINT (Ctrl-C); ")


# What is asked for


def test_options_reach_the_run(call: Call, own_fleet: OwnFleet, tmp_path: Path) -> None:
    fleet = own_fleet(CSV, PARQUET)
    code, out, _ = call(
        "fit-fleet", fleet, "--output", tmp_path / "elsewhere", "--jobs", "1", "--motors",
        f"  {PARQUET} ", "--since", "2026-01-03", "--until", "2026-01-03",
    )  # fmt: skip
    assert code == 0
    assert out.splitlines()[0] == f"{PARQUET}: ok (1 ok)"
    assert not (fleet.parent.parent / "out").exists()
    files = sorted((tmp_path / "elsewhere" / "tables" / "fits").rglob("*.parquet"))
    assert [path.name for path in files] == ["2026-01-03.parquet"]
    (run,) = (tmp_path / "elsewhere" / "tables" / "runs").rglob("*.parquet")
    assert pl.read_parquet(run)["workers"].to_list() == [1]


def test_without_an_output_tables_go_where_the_command_was_started(
    call: Call, fleet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    change(fleet, "fleet.toml", 'output = "../out"', "")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert call("fit-fleet", fleet, "--motors", PARQUET)[0] == 0
    assert (tmp_path / "here" / "out" / "tables" / "fits").is_dir()


def test_a_reader_that_goes_away_does_not_end_the_run(own_fleet: OwnFleet) -> None:
    fleet = without_workers(own_fleet(PARQUET))
    code = "import sys; from pipeline.cli import main; main()"
    process = subprocess.Popen(
        [sys.executable, "-c", code, "fit-fleet", str(fleet)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    assert process.stderr.read() == ""
    assert process.wait(timeout=60) == 0
    process.stderr.close()
    fits = pl.read_parquet(fleet.parent.parent / "out" / "tables" / "fits" / "**" / "*.parquet")
    assert fits["status"].to_list() == ["ok"] * 3


# Lines for programs


def test_json_lines_of_a_run(call: Call, own_fleet: OwnFleet) -> None:
    fleet = without_workers(own_fleet(CSV, PARQUET))
    break_log(fleet, PARQUET)
    code, out, _ = call("fit-fleet", fleet, "--json")
    assert code == 1
    *motors, run = map(json.loads, out.splitlines())
    assert [one["event"] for one in motors] == ["motor", "motor"]
    assert motors[0] == {
        "event": "motor",
        "motor_id": CSV,
        "status": "ok",
        "error_code": None,
        "message": None,
        "nights": {"ok": 3},
        "files": {"read": 3, "unchanged": 0, "growing": 0, "failed": 0, "left": 0},
        "growing": [],
    }
    assert (motors[1]["status"], motors[1]["error_code"]) == ("failed", "log_not_parquet")
    assert motors[1]["nights"] == {"ok": 2, "failed": 1}
    assert run["event"] == "run"
    assert (run["n_motors"], run["n_failed"], run["n_nights"]) == (2, 1, 6)
    assert run["files"] == {"read": 5, "unchanged": 0, "growing": 0, "failed": 1, "left": 0}
    assert re.fullmatch(r"[0-9a-f]{16}", run["run_id"])
    assert (run["errors"], run["alarms"]) == ({"log_not_parquet": 1}, [])
    stages = run["seconds_by_stage"]
    assert all(stages[name] > 0 for name in ("read_s", "clean_s", "fit_s", "residuals_s"))
    whole = sum(stages[name] for name in ("motors_s", "publish_s", "trends_s"))
    assert whole == pytest.approx(run["seconds"], abs=0.01)
    assert run["interrupted"] is False


def test_json_lines_of_a_check(call: Call, fleet: Path) -> None:
    broken = break_log(fleet, PARQUET)
    code, out, _ = call("check", fleet, "--json")
    assert code == 1
    sound, faulty = map(json.loads, out.splitlines())
    assert (sound["motor_id"], sound["faults"]) == (CSV, [])
    assert broken.name in faulty["faults"][0]


def test_stdout_stays_empty_of_all_but_json_when_the_config_is_broken(
    call: Call, fleet: Path
) -> None:
    change(fleet, "fleet.toml", "workers = 2", "workers = 0")
    code, out, err = call("fit-fleet", fleet, "--json")
    assert (code, out) == (2, "")
    assert "execution.workers" in err


# Check


def test_check_prints_a_table_for_each_motor(call: Call, fleet: Path) -> None:
    code, out, err = call("check", fleet)
    assert (code, err) == (0, "")
    *motors, last = out.split("\n\n")
    assert [text.split(":")[0] for text in motors] == [CSV, PARQUET]
    title, columns, *channels, worth = motors[0].splitlines()
    assert worth.startswith("the motor ran ")
    assert "3 nights, 2026-01-02 to 2026-01-04, 0 faults" in title
    assert columns.startswith("channel\trate\tmedian\t")
    assert {line.count("\t") for line in channels} == {columns.count("\t")}
    assert channels[0].split("\t")[:2] == ["pressure_difference", "5 Hz"]
    assert last.startswith("placeholders")


def test_check_is_1_when_a_log_is_broken(call: Call, fleet: Path) -> None:
    broken = break_log(fleet, PARQUET)
    code, out, err = call("check", fleet)
    assert code == 1
    assert any(line.startswith(PARQUET) and "1 fault" in line for line in out.splitlines())
    assert err.startswith(f"{PARQUET}: log_")
    assert broken.name in err


def test_check_is_1_where_there_is_no_log_at_all(call: Call, own_fleet: OwnFleet) -> None:
    """A wrong folder or pattern must not pass for a sound fleet."""
    fleet = own_fleet(CSV, PARQUET)
    logs = fleet.parent.parent / "demo" / "logs"
    for path in (logs / PARQUET).iterdir():
        path.unlink()
    code, out, err = call("check", fleet)
    assert (code, err) == (0, "")
    assert f"no file matches {PARQUET}/*.parquet below {logs}" in out
    for path in (logs / CSV).iterdir():
        path.unlink()
    code, _, err = call("check", fleet)
    assert code == 1
    assert err == (
        f"motor-leakage: no_logs: no log of any motor is below {logs}; correct folders.logs, or "
        "logs.files\n"
    )
    code, _, err = call("check", fleet, "--json")
    assert (code, json.loads(err)["code"]) == (1, "no_logs")


@pytest.mark.parametrize(
    "command", [("check", "--tables"), ("prune", "--tables", "starts", "--keep", "1")]
)
def test_2_where_there_are_no_tables(
    call: Call, own_fleet: OwnFleet, tmp_path: Path, command: tuple[str, ...]
) -> None:
    """A wrong folder must not pass for sound tables, and none is made."""
    elsewhere = tmp_path / "elsewhere"
    name, *options = command
    code, out, err = call(name, own_fleet(CSV), *options, "--output", elsewhere)
    assert (code, out) == (2, "")
    assert err.startswith(f"motor-leakage: no_tables: there are no tables in {elsewhere}")
    assert not elsewhere.exists()


# One night


def test_fit_tells_of_a_night_and_publishes_nothing(call: Call, fleet: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in fleet.parent.parent.rglob("*")}
    code, out, err = call("fit", fleet, CSV, "2026-01-03")
    assert (code, err) == (0, "")
    assert out.startswith(f"{CSV}, night of 2026-01-03: fitted")
    assert {path: path.stat().st_mtime_ns for path in fleet.parent.parent.rglob("*")} == before


def test_fit_trains_on_one_period_and_validates_on_another(call: Call, fleet: Path) -> None:
    periods = ("--train", "2026-01-02..2026-01-03", "--validate", "2026-01-04..2026-01-04")
    code, out, err = call("fit", fleet, CSV, *periods)
    assert (code, err) == (0, "")
    assert out.startswith("CB")
    assert "\nvalidation: fit" in out
    for wrong in ((), ("--validate", "2026-01-02..2026-01-03"), ("2026-01-02", *periods)):
        code, out, err = call("fit", fleet, CSV, *wrong)
        assert (code, out) == (2, "")
        assert "expected a NIGHT, or --train" in err


def test_fit_of_a_night_without_a_log_is_wrong_usage(call: Call, fleet: Path) -> None:
    code, out, err = call("fit", fleet, CSV, "2020-01-03")
    assert (code, out) == (2, "")
    assert f"no log of {CSV} covers the night of 2020-01-03: they cover 2026-01-02 to" in err
    assert "fit-fleet" not in err
    for path in (fleet.parent.parent / "demo" / "logs" / CSV).iterdir():
        path.unlink()
    code, _, err = call("fit", fleet, CSV, "2026-01-03")
    assert code == 2
    assert f"covers the night of 2026-01-03: no file matches {CSV}/*.csv below" in err


def test_fit_of_a_named_log_that_is_absent_says_so(call: Call, fleet: Path) -> None:
    change(fleet, f"motors/{CSV}.toml", f'"{CSV}/*.csv"', '"gone.csv"')
    code, out, err = call("fit", fleet, CSV, "2026-01-03")
    assert (code, out) == (1, "")
    assert err == f"{CSV}: log_missing: gone.csv: named in the config and absent\n"


# Help


def test_help_lists_every_command(call: Call) -> None:
    code, out, _ = call("--help")
    assert code == 0
    assert {"fit-fleet", "check", "demo"} <= set(COMMANDS)
    assert all(command in out for command in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_each_command_shows_an_example(call: Call, command: str) -> None:
    code, out, _ = call(command, "--help")
    assert code == 0
    assert f"Example: motor-leakage {command} " in re.sub(r"\s+", " ", out)


def test_help_shows_what_is_written_in_it(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    """All of it: markup swallows what stands in square brackets."""
    monkeypatch.setenv("COLUMNS", "300")
    for command in COMMANDS:
        _, out, _ = call(command, "--help")
        for parameter in get_command(app).commands[command].params:
            written = parameter.help.replace("\\[", "[")
            assert re.sub(r"\s+", " ", written) in re.sub(r"\s+", " ", out)
    assert "those of [retention] if empty" in call("prune", "--help")[1]


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
        # The first was run before; three nights raise no alarm that could be acknowledged; a
        # database is a server.
        if example == "demo . --nights 3" or example.startswith("ack ") or " sql:" in example:
            continue
        code, _, err = call(*shlex.split(example))
        # The demo's logs leave questions open, which is 1.
        assert code == int(example.startswith("init ")), example
        # Piped, `status` says on stderr what is no motor's.
        said = ("last good run: ", "newest samples: ", "looks: ")
        others = [line for line in err.splitlines() if not line.startswith(said)]
        assert (others if example.startswith("status ") else err.splitlines()) == [], example


def test_version(call: Call) -> None:
    code, out, err = call("--version")
    assert (code, out, err) == (0, f"motor-leakage {version('motor-leakage')}\n", "")


NO_COMMAND_NEEDS = ("pandas", "matplotlib", "plotly", "jinja2", "ruptures", "pyarrow.dataset")
NOT_FOR_STATUS = (*NO_COMMAND_NEEDS, "scipy", "joblib", "pyarrow.compute", "rich")


def loaded_by(code: str, names: Sequence[str]) -> list[str]:
    """Those of some modules that a fresh process has loaded after some code."""
    code += f"\nimport sys; print(*(name for name in {names} if name in sys.modules))"
    command = [sys.executable, "-c", code]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return said.splitlines()[-1].split()


def test_help_imports_nothing_heavy() -> None:
    heavy = "polars", "scipy", "pyarrow", "numpy", "pipeline.run.fleet"
    assert loaded_by("import pipeline.cli", heavy) == []


def test_a_run_begins_without_what_it_does_not_need() -> None:
    """Each of these takes as long to import as a third of the program."""
    unused = (*NO_COMMAND_NEEDS, "duckdb", "scipy", "joblib", "pipeline.night.fit_night")
    assert loaded_by("import pipeline.run.fleet", unused) == []


def test_status_neither_fits_nor_draws(fleet: Path) -> None:
    code = (
        "import contextlib, pipeline.cli.state as s; from pathlib import Path; from typer import "
        f"Exit\nwith contextlib.suppress(Exit): s.status(Path({str(fleet)!r}))"
    )
    unused = (*NOT_FOR_STATUS, "pipeline.night.fit_night", "leakage.course.monitoring")
    assert loaded_by(code, unused) == []


# As people start it


def test_the_installed_command_from_demo_to_tables(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = Path(sys.executable).with_name("motor-leakage")

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [str(command), *arguments],
            cwd=tmp_path,
            env=os.environ | {"NO_COLOR": "1"},
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )

    made = run("demo", ".", "--nights", "1", "--minutes", "30", "--jobs", "1")
    assert made.returncode == 0, made.stderr
    fitted = run("fit-fleet", "configs/fleet.toml")
    assert (fitted.returncode, fitted.stderr) == (0, "")
    assert fitted.stdout.count(": ok (1 ok)") == 6
    assert "\x1b" not in fitted.stdout
    found = pl.read_parquet(tmp_path / "out" / "tables" / "fits" / "**" / "*.parquet")
    assert found.filter("is_primary")["motor_id"].n_unique() == 6
    (tmp_path / "mine" / "demo").mkdir(parents=True)
    (tmp_path / "mine" / "demo" / "notes.txt").touch()
    monkeypatch.chdir(tmp_path)
    code, _, err = call("demo", "mine")
    assert code == 2
    assert "name another folder" in err
