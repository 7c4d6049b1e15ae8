"""`init` on an MCAP file of several motors, by topics or by fields of one topic."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import pytest

from pipeline.config import load_fleet
from pipeline.demo import shipped_configs
from pipeline.ingest import read_log
from pipeline.setup.fleet_files import fleet_files, write_fleet
from pipeline.setup.propose import propose
from tests.pipeline.ingest.writers import mcap_bytes
from tests.pipeline.setup.plants.plant import CHANNELS, ROWS, START, value

T0_NS = int(START.timestamp()) * 10**9
KINDS = {"pressure": "dp", "oil_temperature": "temp", "speed": "speed", "case_drain": "flow"}
UNITS = {"pressure": "bar", "oil_temperature": "degC", "speed": "rpm", "case_drain": "l/min"}

Messages = Sequence[tuple[str, int, bytes]]


def messages_of(content: Callable[[int], Mapping[str, object]]) -> Messages:
    """A message of each topic in each second."""
    return [
        (topic, T0_NS + row * 10**9, json.dumps(one).encode())
        for row in range(ROWS)
        for topic, one in content(row).items()
    ]


def by_topics(row: int) -> Mapping[str, object]:
    return {
        f"/mill3/motor{m}/{name}": {"value": value(kind, m, row)}
        for m in (1, 2)
        for name, kind in KINDS.items()
    }


def by_fields(row: int) -> Mapping[str, object]:
    readings = {m: {name: value(kind, m, row) for name, kind in KINDS.items()} for m in (1, 2)}
    return {"/mill3": {f"motor{m}": own for m, own in readings.items()}}


@pytest.mark.parametrize(
    ("messages", "names", "pressure"),
    [
        (messages_of(by_topics), ("/mill3/motor1", "/mill3/motor2"), "/mill3/{}/pressure"),
        (messages_of(by_fields), ("motor1", "motor2"), "{}.pressure"),
    ],
    ids=["topics", "fields"],
)
def test_each_motor_has_its_channels(
    tmp_path: Path, messages: Messages, names: tuple[str, ...], pressure: str
) -> None:
    log = tmp_path / "plant.mcap"
    log.write_bytes(mcap_bytes(messages))
    first = propose(log, {})
    assert tuple(one.name for one in first.motors) == names
    # A pressure that may be any is asked for, and so are the units.
    answers = {
        f"{one.motor_id}.pressure_difference": pressure.format(f"motor{number}")
        for number, one in enumerate(first.motors, 1)
    }
    answers["time"] = "log_time"
    asked = {one.key for one in propose(log, answers).questions}
    answers |= {key: UNITS[key.removeprefix("unit of ").rpartition(".")[2]] for key in asked}
    proposal = propose(log, answers)
    assert proposal.questions == ()
    folder = tmp_path / "fleet"
    files = fleet_files(proposal, folder, "CB560", "vg68")
    write_fleet(files, folder, shipped_configs(), "CB560")
    for number, spec in enumerate(load_fleet(folder / "fleet.toml").motors, 1):
        channels = read_log(log, spec.file.logs, spec.file.channels).channels
        for kind in KINDS.values():
            expected = [value(kind, number, row) for row in range(ROWS)]
            assert channels[CHANNELS[kind]].value.tolist() == pytest.approx(expected)
