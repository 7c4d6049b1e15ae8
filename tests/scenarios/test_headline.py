"""A motor's headline: the same figures and words on page, terminal, mail and in the tables."""

from __future__ import annotations

import datetime as dt
import html
import json
import os
import pty
import re
import subprocess
import sys
from typing import Any

import pytest

from pipeline.config import load_fleet
from pipeline.config.alarms import Email
from pipeline.notification.delivery import SUMMARY, Delivery
from pipeline.notification.mail import message_of
from pipeline.run.notification import summary_rows
from tests.scenarios.command import ROOT
from tests.scenarios.covering import covers
from tests.scenarios.fleets import ScenarioFleet


def change_of(row: dict[str, Any]) -> str:
    """The change of a row in words, rounded as a reader would."""
    value, *ends = (row[f"leakage_change_{end}"] for end in ("percent", "lower", "upper"))
    digits = 0 if abs(value) >= 10 else 1
    low, high = (f"{end:z.{digits}f}" for end in ends)
    return f"{value:+z.{digits}f} % [{low}, {high}]"


def day(date: dt.date | None) -> str:
    return "" if date is None else f"{date.day} {date:%B %Y}"


@pytest.fixture(params=["demo", "shared_plant", "others"])
def fleet(request: pytest.FixtureRequest) -> ScenarioFleet:
    found: ScenarioFleet = request.getfixturevalue(request.param)
    return found


def summary(fleet: ScenarioFleet) -> dict[str, str]:
    """Paragraphs of the weekly mail by motor."""
    loaded = load_fleet(fleet.config)
    document = {"type": SUMMARY, "fleet": loaded.name, "changes": summary_rows(loaded)}
    delivery = Delivery("x", json.dumps(document, default=str).encode())
    text = message_of(delivery, Email()).get_content()
    return {part.partition(":")[0]: " ".join(part.split()) for part in text.split("\n\n")}


@covers("status --long", "report --to --nights")
def test_a_motor_has_one_headline(fleet: ScenarioFleet, tmp_path: Any) -> None:
    brief, whole = fleet.run("status"), fleet.run("status", "--long")
    listed = {line.split("\t")[0]: line.split("\t") for line in brief.out.splitlines()[1:]}
    long = {line.split("\t")[0]: line.split("\t") for line in whole.out.splitlines()[1:]}
    mails, nights = summary(fleet), fleet.table("nights")
    assert fleet.run("report", "--to", tmp_path / "pages", "--nights", 1).code == 0
    for row in fleet.table("latest").to_dicts():
        motor, change = row["motor_id"], change_of(row)
        newest = nights.filter(motor_id=motor).to_dicts()[-1]
        assert change in newest["sentence"]
        assert newest["advice"] == row["advice"]
        page = (tmp_path / "pages" / "motors" / f"{motor}.html").read_text("utf-8")
        (shown,) = re.findall(r'id="headline">(.*?)</p>', html.unescape(page))
        order = row["advice"] if row["state"] != "ok" or "Nothing" in row["advice"] else ""
        for place in (shown, mails[motor]):
            assert change in place
            assert day(row["onset"]) in place
            assert order in place
        since = str(row["onset"] or row["state_since"] or "")
        assert listed[motor][1:] == [
            *(row["state"].replace("_", " "), listed[motor][2], change, since, row["advice"])
        ]
        assert long[motor][:6] == listed[motor]
        assert long[motor][7].startswith(row["sentence"])
        assert float(listed[motor][2]) == pytest.approx(row["own_leakage_l_per_min"], rel=0.005)


def test_status_of_six_motors_takes_ten_lines_of_100_columns(demo: ScenarioFleet) -> None:
    main, terminal = pty.openpty()
    command = [sys.executable, "-m", "pipeline.cli", "status", demo.config]
    shown = {"PYTHONPATH": str(ROOT), "COLUMNS": "100", "NO_COLOR": "1"}
    subprocess.run(command, env=os.environ | shown, stdout=terminal, check=True)
    os.close(terminal)
    text = re.sub(r"\x1b\[[0-9;]*m", "", os.read(main, 1 << 16).decode())
    os.close(main)
    lines = text.splitlines()
    assert len(lines) <= 10
    assert max(map(len, lines)) <= 100
    for row in demo.table("latest").to_dicts():
        (line,) = (line for line in lines if line.startswith(row["motor_id"]))
        assert f" {row['state']} " in line
        assert change_of(row) in line
        assert row["advice"][:20] in line
