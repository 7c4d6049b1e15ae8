"""First screen of a motor's page: gap changes with their limits, and leakage by path."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Array
from pipeline.palette import path_places
from pipeline.report.history import Course, MotorHistory
from pipeline.report.words import plain
from pipeline.trends.rows.motor_states import GAP, REFERENCES, MotorState
from pipeline.trends.states.words import name_of

Limits = dict[str, Array]
PATH = "leakage_"
# Conditions of the leakages that a state may have.
KINDS = dict(zip(REFERENCES, ("reference", "frozen", "comparable"), strict=True))


@dataclass(frozen=True, slots=True)
class Line:
    """A course on the first screen."""

    name: str  # for people
    place: int | None  # place of its path among the colours; None for what is no single path
    course: Course

    @property
    def now(self) -> tuple[float, ...]:
        """The newest value with its interval; empty without one."""
        known = np.flatnonzero(self.course.is_known)
        parts = (self.course.value, self.course.lower, self.course.upper)
        return tuple(float(part[known[-1]]) for part in parts) if len(known) else ()


@dataclass(frozen=True, slots=True)
class FirstScreen:
    """Content of the first screen of a motor's page, over its n nights."""

    # Change of each gap that has a baseline, %; if none has, of the leakage.
    changes: tuple[Line, ...]
    limits: Limits  # levels of warning and alarm of the change that leads, by name, shape (n,), %
    limits_of: str  # name of that change; empty without limits
    # leakage_kind, leakage: which comparable conditions, and the leakage there, l/min; the drain
    # flow where it is not known.
    leakage_kind: str
    leakage: Course
    paths: tuple[Line, ...]  # its parts, l/min; empty where the nights do not tell the paths apart
    flow: Course  # mean drain flow as measured, l/min


def first_screen(motor: MotorHistory, state: MotorState, declared: Sequence[str]) -> FirstScreen:
    """The first screen of a motor of which some paths are declared, in the config's order."""
    paths = {name.removeprefix(GAP): name for name in motor.trends if name.startswith(GAP)}
    parts = [name.removeprefix(PATH) for name in motor.trends if name.startswith(PATH)]
    places = path_places([*declared, *paths, *parts])
    changes = [
        Line(plain(path), places[path], course)
        for path, name in paths.items()
        if (course := motor.course(name)).is_known.any()
    ]
    leading, limits = _leading_limits(
        motor, state, sorted(paths, key=places.__getitem__) if changes else []
    )
    if not changes and leading:
        changes = [Line(name_of(leading), None, _relative(motor, leading))]
    kind = drawn_kind(motor, state)
    return FirstScreen(
        tuple(sorted(changes, key=lambda line: line.place or 0)),
        limits,
        name_of(leading) if limits else "",
        kind,
        motor.leakages[kind],
        _stack(motor, motor.leakages[kind], parts, places) if kind == "reference" else (),
        motor.flow,
    )


def drawn_kind(motor: MotorHistory, state: MotorState) -> str:
    """Conditions of the leakage to draw: those of the state's leakage where nights count for it."""
    kind = KINDS.get(state.leakage_indicator or "", "")
    known = kind and motor.leakages[kind].is_known.any()
    return kind if known else motor.leakage_kind


def _leading_limits(
    motor: MotorHistory, state: MotorState, gaps: Sequence[str]
) -> tuple[str, Limits]:
    """The indicator whose limits are drawn, and they in percent of its baseline.

    Of the gaps it is the one that the state is of, or else that has changed most; without a gap
    the leakage that has a baseline.
    """
    allowed = [f"K_{path}" for path in gaps] or list(REFERENCES)
    first = [one for one in (state.indicator, f"K_{state.gap_path}") if one in allowed]
    for name in (*first, *allowed):
        if motor.baseline(name):
            levels = {
                level: _percent(name, motor.column(name, f"{level}_limit"), motor)
                for level in ("warning", "alarm")
            }
            return name, levels
    return "", {}


def _relative(motor: MotorHistory, indicator: str) -> Course:
    """Change of an indicator against its baseline, %."""
    course = motor.course(indicator)
    parts = (course.value, course.lower, course.upper)
    return Course(*(_percent(indicator, part, motor) for part in parts))


def _percent(indicator: str, figures: Array, motor: MotorHistory) -> Array:
    """Figures against the night's baseline, %; of a loss factor K of the gap height, K ∝ h³."""
    ratio = figures / motor.column(indicator, "baseline_mean")
    return 100.0 * ((np.cbrt(ratio) if indicator.startswith("K_") else ratio) - 1.0)


def _stack(
    motor: MotorHistory, total: Course, parts: Iterable[str], places: Mapping[str, int]
) -> tuple[Line, ...]:
    """Leakage by path in nights that tell all free paths, and what is left."""
    found = {path: motor.course(PATH + path).value for path in parts}
    known = {path: flow for path, flow in found.items() if np.isfinite(flow).any()}
    if not known:
        return ()
    rest = total.value - np.sum(list(known.values()), axis=0)
    told: NDArray[np.bool_] = np.isfinite(rest)
    if not told.any():
        return ()
    others = [path for path in places if path not in known]
    lines = [
        Line(plain(path), places[path], Course.without_interval(np.where(told, flow, np.nan)))
        for path, flow in known.items()
    ]
    if others:
        place = places[others[0]] if len(others) == 1 else None
        flow = Course.without_interval(np.maximum(rest, 0.0))
        lines.append(Line(f"{', '.join(map(plain, others))} (the rest)", place, flow))
    return tuple(sorted(lines, key=lambda line: (line.place is None, line.place)))
