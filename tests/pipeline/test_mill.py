"""A plant's first day: from a folder of logs of other physics to what is told of each motor."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.schema import LATEST
from pipeline.store.tables import read_table, whole_file
from tests.pipeline.calling import Call
from tests.pipeline.mill import CUT, SWAPPED, WORSE_BY, WORSENS, write_mill

ANSWERS = {"time_zone": "Europe/Berlin", "motor_type": "CB560", "oil": "vg68"}


def test_a_mills_first_day_in_four_commands(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_mill(tmp_path / "logs", shift_h=4)
    monkeypatch.chdir(tmp_path)
    answers = [one for key in ANSWERS for one in ("--answer", f"{key}={ANSWERS[key]}")]
    fleet = Path("fleet/fleet.toml")

    code, shown, _ = call("init", "logs", *answers, "--write")
    assert code == 0
    days = "21 files, 2026-03-02 to 2026-03-22 (21 days)"
    assert f"Walze1: {days}, time Zeit %d.%m.%Y %H:%M:%S, zone Europe/Berlin" in shown
    stray = Path("logs/Walze1/old.csv")
    stray.write_bytes(next(Path("logs/Walze1").iterdir()).read_bytes())
    code, noted, said = call("check", fleet)
    assert code == 1
    assert "Walze2_20260320.csv on: columns changed? oil temperature and speed look swap" in said
    assert "Walze3_20260322.csv: the last line has no end" in noted
    assert "no motor claims 1 log: Walze1/old.csv" in noted
    code, _, said = call("fit-fleet", fleet)
    assert code == 1
    assert "Walze2: columns_changed: from Walze2/Walze2_20260320.csv on:" in said
    assert "Walze2: columns_changed: night 2026-03-20: columns changed?" in said
    assert "no motor claims 1 log: Walze1/old.csv" in said
    assert "Walze3_20260322.csv: 1 last row without a line end" in said
    code, _, _ = call("report", fleet)
    assert code == 0

    output = Path("fleet/out")
    rows = read_table(whole_file(output, LATEST), LATEST).to_dicts()
    latest = {row["motor_id"]: row for row in rows}
    worse = latest[WORSENS.name]
    assert worse["state"] in ("warning", "alarm")
    assert worse["tonight_change_lower"] < WORSE_BY < worse["tonight_change_upper"]
    assert worse["since_lower"].isoformat() <= "2026-03-14" <= worse["since_upper"].isoformat()
    for drive in (SWAPPED, CUT):
        assert latest[drive.name]["state"] == "ok"
        assert latest[drive.name]["sentence"].startswith("no change of more than ")
        assert latest[drive.name]["smallest_change"] < 0.1
        page = (output / f"report/motors/{drive.name}.html").read_text("utf-8")
        assert "No change of more than" in page
    assert "columns changed?" in latest[SWAPPED.name]["failure"]
    # Cut after 70 % of the shift.
    for words in ("2.8 h of log, 4.0 h in the nights before", "1 last row without a line end"):
        assert words in latest[CUT.name]["log_note"]
        assert words in (output / f"report/motors/{CUT.name}.html").read_text("utf-8")
