"""A night fitted anew: from the logs only where a setting needs it, or with free rollers.

Nights fitted anew from their statistics give what their logs would give.
"""

from __future__ import annotations

import datetime as dt
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from polars.testing import assert_frame_equal

import pipeline.logs.motor_logs
import pipeline.run.night_plan
from leakage import OperatingConditions, total_flow_l_per_min
from leakage.estimation.sample_blocks import Windows as Blocks
from pipeline.config import MotorSpec, Windows, hashes
from pipeline.demo import shipped_configs
from pipeline.errors import LogError
from pipeline.night.fit_night import NightOutcome
from pipeline.night.refit import PublishedNight, refit, refit_read
from pipeline.run.night_plan import roller_decision
from pipeline.schema import BLOCKS, NIGHT_TABLES, NIGHTS, frame
from pipeline.store.published import TABLE_OF
from tests.pipeline.night.noise_free import fitted, parameters, white
from tests.pipeline.simulated import NIGHT, load_motor, motor_toml, operate, with_settings
from tests.pipeline.workshop import DAY, QUICK, Workshop

OTHER_REFERENCE = QUICK + "[reference]\npressure_bar = 150.0\ntemperature_c = 45.0\n"
OTHER_CLEANING = QUICK + "[cleaning]\nguard_after_s = 31.0\n"


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three nights, done."""
    made = Workshop.at(tmp_path_factory.mktemp("done"))
    for day in range(3):
        made.log(NIGHT + day * DAY, seed=day)
    assert made.run().status == "ok"
    return made.folder


@pytest.fixture
def workshop(done: Path, tmp_path: Path) -> Workshop:
    """A copy of them."""
    return Workshop(Path(shutil.copytree(done, tmp_path / "copy")))


def refuse(path: Path, _: object) -> None:
    raise LogError("log_not_readable", path, "it must not be read")


def from_scratch(workshop: Workshop) -> Workshop:
    """The same logs and config with an output of its own."""
    fresh = Workshop(workshop.folder / "fresh")
    shutil.copytree(workshop.folder / "configs", fresh.folder / "configs")
    shutil.copytree(workshop.folder / "logs", fresh.folder / "logs")
    assert fresh.run().status == "ok"
    return fresh


def test_settings_of_the_fit_need_no_log(
    workshop: Workshop, monkeypatch: pytest.MonkeyPatch
) -> None:
    refitted = ("nights", "fits", "parameters", "error_budget")
    others = {
        table.name: workshop.rows(table.name)
        for table in NIGHT_TABLES
        if table.name not in refitted
    }
    workshop.configure(fleet=OTHER_REFERENCE)
    with monkeypatch.context() as patch:
        patch.setattr(pipeline.logs.motor_logs, "read_log", refuse)
        outcome = workshop.run()
    assert (len(outcome.nights), outcome.n_refitted, outcome.status) == (3, 3, "ok")
    for name, before in others.items():
        assert_frame_equal(workshop.rows(name), before, check_exact=True)
    assert not workshop.run().nights
    # They give what the logs would give.
    fresh = from_scratch(workshop)
    for table in refitted:
        made, read = (one.rows(table) for one in (workshop, fresh))
        assert_frame_equal(made, read, rel_tol=1e-9, abs_tol=1e-9)


def test_a_night_of_merged_blocks_is_made_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workshop = Workshop.at(tmp_path)
    workshop.log(NIGHT)
    monkeypatch.setattr(Windows, "blocks", lambda _: Blocks(maximum_blocks=4))
    workshop.run()
    blocks, before = workshop.rows("blocks"), workshop.rows("fits")
    assert blocks.height <= 4
    monkeypatch.setattr(hashes, "FIGURES_VERSION", -1)
    assert workshop.run().n_refitted == 1
    assert_frame_equal(workshop.rows("fits"), before)


def test_settings_of_the_statistics_need_the_logs(workshop: Workshop) -> None:
    workshop.configure(fleet=OTHER_CLEANING)
    outcome = workshop.run()
    assert (len(outcome.nights), outcome.n_refitted) == (3, 0)
    fresh = from_scratch(workshop)
    for table in (NIGHTS, *NIGHT_TABLES):
        assert_frame_equal(workshop.rows(table.name), fresh.rows(table.name), check_exact=True)


def test_without_its_logs_a_published_night_stays(workshop: Workshop) -> None:
    before = workshop.rows("fits")
    shutil.rmtree(workshop.logs)
    workshop.configure(fleet=OTHER_CLEANING)
    assert not workshop.run().nights
    assert_frame_equal(workshop.rows("fits"), before, check_exact=True)


def test_damaged_statistics_are_made_anew_from_the_log(workshop: Workshop) -> None:
    for path in (workshop.output / "tables" / "blocks").rglob("*.parquet"):
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
    workshop.configure(fleet=OTHER_REFERENCE)
    outcome = workshop.run()
    assert (len(outcome.nights), outcome.n_refitted) == (3, 0)
    fresh = from_scratch(workshop)
    for table in ("fits", "parameters"):
        assert_frame_equal(workshop.rows(table), fresh.rows(table), check_exact=True)


DAYS = [NIGHT + dt.timedelta(days=number) for number in range(8)]
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
    motor = spec.motor(NIGHT, "none")
    at = spec.settings.reference
    conditions = OperatingConditions.from_bar(at.pressure_bar, at.temperature_c, at.speed_rpm)
    true = float(total_flow_l_per_min(motor, conditions, {"cam_roller": TRUE_SCALE})[0])
    (before,), (after,) = stated.rows["fits"], free.rows["fits"]
    assert abs(before["fitted_leakage_l_per_min"] / true - 1.0) > 0.05
    assert after["fitted_leakage_l_per_min"] == pytest.approx(true, rel=0.01)
    assert after["fitted_leakage_lower"] < true < after["fitted_leakage_upper"]
    assert len(after["coefficients"]) == len(before["coefficients"]) + 1
    for row in (before, after):
        assert row["roller_scale"] == pytest.approx(TRUE_SCALE, abs=0.02)
        assert row["roller_verdict"] == "identified"
    # The misfit is that of the model as stated, and so is what it does to K.
    assert after["model_misfit_percent"] == before["model_misfit_percent"] > 2.0


def test_a_night_read_with_its_scale_free_is_the_night_fitted_anew(spec: MotorSpec) -> None:
    read, stated = night(freed(spec)), night(spec)
    anew = refit_read(freed(spec), stated)
    assert read.rows.keys() == anew.rows.keys()
    for name in read.rows:
        table = TABLE_OF[name]
        one, two = (frame(table, made.rows[name]) for made in (read, anew))
        assert_frame_equal(one, two, check_exact=True)


def test_other_reference_conditions_need_no_log_with_its_scale_free(spec: MotorSpec) -> None:
    """The ± from the sensors as well, which is that of the new conditions."""
    made = night(spec).rows
    published = PublishedNight(NIGHT, made, frame(BLOCKS, made["blocks"]))
    moved = with_settings(spec, "reference", pressure_bar=100.0)
    anew = refit(freed(moved), published)
    read = refit_read(freed(moved), night(moved))
    (made_anew,), (made_read,) = anew.rows["fits"], read.rows["fits"]
    for name in ("fitted_leakage_sensor_l_per_min", "fitted_leakage_l_per_min"):
        assert made_anew[name] == pytest.approx(made_read[name], rel=0.02), name


def test_it_is_the_fit_of_a_type_whose_scale_is_free(tmp_path: Path, spec: MotorSpec) -> None:
    """From blocks with the rollers known, as from blocks with a column of their own."""
    text = (shipped_configs() / "motor_types" / "CB560.toml").read_text("utf-8")
    text = text.replace('motor_type = "CB560"', 'motor_type = "FREE"')
    text += "scale = { value = 1.0, minimum = 0.0, maximum = 10.0, fixed = false }\n"
    declared = load_motor(tmp_path / "free", motor_toml("M1", "FREE"), {"FREE": text})
    free = refit_read(freed(spec), night(spec))
    read = night(declared)
    scale = parameters(read)["scale_cam_roller"]
    assert scale["verdict"] == "identified"
    assert scale["lower"] < TRUE_SCALE < scale["upper"]
    (one,), (two,) = free.rows["fits"], read.rows["fits"]
    assert one["coefficient_names"] == two["coefficient_names"]
    for name in ("coefficients", "cost", "fitted_leakage_upper"):
        assert one[name] == pytest.approx(two[name], rel=1e-6, abs=1e-30), name


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
        ((True,) * 5 + (False,) * 2, (DAYS[5],), True),
        ((True,) * 2 + (False,) * 6, (DAYS[2],), False),
    ],
)
def test_the_first_nights_of_a_baseline_decide(
    monkeypatch: pytest.MonkeyPatch,
    identified: tuple[bool | None, ...],
    begins: tuple[dt.date, ...],
    expected: bool | None,
) -> None:
    monkeypatch.setattr(pipeline.run.night_plan, "ROLLER_NIGHTS", 5)
    found = roller_decision(dict(zip(DAYS, identified, strict=False)), begins)
    assert (found and found["is_free"]) is expected
