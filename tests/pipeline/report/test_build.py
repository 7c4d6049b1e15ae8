"""The folder of the report: complete, small, made anew only where something has changed."""

from __future__ import annotations

import datetime as dt
import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import StoreError
from pipeline.report.build import STATES, ReportResult, build_report
from pipeline.report.charts import residual_chart
from pipeline.report.plotly_json import figure, numbers, script_json
from pipeline.schema import PREDICTIONS, RESIDUAL_TESTS
from pipeline.store.tables import read_table
from tests.pipeline.calling import contents, refused
from tests.pipeline.report.conftest import change_table, demo_fleet, rows_with, rows_without
from tests.pipeline.written import night_file

MOTORS = [f"CB{n}-0{i}" for n in (1120, 400, 560) for i in (1, 2)]
NIGHTS = [dt.date(2026, 1, 2), dt.date(2026, 1, 3), dt.date(2026, 1, 4)]
MOTOR = "CB560-01"


def build(output: Path, **more: Any) -> ReportResult:
    return build_report(demo_fleet(output), more.pop("folder", output / "report"), **more)


def packed(path: Path) -> Any:
    """The payload of a motor's page, or of a night's script."""
    marks = r'id="payload">(.*?)</script>' if path.suffix == ".html" else r"^\w+\.night\((.*)\);\n$"
    (payload,) = re.findall(marks, path.read_text("utf-8"), re.DOTALL)
    return json.loads(payload)


def times(folder: Path) -> dict[str, int]:
    return {name: (folder / name).stat().st_mtime_ns for name in contents(folder)}


class Links(HTMLParser):
    """Resources and links of a page."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.feed(page.read_text("utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:  # noqa: ARG002
        self.targets += [value or "" for name, value in attrs if name in ("href", "src")]


def test_the_folder_is_complete_and_leads_nowhere_else(report: Path) -> None:
    pages = sorted(report.rglob("*.html"))
    assert [page.stem for page in pages] == ["glossary", "index", *MOTORS]
    assert sorted((report / "data").rglob("*.js")) == [
        report / "data" / motor / f"{night}.js" for motor in MOTORS for night in NIGHTS
    ]
    for page in pages:
        for target in Links(page).targets:
            if not target.startswith(("#", "data:,")):
                assert (page.parent / target.split("#")[0]).resolve().is_relative_to(report)
                assert (page.parent / target.split("#")[0]).exists(), target
    # Ten terms and the states, a link away from each page.
    glossary, *others = pages
    assert glossary.read_text("utf-8").count("<dd>") == 14 + len(STATES)
    assert all(any("glossary.html" in name for name in Links(page).targets) for page in others)


def test_nothing_new_nothing_written(built: Path) -> None:
    before = times(built / "report")
    second = build(built)
    assert (second.n_motors, second.n_nights) == (6, 0)
    assert (second.n_written, second.n_removed) == (0, 0)
    assert times(built / "report") == before


def test_a_changed_night_makes_its_motor_s_files_anew_and_no_others(built: Path) -> None:
    before = times(built / "report")
    values = {"validation_fit_percent": 1.5, "mean_drain_flow_l_per_min": 1.5}
    change_table(built, "nights", rows_with(MOTOR, **values), str(NIGHTS[2]))
    result = build(built)
    assert result.n_nights == 1
    changed = {name for name, time in times(built / "report").items() if time != before[name]}
    pages = {f"data/{MOTOR}/{NIGHTS[2]}.js", f"motors/{MOTOR}.html"}
    assert changed == {*pages, "manifest.json"}


def test_another_program_makes_all_anew(built: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its words may be others: those of a sentence, not only those of the report."""
    there = Path.read_bytes

    def read(path: Path) -> bytes:
        return there(path) + (b" " if path.name == "sentences.py" else b"")

    monkeypatch.setattr(Path, "read_bytes", read)
    assert build(built).n_nights == 3


def test_what_was_lost_or_broken_is_made_again(built: Path) -> None:
    before = contents(built / "report")
    for name in (f"data/{MOTOR}/{NIGHTS[0]}.js", f"motors/{MOTOR}.html", "assets/plotly.min.js"):
        (built / "report" / name).unlink()
    assert build(built).n_written == 3
    assert contents(built / "report") == before
    (built / "report" / "manifest.json").write_bytes(b'{"files": []}')
    assert build(built).n_nights == 3
    assert contents(built / "report") == before


def test_nights_and_motors_that_are_gone_leave_and_files_of_others_stay(built: Path) -> None:
    own = built / "report" / "data" / MOTOR / "notes.txt"
    own.write_text("mine")
    (built / "mine.txt").write_text("mine")
    manifest = built / "report" / "manifest.json"
    document = json.loads(manifest.read_bytes())
    document["files"]["../mine.txt"] = ""
    manifest.write_text(json.dumps(document))
    change_table(built, "nights", lambda rows: rows.clear(), str(NIGHTS[0]))
    result = build_report(
        demo_fleet(built, *(name for name in MOTORS if name != MOTOR)), built / "report"
    )
    left = contents(built / "report")
    assert own.read_text() == (built / "mine.txt").read_text() == "mine"
    assert not [name for name in left if MOTOR in name and name != f"data/{MOTOR}/notes.txt"]
    assert not [name for name in left if str(NIGHTS[0]) in name]
    assert result.n_removed == 1 + 3 + 5 + 1


def test_a_folder_that_holds_something_else_is_left_alone(output: Path, tmp_path: Path) -> None:
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "index.html").write_text("mine")
    with refused("report_folder", "holds index.html and no report"):
        build(output, folder=tmp_path / "home")
    assert contents(tmp_path / "home") == {"index.html": b"mine"}
    with pytest.raises(StoreError, match="is no folder"):
        build(output, folder=tmp_path / "home" / "index.html")


def test_a_motor_without_a_good_night_has_a_page_that_says_why(built: Path) -> None:
    failed = {"status": "failed", "error_code": "log_truncated"}
    failed |= {"reason": "a.csv: its end is missing"}
    change_table(built, "nights", rows_with(MOTOR, **failed))
    # Without what the run has left, states are made from the other tables.
    shutil.rmtree(built / "tables" / "latest")
    change_table(built, "nights", rows_without("CB560-02"))
    build(built)
    text = (built / "report" / "motors" / f"{MOTOR}.html").read_text("utf-8")
    assert "Night of 2026-01-04 failed: a.csv: its end is missing." in text
    assert "could be fitted. The newest, 2026-01-04: failed (log_truncated): a.csv: its end" in text
    night = packed(built / "report" / "data" / MOTOR / f"{NIGHTS[2]}.js")
    assert "failed (log_truncated): a.csv: its end is missing" in night["words"][0][1][0]
    index = (built / "report" / "index.html").read_text("utf-8")
    order = re.findall(r'<a href="motors/([\w-]+)\.html">', index)
    assert order[0] == MOTOR
    assert "CB560-02" in order
    empty = (built / "report" / "motors" / "CB560-02.html").read_text("utf-8")
    assert "No night of this motor is in the tables yet" in empty
    assert "plotly" not in empty


def test_a_damaged_table_is_named_and_the_report_stays_as_it_was(built: Path) -> None:
    before = contents(built / "report")
    path = night_file(built, PREDICTIONS, NIGHTS[1])
    change_table(built, "nights", rows_with(MOTOR, validation_fit_percent=1.5), str(NIGHTS[1]))
    good = path.read_bytes()
    path.write_bytes(good[: len(good) // 2])
    with refused("store_read", "2026-01-03.parquet of predictions is damaged"):
        build(built)
    assert contents(built / "report") == before
    path.write_bytes(good)
    assert build(built).n_nights == 1


# The charts of a night and of a fleet, and how Plotly gets them


def test_correlations_of_the_errors_are_drawn_lag_by_lag(fitted_output: Path) -> None:
    path = night_file(fitted_output, RESIDUAL_TESTS, dt.date(2026, 1, 3))
    rows = read_table(path, RESIDUAL_TESTS).filter(motor_id="CB560-02", part="validation")
    chart = residual_chart(rows.to_dicts())
    assert len(chart.panels) == 4
    for panel, row in zip(chart.panels, rows.sort("test", descending=True).to_dicts(), strict=True):
        assert row["verdict"] in panel.title
        first = 51 - len(row["lags_s"])
        drawn = {line.name: line.value[first:] for line in panel.lines}
        assert chart.time[first:].tolist() == row["lags_s"]
        assert drawn["correlation"].tolist() == row["correlations"]
        assert numbers(drawn["to"]) == numbers(np.array(row["bounds"], dtype=np.float64))
    assert figure(chart)["x"][0] == -figure(chart)["x"][-1]
    assert residual_chart([]).panels == ()


def test_what_no_chart_can_show_is_no_number() -> None:
    assert numbers(np.array([1.23456789, np.nan, np.inf, -np.inf])) == [1.23457, None, None, None]
    with pytest.raises(ValueError, match="JSON"):
        script_json({"value": float("nan")})


@given(
    st.text() | st.sampled_from(["</script><img src=x>", "<!--<script>", "]]>", "\u2028", "&lt;"])
)
def test_no_name_ends_the_script_it_stands_in(name: str) -> None:
    text = script_json({name: [name]})
    assert json.loads(text) == {name: [name]}
    assert not set(text) & set("<>&\u2028\u2029")
