"""All files of a fleet: their faults at once, their folders, what is shipped."""

from __future__ import annotations

import datetime as dt
import os
import tomllib
from pathlib import Path

import pytest

from pipeline.demo import shipped_configs
from tests.pipeline.config.shipped import MOTOR, OIL, TYPE, add, change, faults, load, only_fault

MOTOR_IDS = ["CB1120-01", "CB1120-02", "CB400-01", "CB400-02", "CB560-01", "CB560-02"]

# What is shipped


def test_shipped_configs_load(configs: Path) -> None:
    fleet = load(configs)
    assert [spec.motor_id for spec in fleet.motors] == MOTOR_IDS
    assert fleet.name == "Demo fleet"
    assert fleet.log_root == configs.parent / "demo" / "logs"
    assert fleet.output == configs.parent / "out"
    for spec in fleet.motors:
        for mode in ("none", "fixed", "estimated"):
            columns = spec.motor(dt.date(2026, 1, 2), mode).columns
            assert columns[-3:] == ("one", "known", "measured")


@pytest.mark.parametrize(("motor_type", "count"), [("CB400", 24), ("CB560", 32), ("CB1120", 64)])
def test_shipped_counts_are_those_of_the_model(motor_type: str, count: int) -> None:
    # model.md, section 3: 8 interfaces a cam row, 3, 4 and 8 rows.
    document = tomllib.loads((shipped_configs() / f"motor_types/{motor_type}.toml").read_text())
    assert [path["count"] for path in document["path"]] == [count] * 4


def test_all_faults_of_all_files_at_once(configs: Path) -> None:
    change(configs, MOTOR, 'motor_type = "CB400"', 'motor_type = "CB500"')
    change(configs, MOTOR, 'unit = "bar"', 'unit = "hPa"')
    change(configs, MOTOR, "resolution = 0.1", 'resolution = "fine"')
    change(configs, TYPE, "radius_mm = 35.0", "radius_mm = -35.0")
    change(configs, OIL, "density_15_c_kg_per_m3", "density")
    change(configs, "fleet.toml", "end_hour = 6", "end_hour = 24")
    (configs / "oils/vg32.toml").write_text("name = \n", encoding="utf-8")
    found = {(fault.file, fault.key): fault.message for fault in faults(configs)}
    assert found.pop((MOTOR, "motor_type")) == 'got "CB500"; expected one of CB1120, CB400, CB560'
    for file, key, words in (
        (MOTOR, "channels.pressure_difference.resolution", 'got "fine"; expected a valid number'),
        (TYPE, 'path "piston_ring" radius_mm', "got -35.0; expected greater than 0"),
        (OIL, "density_15_c_kg_per_m3", "is missing"),
        (OIL, "density", "check its spelling"),
        ("fleet.toml", "nights.end_hour", "got 24; expected less than or equal to 23"),
        ("oils/vg32.toml", "", "is not TOML"),
    ):
        assert words in found.pop((file, key))
    # The unit is judged with the other channels, once each channel by itself is sound.
    assert found.keys() <= {(MOTOR, "channels.pressure_difference.unit")}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"motor_id = CB400", "is not TOML"),
        (b"motor_id = 'a'\nmotor_id = 'b'", "is not TOML"),
        ("motor_id = 'ü'".encode("latin-1"), "is not UTF-8"),
        ("motor_id = 'a'".encode("utf-16"), "is not UTF-8"),
        (bytes(range(256)), "is not"),
        *(
            (b"a = " + one, "is not TOML")
            for one in (b"[" * 100_000, b"{a=" * 100_000, b"9" * 10_000)
        ),
        (b".".join([b"a"] * 1500) + b" = 1", "is not TOML"),
        (b"motor_id = 0x" + b"f" * 10_000, "is not TOML"),
    ],
)
def test_a_file_that_is_no_toml_leaves_the_others_judged(
    configs: Path, content: bytes, words: str
) -> None:
    (configs / MOTOR).write_bytes(content)
    change(configs, "motors/CB400-02.toml", 'oil = "vg68"', 'oil = "vg100"')
    found = {fault.file: fault for fault in faults(configs)}
    assert found.keys() == {MOTOR, "motors/CB400-02.toml"}
    assert words in found[MOTOR].message


@pytest.mark.parametrize("kind", ["pipe", "device", "huge"])
def test_what_never_ends_is_told_and_not_read(
    configs: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = configs / MOTOR
    if kind == "huge":
        monkeypatch.setattr("pipeline.config.loading.LARGEST", path.stat().st_size - 1)
    else:
        path.unlink()
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    words = "is larger than" if kind == "huge" else "is no regular file"
    assert words in next(fault.message for fault in faults(configs) if fault.file == MOTOR)


def test_many_events_are_judged_by_their_oils(configs: Path) -> None:
    event = '\n[[events]]\ndate = 2026-01-{:02}\nkind = "overhaul"\n'
    add(configs, MOTOR, "".join(event.format(day) for day in range(1, 29)) * 36)
    assert "at most 1000" in only_fault(configs).message


def test_a_file_may_begin_with_a_byte_order_mark(configs: Path) -> None:
    """As editors of Windows write it."""
    for file in ("fleet.toml", MOTOR, TYPE, OIL):
        path = configs / file
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    assert len(load(configs).motors) == 6


def test_folders_that_are_not_there(configs: Path) -> None:
    for name in ("motors", "motor_types", "oils"):
        (configs / name).rename(configs / f"old_{name}")
    found = faults(configs)
    assert {fault.file for fault in found} == {"motors", "motor_types", "oils"}
    assert all("expected a folder at" in fault.message for fault in found)


NO_FOLDERS = {
    "a null character": "a\\u0000b",
    "a long name": "x" * 300,
    "links in a circle": "../circle/x",
    "nothing": "",
}


@pytest.mark.parametrize("name", NO_FOLDERS.values(), ids=NO_FOLDERS.keys())
@pytest.mark.parametrize("key", ["motors", "logs", "output"])
def test_folders_that_cannot_be(configs: Path, key: str, name: str) -> None:
    (configs.parent / "circle").symlink_to("circle")
    text = (configs / "fleet.toml").read_text("utf-8")
    lines = [line for line in text.splitlines() if not line.startswith(f"{key} = ")]
    at = next(number for number, line in enumerate(lines) if line.startswith("[folders]"))
    lines.insert(at + 1, f'{key} = "{name}"')
    (configs / "fleet.toml").write_text("\n".join(lines), "utf-8")
    (fault,) = (one for one in faults(configs) if one.file == "fleet.toml")
    assert fault.key == f"folders.{key}"
    assert fault.message.startswith(f'got "{name}"; expected ')


REACHES = "{} of CB400-01 reaches into it"


@pytest.mark.parametrize(
    ("logs", "output", "pattern", "words"),
    [
        *(
            ("../logs", output, "CB400-01/*.csv", "another folder than that of the logs")
            for output in ("../logs", "../x/../logs/.")
        ),
        *(
            (logs, "../out", "CB400-01/*.csv", "expected a folder without the logs")
            for logs in ("../out/staging", "../out/tables/fits")
        ),
        ("..", "../CB400-01/", "CB400-01/*.csv", REACHES),
        *(
            ("..", "../out", pattern, REACHES)
            for pattern in ("**/*.csv", "o?t/**/*.csv", "*/*.csv")
        ),
        ("..", "../out/deep", "*/*.csv", ""),
        *(("..", "../out", glob, "") for glob in ("logs/**/*.csv", "*.csv")),
    ],
)
def test_output_and_logs_that_spoil_each_other(
    configs: Path, logs: str, output: str, pattern: str, words: str
) -> None:
    change(configs, "fleet.toml", '"../demo/logs"', f'"{logs}"')
    change(configs, "fleet.toml", '"../out"', f'"{output}"')
    change(configs, MOTOR, "CB400-01/*.csv", pattern)
    if not words:
        assert load(configs).output == (configs / output).resolve()
        return
    fault = only_fault(configs)
    assert (fault.file, fault.key) == ("fleet.toml", "folders.output")
    assert fault.message.startswith(f'got "{output}"; expected ')
    assert words.format(pattern) in fault.message


def test_logs_beside_the_tables_and_files_that_are_no_toml_spoil_nothing(configs: Path) -> None:
    change(configs, "fleet.toml", '"../demo/logs"', '"../out/logs"')
    (configs / "motors" / "README.md").write_text("notes")
    (configs / "motors" / "CB400-01.toml~").write_text("backup")
    fleet = load(configs)
    assert (fleet.log_root, len(fleet.motors)) == (configs.parent / "out" / "logs", 6)
