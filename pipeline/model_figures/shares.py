"""Figure of the whole motor: leakage by path over pressure."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from leakage import AnnularGap, leakage_l_per_min
from leakage.physics.motor import path_flows_l_per_min
from pipeline.arrays import Array
from pipeline.model_figures.canvas import label, new_figure, pen
from pipeline.model_figures.gaps import PRESSURE
from pipeline.model_figures.subject import ModelSubject, stated

_STEPS = 350
_MOST_STATED = 6


def shares_figure(subject: ModelSubject) -> Figure:
    """Flow of each path, and its share of the leakage, stacked over pressure."""
    motor = subject.motor
    gaps = [path for path in motor.paths if isinstance(path, AnnularGap)]
    named = "; ".join(f"{path.name} {stated(path)}" for path in gaps[:_MOST_STATED])
    charge = subject.charge_over_case_bar
    sides = "" if charge is None else f", both sides at {charge:g} bar charge over case"
    figure, (flow, share) = new_figure(
        f"{motor.motor_type}: leakage by path over pressure",
        2,
        note=f"{subject.oil_name} at {subject.temperature_c:g} °C, {subject.speed_rpm:g} rpm, "
        f"{subject.film_words()}{sides}; all interfaces of a path together, as "
        f"configured, not fitted.\n{named}",
        mark=subject.marks(*motor.paths, oil=True),
    )
    highest = subject.highest_pressure_bar
    pressure = np.linspace(highest / _STEPS, highest, _STEPS)
    flows = path_flows_l_per_min(motor, subject.conditions(pressure))
    _stack(flow, pressure, flows, subject.places)
    label(flow, "(a) flow of each path, stacked", PRESSURE, "Flow / (l/min)")
    _stack(share, pressure, _percent(subject, flows), subject.places)
    reference = subject.conditions(np.array([subject.pressure_bar]))
    leakage = float(leakage_l_per_min(motor, reference)[0])
    label(
        share,
        f"(b) share of the leakage; {leakage:.4g} l/min at {subject.pressure_bar:g} bar",
        PRESSURE,
        "Share / %",
    )
    share.set_ylim(0.0, 100.0)
    for axes in (flow, share):
        axes.axvline(subject.pressure_bar, color="black", linestyle=":", linewidth=1.0)
        axes.set_xlim(pressure[0], highest)
    handles, names = flow.get_legend_handles_labels()
    # Reversed, so that the list has the order of the layers.
    share.legend(
        handles[::-1], names[::-1], loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False
    )
    return figure


def _percent(subject: ModelSubject, flows: Mapping[str, Array]) -> dict[str, Array]:
    """Shares of the leakage by path, [%]; the flushing is no leakage, and none has no shares."""
    flushing = subject.motor.constant
    leaking = {name: flow for name, flow in flows.items() if not flushing or name != flushing.name}
    total = np.sum(list(leaking.values()), axis=0)
    return {
        name: 100.0 * np.divide(flow, total, out=np.zeros_like(flow), where=total > 0.0)
        for name, flow in leaking.items()
    }


def _stack(
    axes: Axes, pressure: Array, layers: Mapping[str, Array], places: Mapping[str, int]
) -> None:
    """Layers on one another, each with its colour and hatch, by path name."""
    below = np.zeros_like(pressure)
    for name, layer in layers.items():
        style = pen(places[name])
        axes.fill_between(
            pressure, below, below + layer, label=name, facecolor=style.colour, alpha=0.85,
            hatch=style.hatch, edgecolor="white", linewidth=0.5,
        )  # fmt: skip
        below = below + layer
    axes.set_ylim(bottom=0.0)
