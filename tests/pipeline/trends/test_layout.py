"""What the watch is told of a motor: means of stored blocks, by their definition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from leakage import OperatingConditions, regressors
from pipeline.config import Channel, MotorSpec
from pipeline.config.oil_samples import OilSample
from pipeline.config.settings import Conditions
from pipeline.schema import BLOCK_STATISTICS
from pipeline.trends.nights.layout import Layout
from tests.pipeline.trends.nights import BLOCKS, FIRST, PATHS, SAMPLES, Nights, motor, night_of

ESTIMATED = '[flushing]\nmode = "estimated"\nflow_l_per_min = 4.0\n'
FIXED = '[flushing]\nmode = "fixed"\nflow_l_per_min = 4.0\n'


def blocks(spec: MotorSpec, **more: object):  # type: ignore[no-untyped-def]
    nights = Nights(spec, 1, noise=0.0, **more)  # type: ignore[arg-type]
    rows = nights.frames()[BLOCK_STATISTICS.name]
    layout = Layout.of(spec, FIRST)
    stored = layout.blocks(spec, rows)
    assert stored is not None
    return layout, layout.night_blocks(stored), rows


def test_means_are_those_of_the_samples() -> None:
    """Flow and drives of a block by the law of each path, without the statistics in between."""
    spec = motor()
    layout, found, rows = blocks(spec)
    assert layout.watched == (*PATHS, "known")
    assert layout.gaps == PATHS
    assert found.day == night_of(0).toordinal()
    bar = rows["mean_pressure_bar"][3] + np.linspace(-10.0, 10.0, SAMPLES)
    at = OperatingConditions.from_bar(
        bar,
        np.full(SAMPLES, rows["mean_temperature_c"][3]),
        np.full(SAMPLES, rows["mean_speed_rpm"][3]),
    )
    columns = regressors(spec.motor(FIRST, "none"), at).mean(axis=0)
    assert found.drives[3] == pytest.approx(columns[[0, 1, 2, 4]])
    theta = [path.configured_coefficient for path in spec.motor(FIRST, "none").column_paths]
    assert found.flow[3] == pytest.approx(columns @ [*theta, 0.0, 1.0])
    assert found.conditions[3] == pytest.approx(
        [rows[f"mean_{name}"][3] for name in ("temperature_c", "pressure_bar", "speed_rpm")]
    )
    assert found.middle_s == pytest.approx(120.0 + 240.0 * np.arange(BLOCKS))


def test_an_estimated_flushing_is_a_path_and_a_stated_one_is_taken_off() -> None:
    _, without, _ = blocks(motor())
    layout, estimated, _ = blocks(motor(more=ESTIMATED), wear={"C_f": np.ones(1)})
    assert layout.watched == (*PATHS, "flushing", "known")
    assert estimated.drives[:, 3] == pytest.approx(1.0)
    flow = motor(more=ESTIMATED).motor(FIRST, "estimated").constant
    assert flow is not None
    assert estimated.flow == pytest.approx(without.flow + flow.configured_coefficient)
    layout, fixed, _ = blocks(motor(more=FIXED))
    assert layout.watched == (*PATHS, "known")
    assert fixed.flow == pytest.approx(without.flow)


def test_a_roller_whose_scale_is_free_is_a_path_of_its_own() -> None:
    spec = motor()
    _, stated, rows = blocks(spec)
    free = replace(spec, roller_is_free=True)
    layout = Layout.of(free, FIRST)
    stored = layout.blocks(free, rows)
    assert stored is not None
    found = layout.night_blocks(stored)
    (roller,) = set(layout.paths) - set(PATHS)
    assert roller not in layout.gaps
    assert layout.watched == layout.paths
    at = layout.paths.index(roller)
    scale = free.motor(FIRST, "none").column_paths[at].configured_coefficient
    assert scale * found.drives[:, at] == pytest.approx(stated.drives[:, -1])
    assert found.flow == pytest.approx(stated.flow)


def test_a_measured_oil_scales_what_it_drives() -> None:
    """Thinner by a fifth than the data sheet: drives are larger by a quarter, near 40 °C."""
    spec = motor()
    oil = spec.oil_on(FIRST).oil()
    sample = OilSample(date=FIRST, viscosity_40_c_mm2_per_s=0.8 * 68.0)
    measured = replace(spec, file=spec.file.model_copy(update={"oil_samples": (sample,)}))
    _, sheet, rows = blocks(spec)
    layout = Layout.of(measured, FIRST)
    stored = layout.blocks(measured, rows)
    assert stored is not None
    found = layout.night_blocks(stored)
    assert (found.drives / sheet.drives).min() > 1.15
    assert found.flow == pytest.approx(sheet.flow)
    assert oil.walther_b == pytest.approx(measured.oil_on(FIRST).oil().walther_b)


def test_statistics_of_other_columns_do_not_count() -> None:
    _, _, rows = blocks(motor())
    flushed = motor(more=ESTIMATED)
    assert Layout.of(flushed, FIRST).blocks(flushed, rows) is not None
    other = rows.with_columns(columns=rows["columns"].list.head(3))
    assert Layout.of(motor(), FIRST).blocks(motor(), other) is None


def test_the_oil_is_a_cause_unless_it_is_measured() -> None:
    """Kinematic viscosity of the VG 68 of the data sheet at 40 and 100 °C."""
    spec = motor()
    layout = Layout.of(spec, FIRST)
    assert layout.machine(spec, FIRST).oil == pytest.approx((68.0, 8.7), rel=1e-3)
    channels = {**spec.file.channels, "kinematic_viscosity": Channel(source="nu", unit="cSt")}
    logged = replace(spec, file=spec.file.model_copy(update={"channels": channels}))
    assert layout.machine(logged, FIRST).oil is None


def test_drives_at_conditions_are_without_the_flushing() -> None:
    spec = motor(more=ESTIMATED)
    layout = Layout.of(spec, FIRST)
    at = Conditions(200.0, 50.0, 30.0)
    found = layout.drives_at(spec, FIRST, at)
    theta = [path.configured_coefficient for path in spec.motor(FIRST, "estimated").column_paths]
    # Design.md's placeholders: 1.371423 l/min at the reference conditions.
    assert np.asarray(found) @ [*theta, 4.0, 1.0] == pytest.approx(1.371423, rel=1e-6)
