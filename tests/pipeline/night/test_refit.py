"""A night fitted anew from its statistics: what its log would give, also with free rollers."""

from __future__ import annotations

import datetime as dt
import shutil
from dataclasses import replace
from pathlib import Path
from typing import get_args

import pytest
from polars.testing import assert_frame_equal

import pipeline.logs.motor_logs
import pipeline.run.night_plan
from leakage import OperatingConditions, total_flow_l_per_min
from leakage.estimation.blocks import Windows as Blocks
from pipeline.config import MotorSpec, Windows, hashes
from pipeline.config.motors import Event, MotorFile
from pipeline.errors import LogError
from pipeline.night.fit_night import NightOutcome, refit, refit_read
from pipeline.run.night_plan import roller_decision
from pipeline.schema import BLOCKS, NIGHT_TABLES, frame
from pipeline.store.published import TABLE_OF
from tests.pipeline.night.noise_free import fitted, parameters, white
from tests.pipeline.simulated import NIGHT, operate, with_settings
from tests.pipeline.workshop import DAY, QUICK, Workshop

OTHER_REFERENCE = QUICK + "[reference]\npressure_bar = 150.0\ntemperature_c = 45.0\n"


def refuse(path: Path, _: object) -> None:
    raise LogError("log_not_readable", path, "it must not be read")


def test_settings_of_the_fit_need_no_log(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    for day in range(2):
        workshop.log(NIGHT + day * DAY, seed=day)
    assert workshop.run().status == "ok"
    refitted = ("nights", "fits", "parameters", "error_budget")
    tables = [table.name for table in NIGHT_TABLES if table.name not in refitted]
    others = {name: workshop.rows(name) for name in tables}
    workshop.configure(fleet=OTHER_REFERENCE)
    with monkeypatch.context() as patch:
        patch.setattr(pipeline.logs.motor_logs, "read_log", refuse)
        outcome = workshop.run()
    assert (len(outcome.nights), outcome.n_refitted, outcome.status) == (2, 2, "ok")
    for name, before in others.items():
        assert_frame_equal(workshop.rows(name), before, check_exact=True)
    assert not workshop.run().nights
    # They give what the logs would give.
    fresh = Workshop(workshop.folder / "fresh")
    for name in ("configs", "logs"):
        shutil.copytree(workshop.folder / name, fresh.folder / name)
    assert fresh.run().status == "ok"
    for name in refitted:
        assert_frame_equal(workshop.rows(name), fresh.rows(name), rel_tol=1e-9, abs_tol=1e-9)


def test_a_night_of_merged_blocks_is_made_anew(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    workshop.log(NIGHT)
    monkeypatch.setattr(Windows, "blocks", lambda _: Blocks(maximum_blocks=4))
    workshop.run()
    blocks, before = workshop.rows("blocks"), workshop.rows("fits")
    assert blocks.height <= 4
    monkeypatch.setattr(hashes, "FIGURES_VERSION", -1)
    assert workshop.run().n_refitted == 1
    assert_frame_equal(workshop.rows("fits"), before)


TRUE_SCALE = 0.6


def night(spec: MotorSpec) -> NightOutcome:
    """Two hours of a motor whose rollers leak less than their curve says."""
    operation = operate(minutes=120.0)
    flow = operation.flow(spec.motor(NIGHT, "none"), {"cam_roller": TRUE_SCALE})
    return fitted(spec, operation, flow + white(len(flow), 0.02, seed=5))


def freed(spec: MotorSpec) -> MotorSpec:
    return replace(spec, roller_is_free=True)


def test_the_leakage_of_a_wrong_curve_is_right_with_its_scale_free(spec: MotorSpec) -> None:
    stated = night(spec)
    free = refit_read(freed(spec), stated)
    motor, at = spec.motor(NIGHT, "none"), spec.settings.reference
    conditions = OperatingConditions.from_bar(at.pressure_bar, at.temperature_c, at.speed_rpm)
    true = float(total_flow_l_per_min(motor, conditions, {"cam_roller": TRUE_SCALE})[0])
    (before,), (after,) = stated.rows["fits"], free.rows["fits"]
    assert abs(before["fitted_leakage_l_per_min"] / true - 1.0) > 0.05
    assert after["fitted_leakage_l_per_min"] == pytest.approx(true, rel=0.01)
    assert after["fitted_leakage_lower"] < true < after["fitted_leakage_upper"]
    for row in (before, after):
        assert row["roller_scale"] == pytest.approx(TRUE_SCALE, abs=0.02)
        assert row["roller_verdict"] == "identified"
    scale = parameters(free)["scale_cam_roller"]
    assert scale["lower"] < TRUE_SCALE < scale["upper"]
    # The misfit is that of the model as stated, and so is what it does to K.
    assert after["model_misfit_percent"] == before["model_misfit_percent"] > 2.0
    # Read with its scale free it is the night fitted anew.
    read = night(freed(spec))
    assert read.rows.keys() == free.rows.keys()
    for name in read.rows:
        tables = (frame(TABLE_OF[name], made.rows[name]) for made in (read, free))
        assert_frame_equal(*tables, check_exact=True)


def test_other_reference_conditions_need_no_log_with_its_scale_free(spec: MotorSpec) -> None:
    """The ± from the sensors as well, which is that of the new conditions."""
    made = night(spec).rows
    moved = freed(with_settings(spec, "reference", pressure_bar=100.0))
    anew = refit(moved, NIGHT, made, frame(BLOCKS, made["blocks"]))
    # Without stored blocks, as where they were pruned, the log has to be read.
    assert refit(moved, NIGHT, made, None) is None
    read = night(moved)
    for name in ("fitted_leakage_sensor_l_per_min", "fitted_leakage_l_per_min"):
        assert anew.rows["fits"][0][name] == pytest.approx(read.rows["fits"][0][name], rel=0.02)


@pytest.mark.parametrize(
    ("identified", "begins", "expected"),
    [
        ((True,) * 5, (), True),
        ((True,) * 4, (), None),
        ((None, *(True,) * 5), (), True),
        # Four of five do.
        ((True, False, True, True, True), (), True),
        ((True, False, False, True, True), (), False),
        # Later nights change nothing of it.
        ((True,) * 5 + (False,) * 3, (), True),
        # A new baseline decides anew, once it has its nights.
        ((True,) * 5 + (False,) * 2, (5,), True),
        ((True,) * 2 + (False,) * 6, (2,), False),
    ],
)
def test_the_first_nights_of_a_baseline_decide(
    monkeypatch: pytest.MonkeyPatch,
    identified: tuple[bool | None, ...],
    begins: tuple[int, ...],
    expected: bool | None,
) -> None:
    monkeypatch.setattr(pipeline.run.night_plan, "ROLLER_NIGHTS", 5)
    days: dict[dt.date, bool | None] = {
        NIGHT + day * DAY: is_identified for day, is_identified in enumerate(identified)
    }
    decision = roller_decision(days, [NIGHT + day * DAY for day in begins])
    assert (decision and decision["is_free"]) is expected


def test_only_what_makes_another_motor_of_it_begins_a_baseline() -> None:
    """The design's section 2 says which events do, and which carry the baseline across."""
    kinds = get_args(Event.model_fields["kind"].annotation)
    events = tuple(Event.model_construct(date=NIGHT, kind=kind) for kind in kinds)
    file = MotorFile.model_construct(events=events)
    begins = {event.kind for event in file.baseline_events}
    assert begins == {"overhaul", "motor_exchanged", "flushing_change"}
    assert {event.kind for event in file.changes} - begins == {
        "oil_change", "meter_changed", "sensor_changed",
    }  # fmt: skip
