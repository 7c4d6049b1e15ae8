"""A motor's files and nights: which are new, which belong together, and what is remembered."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pipeline.logs.motor_logs
import pipeline.run.night_plan
from pipeline.ingest import read_log
from tests.pipeline.simulated import NIGHT, SECOND_US, motor_toml, write_configs, write_log
from tests.pipeline.workshop import DAY, MINI, MINUTES, QUICK, Workshop, check_same_figures, part


@pytest.fixture
def other(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    return Workshop.at(tmp_path_factory.mktemp("other"))


@pytest.mark.parametrize(
    "spans",
    [
        pytest.param([(0, 1), (1, 1439), (1439, 1440)], id="single-rows"),
        pytest.param([(0, 800), (700, 1440)], id="shared-rows"),
    ],
)
def test_a_night_in_several_files_is_the_same_night(
    workshop: Workshop, other: Workshop, spans: list[tuple[int, int]]
) -> None:
    workshop.log(NIGHT)
    assert workshop.run().status == "ok"
    operation, values = other.night(NIGHT)
    for number, span in enumerate(spans):
        rows = slice(*span)
        # Names in another order than time.
        write_log(
            other.logs / f"{99 - number}.parquet", operation.time_us[rows], part(values, rows)
        )
    assert other.run().status == "ok"
    shares = sum(last - first for first, last in spans) > 1440  # which `quality` counts
    check_same_figures(workshop, other, "log_files", *["quality"] * shares)
    assert other.rows("log_files").height == len(spans)


def test_each_file_is_read_once_though_it_is_of_two_nights(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[str] = []

    def counted(path: Path, *source: Any) -> Any:
        read.append(path.name)
        return read_log(path, *source)

    monkeypatch.setattr(pipeline.logs.motor_logs, "read_log", counted)
    operation, values = workshop.night(NIGHT)
    half = int((8 * 3600 - MINUTES * 30) * SECOND_US)
    for day in range(2):  # each over the end of a night
        stamps = operation.time_us + half + day * 86_400 * SECOND_US
        write_log(workshop.logs / f"{day}.parquet", stamps, values)
    workshop.run()
    assert sorted(read) == [f"{day}.parquet" for day in range(2)]
    workshop.run()
    assert len(read) == 2
    assert workshop.statuses() == {NIGHT + day * DAY: "ok" for day in range(3)}
    files = workshop.rows("log_files").select("path", "night").rows()
    assert files == [(f"M1/{day}.parquet", NIGHT + day * DAY) for day in range(2)]
    blocks = workshop.rows("quality").filter(channel="time_base", reason="any")
    assert blocks["n_samples"].to_list()[::2] == [720, 720]


def test_a_night_is_judged_with_the_last_model_however_far(workshop: Workshop) -> None:
    """Night 2 stood still, so night 3 looks back on night 1, also where that is corrected."""
    workshop.log(NIGHT)
    operation, values = workshop.night(NIGHT + DAY)
    values["speed"] = 0.1 + 1e-3 * np.sin(operation.pressure_bar)
    values["pressure_difference"] = 5.0 + values["speed"]
    write_log(workshop.logs / f"{NIGHT + DAY}.parquet", operation.time_us, values)
    workshop.log(NIGHT + 2 * DAY)
    workshop.run()
    assert list(workshop.statuses().values()) == ["ok", "stood_still", "ok"]
    before = workshop.rows("nights")["previous_model_fit_percent"][2]
    # Another night 1, whose gap leaks three times as much.
    operation, values = workshop.night(NIGHT)
    values["leakage_flow"] = 3.0 * values["leakage_flow"]
    write_log(workshop.logs / f"{NIGHT}.parquet", operation.time_us, values)
    assert workshop.run().nights == (NIGHT,)
    after = workshop.rows("nights")["previous_model_fit_percent"][2]
    assert after < before - 50.0


ROLLER = """
[[path]]
name = "cam_roller"
law = "speed_curve"
source = "invented"
count = 8
coefficients = [1.6e-3, 4.0e-3]
speed_range_rpm = [0.0, 125.0]
reference_pressure_bar = 200.0
reference_viscosity_mpa_s = 35.0
"""


@pytest.fixture
def _two_nights_decide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline.run.night_plan, "ROLLER_NIGHTS", 2)


def with_roller(folder: Path) -> Workshop:
    """A motor whose nights may tell the scale of its rollers."""
    made = Workshop(folder)
    write_configs(folder, {"M1": motor_toml("M1", "MINI")}, {"MINI": MINI + ROLLER}, QUICK)
    made.logs.mkdir(parents=True, exist_ok=True)
    return made


def forms(made: Workshop) -> list[bool]:
    return ["scale_cam_roller" in names for names in made.rows("fits")["coefficient_names"]]


@pytest.mark.usefixtures("_two_nights_decide")
def test_what_is_decided_stands_until_a_new_baseline(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = with_roller(tmp_path)
    for number in (1, 2, 3):
        made.log(NIGHT + number * DAY, seed=number)
    made.run()
    # No night would be reason enough any more: neither a late log nor a night made anew reopens it.
    monkeypatch.setattr(pipeline.run.night_plan, "MOST", 1.1)
    made.log(NIGHT, seed=0)
    assert made.run().nights == (NIGHT,)
    assert forms(made) == [True] * 4
    event = f'[[events]]\ndate = {NIGHT + 2 * DAY}\nkind = "overhaul"\n'
    motor = motor_toml("M1", "MINI", more=event)
    write_configs(made.folder, {"M1": motor}, {"MINI": MINI + ROLLER}, QUICK)
    assert made.run().n_refitted == 4
    assert forms(made) == [False] * 4
