"""The example reader of `examples/mdf4_reader/`, as a plant would install it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.config import load_fleet, logs
from pipeline.ingest.conformance import (
    Check,
    checks_of,
    every_sample_comes_back_to_the_last_digit,
)
from pipeline.run.fleet import RunRequest, run_fleet
from tests.pipeline.simulated import NIGHT, motor_toml, operate, write_configs
from tests.pipeline.workshop import QUICK

pytest.importorskip("asammdf", reason="asammdf is of requirements/docs.txt")
sys.path.insert(0, str(Path(__file__).parents[3] / "examples" / "mdf4_reader"))

import test_mdf4_reader as example

QUICK_CHECK = every_sample_comes_back_to_the_last_digit


@pytest.fixture(autouse=True)
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    info = tmp_path / "site-packages" / "mdf4-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Name: mdf4\nVersion: 1.0\n", "utf-8")
    entry = f"[{logs.GROUP}]\nmdf4 = mdf4_reader:READER\n"
    (info / "entry_points.txt").write_text(entry, "utf-8")
    monkeypatch.syspath_prepend(str(info.parent))
    logs.installed_readers.cache_clear()
    yield
    logs.installed_readers.cache_clear()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(
    "check",
    [
        pytest.param(check, marks=[pytest.mark.full] * (check is not QUICK_CHECK))
        for check in checks_of(example.MDF4)
    ],
    ids=lambda check: check.__name__,
)
def test_the_example_conforms(check: Check, tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    example.test_conformance(check, folder)


def test_a_run_fits_a_motor_from_the_example_s_format(tmp_path: Path) -> None:
    text = motor_toml("M1", files='"*.mf4"').replace('"parquet"', '"mdf4"')
    fleet = load_fleet(write_configs(tmp_path, {"M1": text}, fleet=QUICK))
    operation = operate()
    values = operation.channels(operation.flow(fleet.motors[0].motor(NIGHT, "none")))
    rows = [
        example.Row(int(time_us), dict(zip(values, map(float, cells), strict=True)))
        for time_us, *cells in zip(operation.time_us, *values.values(), strict=True)
    ]
    example.write(fleet.log_root / "a.mf4", rows, list(values))
    (outcome,) = run_fleet(RunRequest(fleet)).outcomes
    assert (outcome.status, dict(outcome.counts)) == ("ok", {"ok": 1})
