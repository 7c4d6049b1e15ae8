"""Motor types whose figures are drawn, and what is found in a drawing."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pipeline.config import load_fleet
from pipeline.config.motor_types import MotorTypeFile, OilFile
from pipeline.demo import shipped_configs
from pipeline.model_figures import ModelSubject, choose, model_figures
from pipeline.model_figures.canvas import drawing

FIGURES = [
    "piston_ring_leakage", "piston_ring_deformation", "balance_piston_leakage",
    "balance_sleeve_leakage", "balance_sleeve_deformation", "cam_roller_speed_curve",
    "viscosity", "shares", "films",
]  # fmt: skip


@pytest.fixture(scope="module")
def cb560() -> ModelSubject:
    """The shipped CB560, all of it placeholders."""
    return choose(load_fleet(shipped_configs() / "fleet.toml"), "CB560")


@pytest.fixture(scope="module")
def oil() -> OilFile:
    """The shipped VG 68, from a data sheet for once."""
    shipped = load_fleet(shipped_configs() / "fleet.toml").oils["vg68"]
    return shipped.model_copy(update={"source": "data sheet"})


@pytest.fixture(autouse=True)
def style() -> Iterator[None]:
    with drawing():
        yield


def panels(subject: ModelSubject, name: str) -> list[Axes]:
    return model_figures(subject)[name]().axes


def line(axes: Axes, label: str) -> Line2D:
    (found,) = (one for one in axes.lines if one.get_label() == label)
    return found


def at(drawn: Line2D, x: float) -> float:
    """Value drawn at one of a line's own points."""
    xs, ys = np.asarray(drawn.get_xdata()), np.asarray(drawn.get_ydata())
    (place,) = np.flatnonzero(np.isclose(xs, x, rtol=1e-12))
    return float(ys[place])


def peak(drawn: Line2D) -> float:
    return float(np.asarray(drawn.get_xdata())[np.argmax(drawn.get_ydata())])


def thickness(axes: Axes, name: str, x: float) -> float:
    """Height of a layer of a stack."""
    (layer,) = (one for one in axes.collections if one.get_label() == name)
    corners = np.concatenate([path.vertices for path in layer.get_paths()])
    ys = corners[np.isclose(corners[:, 0], x), 1]
    return float(np.ptp(ys))


def words(figure: Figure) -> str:
    """All that is written around the panels and above them."""
    texts = [*figure.texts, *(one.title for one in figure.axes)]
    titles = [one.get_title(loc="left") for one in figure.axes]
    return "\n".join([*(text.get_text() for text in texts), *titles]).replace("\n", " ")


def type_with(*paths: dict[str, object]) -> MotorTypeFile:
    return MotorTypeFile.model_validate({"motor_type": "X1", "path": list(paths)}, strict=False)


RING = {
    "name": "ring", "law": "annular_gap", "source": "drawing", "count": 10, "radius_mm": 35.0,
    "length_mm": 4.0, "gap_um": {"value": 8.0},
}  # fmt: skip
ROLLER = {
    "name": "roller", "law": "speed_curve", "source": "drawing", "count": 10,
    "reference_pressure_bar": 200.0, "reference_viscosity_mpa_s": 35.0,
}  # fmt: skip
DISTRIBUTOR = {
    "name": "distributor", "law": "laminar", "source": "drawing", "count": 2,
    "coefficient_m3": {"value": 1e-15, "minimum": 0.0, "maximum": 1e-13},
}  # fmt: skip
