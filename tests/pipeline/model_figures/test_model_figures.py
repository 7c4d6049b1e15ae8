"""Figures of a motor type: what is drawn is what the model says, and every mark is there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from leakage import Constant, FilmPressure, Parameter
from pipeline.config.motor_types import OilFile
from pipeline.config.settings import Settings
from pipeline.model_figures import ModelSubject, model_figures, subject_of
from pipeline.model_figures.canvas import pen
from tests.pipeline.model_figures.conftest import (
    DISTRIBUTOR,
    FIGURES,
    RING,
    ROLLER,
    at,
    line,
    panels,
    peak,
    thickness,
    type_with,
    words,
)

# Leakage of one interface, l/min, and of the whole CB560; computed apart from this project.
WORKED = [
    (40.0, 40.0, 10.0, 3.243447e-3, 1.830232e-3, 4.496090e-3, 1.735590e-3, 0.361771),
    (200.0, 50.0, 30.0, 3.445024e-4, 1.061377e-2, 1.529589e-2, 1.660281e-2, 1.371423),
    (300.0, 60.0, 80.0, 5.230070e-5, 1.963003e-2, 2.027035e-2, 6.068909e-2, 3.220537),
]
VISCOSITIES = {(40.0, 40.0): 63.854, (200.0, 50.0): 55.055, (300.0, 60.0): 44.651}  # mPa·s
ROUGHNESS_UM = 0.2 * 2**0.5


@pytest.mark.parametrize("worked", WORKED, ids=lambda row: f"{row[0]:g} bar")
def test_curves_show_the_worked_values(cb560: ModelSubject, worked: tuple[float, ...]) -> None:
    bar, celsius, rpm, ring, piston, sleeve, roller, total = worked
    subject = replace(cb560, temperature_c=celsius, speed_rpm=rpm, pressure_bar=bar)
    for path, label, flow in (
        ("piston_ring", "h = 8 µm", ring),
        ("balance_piston", "h = 10 µm", piston),
        ("balance_sleeve", "h = 12 µm", sleeve),
    ):
        drawn = line(panels(subject, f"{path}_leakage")[2], label)
        assert at(drawn, bar) == pytest.approx(1e3 * flow, rel=1e-6)
    curve = line(panels(subject, "cam_roller_speed_curve")[0], "f(ω)")
    scaling = bar / 200.0 * 35.0 / VISCOSITIES[bar, celsius]
    assert at(curve, rpm) * scaling == pytest.approx(1e3 * roller, rel=2e-5)
    flows, shares = panels(subject, "shares")
    names = ("piston_ring", "balance_piston", "balance_sleeve", "cam_roller")
    for name, flow in zip(names, (ring, piston, sleeve, roller), strict=True):
        assert thickness(flows, name, bar) == pytest.approx(32 * flow, rel=1e-5)
        assert thickness(shares, name, bar) == pytest.approx(100 * 32 * flow / total, rel=1e-4)
    assert f"{total:.4g} l/min at {bar:g} bar" in words(shares.figure)


@pytest.mark.parametrize(
    ("film_pressure", "bar"),
    [(FilmPressure(), 37.04), (FilmPressure(share=0.5), 38.46), (FilmPressure("slot"), 38.48)],
    ids=["share 1", "share 0.5", "slot"],
)
def test_ring_leaks_most_where_it_should(
    cb560: ModelSubject, film_pressure: FilmPressure, bar: float
) -> None:
    subject = replace(cb560, motor=replace(cb560.motor, film_pressure=film_pressure))
    constant, film, curves = panels(subject, "piston_ring_leakage")[:3]
    solid = [one for one in curves.lines if one.get_linestyle() == "-"]
    dashed = [one for one in curves.lines if one.get_linestyle() == "--"]
    assert len(solid) == len(dashed) == 3
    assert [round(peak(one), 2) for one in solid] == [bar] * 3
    assert [round(peak(one), 2) for one in dashed] == [40.0] * 3
    marks = [one for one in curves.lines if one.get_linestyle() == "None"]
    found = sorted(round(float(np.asarray(one.get_xdata())[0]), 2) for one in marks)
    assert found == [bar] * 3 + [40.0] * 3
    for axes, largest in ((constant, 40.0), (film, bar)):
        (marked,) = (one for one in axes.lines if one.get_gid() == "maximum")
        assert round(float(np.asarray(marked.get_xdata())[0]), 2) == largest
        assert f"maximum at {largest:.2f} bar" in axes.get_title(loc="left")


def test_map_has_one_scale_of_1_2_5_that_holds_all_and_a_maximum_where_there_is_one(
    cb560: ModelSubject,
) -> None:
    stiff = model_figures(cb560)["balance_piston_leakage"]()
    assert not any(one.get_gid() == "maximum" for axes in stiff.axes for one in axes.lines)
    assert "maximum at" not in words(stiff)
    figure = model_figures(cb560)["piston_ring_leakage"]()
    maps = [axes.collections[0] for axes in figure.axes[:2]]
    for one in maps:
        assert list(one.levels) == [0, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50]  # type: ignore[attr-defined]
    # 8 µm leak 5.60 ml/min at most, so 16 µm eight times that.
    dashed = [one for one in figure.axes[2].lines if one.get_linestyle() == "--"]
    assert max(dashed[1].get_ydata()) * 8 < 50


def test_deformation_takes_away_what_its_law_says(cb560: ModelSubject) -> None:
    flows, losses = panels(cb560, "piston_ring_deformation")
    deformed = line(flows, "h = 8 µm")
    straight = flows.lines[flows.lines.index(deformed) + 1]
    # h exp(−ΔP/X) in the cube: a factor e³ at ΔP = X = 120 bar.
    assert at(straight, 120.0) / at(deformed, 120.0) == pytest.approx(20.085537)
    assert at(line(losses, "leakage"), 120.0) == pytest.approx(100 * (np.exp(-3) - 1))
    assert at(line(losses, "gap height"), 120.0) == pytest.approx(100 * (np.exp(-1) - 1))


def test_differences_from_points_of_a_simulation(oil: OilFile) -> None:
    """Thesis, figures 17 to 20: points that follow the law, with 1 % added to the last."""

    def simulated(bar: float, um: float) -> float:
        return 1e-6 * um**3 * bar * np.exp(-3 * bar / 120)

    points = [(p, h, simulated(p, h)) for h in (6.0, 8.0, 10.0) for p in (10.0, 40.0, 120.0)]
    subject = subject_of(type_with({**RING, "deformation_points": points}), oil, Settings())
    flows, without, with_ = panels(subject, "ring_deformation")
    dots = line(flows, "h = 8 µm")
    assert at(dots, 40.0) == pytest.approx(1e3 * simulated(40, 8))
    assert at(line(without, "h = 8 µm"), 40.0) == pytest.approx(
        1e3 * simulated(40, 8) * (np.e - 1), rel=1e-6
    )
    assert max(abs(line(with_, "h = 10 µm").get_ydata())) < 1e-6
    assert "X = 120 bar, fitted to 9 points" in words(flows.figure)
    assert "at most" in words(flows.figure)


def test_of_many_gap_heights_some_are_drawn_and_that_is_said(oil: OilFile) -> None:
    points = [
        (p, float(h), 1e-6 * h**3 * p * np.exp(-p / 40)) for h in range(4, 14) for p in (20.0, 90.0)
    ]
    subject = subject_of(type_with({**RING, "deformation_points": points}), oil, Settings())
    flows, without, _ = panels(subject, "ring_deformation")
    labels = flows.get_legend_handles_labels()[1]
    assert labels[0] == "h = 4 µm"
    assert labels[-1] == "h = 13 µm"
    assert len(labels) == 6
    assert "6 of 10 gap heights" in [text.get_text() for text in without.texts]


def test_speed_curve_with_points(oil: OilFile) -> None:
    points = [(rpm, 0.004 + 0.0005 * rpm) for rpm in (10.0, 30.0, 50.0, 70.0, 90.0, 125.0)]
    points += [(110.0, 0.070), (111.0, 0.050)]
    subject = subject_of(type_with({**ROLLER, "points": points}), oil, Settings())
    curve, deviations = panels(subject, "roller_speed_curve")
    drawn = line(curve, "points of the simulation")
    assert at(drawn, 30.0) == pytest.approx(19.0)
    fitted = np.polyfit(*np.array(points).T, 5)
    (marks,) = (one for one in deviations.lines if one.get_linestyle() == "None")
    assert at(marks, 110.0) == pytest.approx(1e3 * (np.polyval(fitted, 110.0) - 0.070), rel=1e-6)
    assert at(line(curve, "f(ω)"), 10.0) == pytest.approx(1e3 * np.polyval(fitted, 10.0), rel=1e-6)
    assert "fitted to 8 points" in words(curve.figure)


def test_speed_curve_holds_its_end_value_beyond_its_range(cb560: ModelSubject) -> None:
    (curve,) = panels(cb560, "cam_roller_speed_curve")
    held = line(curve, "end value, held beyond the range")
    assert list(held.get_ydata()) == pytest.approx([81.9297] * 2, rel=1e-6)
    assert list(held.get_xdata()) == [125.0, 162.5]
    assert "holds from 0 to 125 rpm" in words(curve.figure)
    assert "stated coefficients" in words(curve.figure)


def test_laminar_path_in_proportion_to_the_drive(oil: OilFile) -> None:
    subject = subject_of(type_with(DISTRIBUTOR), oil, Settings())
    (axes,) = panels(subject, "distributor_leakage")
    # Q = C ΔP/η of one of the two, in ml/min.
    expected = 1e-15 * 200e5 / 0.055055 * 60_000 * 1e3
    assert at(axes.lines[0], 200.0) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(("condition", "eta"), VISCOSITIES.items())
def test_viscosity(cb560: ModelSubject, condition: tuple[float, float], eta: float) -> None:
    bar, celsius = condition
    over_temperature, over_pressure = panels(cb560, "viscosity")
    assert at(line(over_pressure, f"{celsius:g} °C"), bar) == pytest.approx(eta, rel=1e-5)
    if bar == 200.0:
        assert at(line(over_temperature, "200 bar"), celsius) == pytest.approx(eta, rel=1e-5)
    # Data sheet: 68 mm²/s at 40 °C, where the density is 882 / (1 + 7e-4 · 25) kg/m³.
    sheet = line(over_temperature, "data sheet, at 0 bar")
    assert at(sheet, 40.0) == pytest.approx(68e-3 * 882 / 1.0175)
    assert at(sheet, 40.0) == pytest.approx(at(line(over_temperature, "0 bar"), 40.0))


def test_shares_are_whole_and_leave_the_flushing_out(cb560: ModelSubject) -> None:
    flushing = Constant("flushing", Parameter("C_f", "l_per_min", 2.0, 0.0, 20.0))
    motor = replace(cb560.motor, paths=(*cb560.motor.paths, flushing))
    flows, shares = panels(replace(cb560, motor=motor), "shares")
    assert thickness(flows, "flushing", 200.0) == pytest.approx(2.0)
    layers = [one.get_label() for one in shares.collections]
    assert layers == ["piston_ring", "balance_piston", "balance_sleeve", "cam_roller"]
    for bar in (1.0, 37.0, 350.0):
        assert sum(thickness(shares, str(name), bar) for name in layers) == pytest.approx(100.0)
    assert "1.371 l/min at 200 bar" in words(shares.figure)


def test_shares_of_two_sides_include_the_low_one(cb560: ModelSubject) -> None:
    """At 15 bar charge, low-side rings leak eleven times what high-side ones do at 200 bar."""
    flows, _ = panels(replace(cb560, charge_over_case_bar=15.0), "shares")
    high = 215.0 * np.exp(-3 * 215 / 120) / np.exp(2e-8 * 215e5)
    low = 15.0 * np.exp(-3 * 15 / 120) / np.exp(2e-8 * 15e5)
    worked = 200.0 * np.exp(-3 * 200 / 120) / np.exp(2e-8 * 200e5)
    expected = 32 * 3.445024e-4 / worked * (high + low)
    assert thickness(flows, "piston_ring", 200.0) == pytest.approx(expected, rel=1e-6)
    assert low / worked == pytest.approx(11, abs=0.1)
    assert "15 bar charge over case" in words(flows.figure)


def test_films(cb560: ModelSubject) -> None:
    stribeck, pressure = panels(cb560, "films")
    ring = line(pressure, "piston_ring")
    assert at(ring, 0.0) == pytest.approx(8 / ROUGHNESS_UM)
    assert at(ring, 120.0) == pytest.approx(8 / np.e / ROUGHNESS_UM)
    assert at(line(pressure, "balance_piston"), 300.0) == pytest.approx(21.21, abs=0.01)
    assert at(line(pressure, "balance_sleeve"), 0.0) == pytest.approx(12 * 0.7 / ROUGHNESS_UM)
    bars = {bar.get_y() + bar.get_height() / 2: bar for bar in stribeck.patches}  # type: ignore[attr-defined]
    names = [tick.get_text() for tick in stribeck.get_yticklabels()]
    assert names[:4] == ["boundary", "mixed", "elastohydrodynamic", "hydrodynamic"]
    ends = [
        (round(bars[row].get_x(), 9), round(bars[row].get_x() + bars[row].get_width(), 9))
        for row in sorted(bars)
    ]
    # The thesis's first table, after its [12], on an axis from 0.1 to 200.
    assert ends == [(0.1, 1.0), (1.0, 5.0), (3.0, 10.0), (5.0, 200.0)]
    assert "reference [12]" in words(stribeck.figure)
    assert "8 µm" in words(stribeck.figure)


@pytest.mark.parametrize("name", FIGURES)
def test_placeholders_are_marked_and_values_stated(cb560: ModelSubject, name: str) -> None:
    figure = model_figures(cb560)[name]()
    (mark,) = (text for text in figure.texts if text.get_gid() == "placeholder")
    kind = {"viscosity": "oil", "cam_roller_speed_curve": "curve"}.get(name, "geometry")
    assert mark.get_text().startswith(f"placeholder {kind}")
    for axes in figure.axes:
        assert axes.get_ylabel() or axes.get_xlabel()
    if kind == "geometry":
        assert "h = " in words(figure)
        assert "not fitted" in words(figure)
    # Nothing is cut off.
    figure.canvas.draw()
    box = figure.get_tightbbox()
    width, height = figure.get_size_inches()
    assert min(box.x0, box.y0) > -0.02
    assert (box.x1 < width + 0.02, box.y1 < height + 0.02) == (True, True)
    assert figure.texts[0].get_window_extent().y0 > figure.axes[0].get_window_extent().y1


def test_what_is_no_placeholder_is_not_marked(oil: OilFile) -> None:
    ring = {**RING, "deformation_pressure_bar": 120.0}
    curve = {**ROLLER, "coefficients": (0.02, 1.0), "speed_range_rpm": (0.0, 125.0)}
    subject = subject_of(type_with(ring, curve, DISTRIBUTOR), oil, Settings())
    for draw in model_figures(subject).values():
        assert "placeholder" not in words(draw())


def test_lines_are_told_apart_without_colour() -> None:
    pens = [pen(place) for place in range(7)]
    for kind in ("colour", "dashes", "mark", "hatch"):
        assert len({getattr(one, kind) for one in pens}) == 7
    assert pen(7) == pens[0]
