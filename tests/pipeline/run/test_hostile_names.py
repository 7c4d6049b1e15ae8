"""Names made to harm, of files and in them: nothing runs, nothing is written but below the output,
and tables, terminals, spreadsheets and pages show what they are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest

from pipeline.config import ConfigError, load_fleet
from pipeline.logs.finding import find_logs
from pipeline.run.fleet import RunRequest, run_fleet
from tests.pipeline.simulated import load_motor, motor_toml, write_configs

FILE_NAMES = [
    *("$(touch harmed).parquet", "`touch harmed`.parquet", "; touch harmed;.parquet"),
    *("|touch harmed.parquet", "-rf.parquet", "--help.parquet", "~.parquet", "%s%n.parquet"),
    *("=cmd|' C'!A0.parquet", "@SUM(1+1).parquet", "+1.parquet", "\t=1.parquet", '"=1.parquet'),
    *("a\n=1.parquet", "a\r\nb.parquet", "\x1b[2J\x1b]0;x\x07.parquet"),
    *("\u202egnp.parquet", "\u2066a\u2069.parquet", "a\u2028b.parquet", "\ufeffa.parquet"),
    *("<script>window.harmed=1<", "'\"><img src=x onerror=harmed>.parquet", "{{7*7}}.parquet"),
    *("x\\..\\x.parquet", "C:\\x.parquet", "CON.parquet"),
    *("[red]x[blue].parquet", "[@click=harmed].parquet"),
    *("x" * 247 + ".parquet", "\udc80\udcff.parquet", "a'b\"c.parquet", "a..parquet", " .parquet"),
]
"""What a file may be called here: all but a slash and a zero byte."""


def files_below(folder: Path) -> set[Path]:
    return {path for path in folder.rglob("*") if not path.is_dir()}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fleet of one motor, all logs of which have such a name and are no logs, after a run."""
    folder = tmp_path_factory.mktemp("hostile")
    fleet_file = write_configs(folder, {"M1": motor_toml("M1", files='"M1/**/*"')})
    logs = folder / "logs" / "M1" / "a\n 2026-01-02"
    logs.mkdir(parents=True)
    for number, name in enumerate(FILE_NAMES):
        (logs / name).write_bytes(
            b"PAR1" if number % 2 else b"time,=1+1\n" + name.encode("utf-8", "replace")
        )
    before = files_below(folder)
    fleet = load_fleet(fleet_file)
    execution = fleet.execution.model_copy(update={"backend": "sequential"})
    run_fleet(RunRequest(replace(fleet, execution=execution)))
    assert all(path.is_relative_to(folder / "out") for path in files_below(folder) - before)
    assert before <= files_below(folder)
    return folder


def log_files(folder: Path) -> pl.DataFrame:
    return pl.read_parquet(folder / "out" / "tables" / "log_files" / "**" / "*.parquet")


def test_each_file_has_a_row_and_a_name_that_can_be_shown(made: Path) -> None:
    rows = log_files(made)
    assert rows.height == len(set(FILE_NAMES))
    assert rows["path"].n_unique() == rows.height
    for column in ("path", "message"):
        assert all(text.isprintable() for text in rows[column].to_list())
    assert set(rows["error_code"]) == {"log_not_parquet", "log_truncated"}


def test_two_names_that_look_the_same_are_two_files(tmp_path: Path) -> None:
    spec = load_motor(tmp_path, motor_toml("M1", files='"M1/*.csv"'))
    folder = spec.log_root / "M1"
    folder.mkdir(parents=True)
    for name in ("a\n.csv", "a\\n.csv"):
        (folder / name).write_text("x")
    names, absent, _ = find_logs(spec)
    assert sorted(path.name for path in names.values()) == ["a\n.csv", "a\\n.csv"]
    assert list(names) == ["M1/a\\n.csv", "M1/a\\n.csv'"]
    assert absent == []


def test_links_that_go_round_end(tmp_path: Path) -> None:
    spec = load_motor(tmp_path, motor_toml("M1", files='"**/**/*.csv"'))
    folder = spec.log_root / "a" / "b"
    folder.mkdir(parents=True)
    (folder / "log.csv").write_text("x")
    (folder / "round").symlink_to(spec.log_root)
    (folder / "self.csv").symlink_to("self.csv")
    names, *_ = find_logs(spec)
    assert "a/b/log.csv" in names


def test_faults_of_a_config_show_what_prints(tmp_path: Path) -> None:
    hostile = '"\\u001b[2J\\n\\u202e" = 1\nname = "\\u001b[2J\\n</script>"\n'
    fleet = write_configs(tmp_path, {"M1": hostile + motor_toml("M1")})
    with pytest.raises(ConfigError) as raised:
        load_fleet(fleet)
    assert all(line.isprintable() for line in raised.value.message.split("\n"))
    assert len(raised.value.message.split("\n")) == 1 + len(raised.value.faults)
