"""A newcomer's first steps: the version, logs of the demo, a config proposed from logs."""

from __future__ import annotations

import json
import shutil
from importlib.metadata import version
from pathlib import Path

import pyarrow.parquet as pq

from pipeline.demo.fleet import SLEEVE
from tests.scenarios.command import run_command
from tests.scenarios.covering import covers
from tests.scenarios.fleets import SEQUENTIAL, ScenarioFleet

ANSWERS = (
    "unit of pressure_difference=bar", "unit of oil_temperature=degC", "unit of speed=rpm",
    "unit of leakage_flow=l/min", "motor_type=CB400", "oil=vg68",
)  # fmt: skip


@covers("--version")
def test_the_version_is_that_of_the_package(tmp_path: Path) -> None:
    done = run_command("--version", process=True)
    assert (done.code, done.out) == (0, f"motor-leakage {version('motor-leakage')}\n")


@covers("demo --nights --minutes --rate --seed --last-night --jobs")
def test_the_demo_is_as_long_as_asked_for_and_the_same_for_a_seed(tmp_path: Path) -> None:
    def made(name: str, seed: int, jobs: int) -> dict[str, bytes]:
        done = run_command(
            "demo", tmp_path / name, "--nights", 2, "--minutes", 6, "--rate", 2, "--seed", seed,
            "--last-night", "2026-03-08", "--jobs", jobs,
        )  # fmt: skip
        assert str(tmp_path / name / "configs" / "fleet.toml") in done.out
        logs = tmp_path / name / "demo" / "logs"
        return {path.name: path.read_bytes() for path in sorted(logs.rglob("*.*"))}

    first = made("first", 5, 1)
    assert made("again", 5, 2) == first
    other = made("other", 6, 1)
    assert other.keys() == first.keys()
    assert other.items().isdisjoint(first.items())
    assert len(first) == 12
    log = tmp_path / "first" / "demo" / "logs" / "CB400-02" / "CB400-02_2026-03-08.parquet"
    stamps = pq.read_table(log)["timestamp"].to_pylist()
    assert 0.8 * 720 <= len(stamps) <= 720  # up to a twentieth at a time is missing
    assert 5.5 * 60 <= (stamps[-1] - stamps[0]).total_seconds() <= 360
    truth = json.loads((tmp_path / "first" / "demo" / "truth.json").read_text())
    assert list(truth["motors"]["CB400-02"]["nights"]) == ["2026-03-07", "2026-03-08"]


@covers("init --to --answer --write --add")
def test_a_proposed_fleet_gives_the_figures_of_the_stated_one(plant: ScenarioFleet) -> None:
    logs, aside = plant.folder / "logs", plant.folder / "aside"
    for motor in ("worn", "calm"):
        shutil.move(logs / motor, aside / motor)
    ask = plant.folder / "mine"
    asked = run_command("init", logs, "--to", ask, folder=plant.folder)
    assert asked.code == 1
    assert all(f"--answer '{answer.partition('=')[0]}=" in asked.out for answer in ANSWERS)
    answers = [word for answer in ANSWERS for word in ("--answer", answer)]
    run_command("init", logs, "--to", ask, *answers, folder=plant.folder)
    assert not ask.exists()
    written = run_command("init", logs, "--to", ask, *answers, "--write", folder=plant.folder)
    assert (written.code, written.err) == (0, "")
    assert [path.stem for path in (ask / "motors").iterdir()] == ["broken"]
    assert run_command("check", ask / "fleet.toml", folder=plant.folder).code == 0
    proposed = ScenarioFleet(ask, plant.motors, plant.plan)
    with (ask / "fleet.toml").open("a", encoding="utf-8") as file:
        file.write(SEQUENTIAL)
    assert run_command("fit-fleet", ask / "fleet.toml", folder=plant.folder).code == 0
    mine, stated = proposed.newest("broken"), plant.newest("broken")
    assert (mine["state"], mine["cause"]) == ("warning", SLEEVE)
    # Its nights end at another hour, as the logs do: the night of the onset is the same by its log.
    began = [
        next(row["first_sample"] for row in rows if row["night"] == newest["onset"])
        for rows, newest in ((proposed.nights("broken"), mine), (plant.nights("broken"), stated))
    ]
    assert began[0] == began[1]
    change = "leakage_change_percent"
    assert abs(mine[change] - stated[change]) < 0.5
    shutil.move(aside / "calm", logs / "calm")
    before = (ask / "motors" / "broken.toml").read_bytes()
    refused = run_command("init", logs, "--to", ask, *answers, "--write", folder=plant.folder)
    assert refused.code == 2
    added = run_command(
        "init", logs, "--to", ask, *answers, "--add", "--write", folder=plant.folder
    )
    assert added.code == 0, added.out
    assert {path.stem for path in (ask / "motors").iterdir()} == {"broken", "calm"}
    assert (ask / "motors" / "broken.toml").read_bytes() == before
    assert "calm" in added.out
