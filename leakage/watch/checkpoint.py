"""The state of a watch as arrays of numbers, and back: what a run keeps for the next one."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from typing import Any, get_args, get_type_hints

import numpy as np

from leakage.arrays import Array
from leakage.watch.baseline import Baseline
from leakage.watch.causes import BACK, Cause
from leakage.watch.evidence import Sums, Window
from leakage.watch.nights import Estimate, Machine, WatchSettings
from leakage.watch.state import ChangeInForce, Crossing, WatchState, all_causes
from leakage.watch.wander import Wander

Arrays = dict[str, Any]


@dataclass(frozen=True, slots=True)
class WatchCheckpoint:
    """Fields of a state that are kept; its sums and causes are made of them.

    `undone` are directions of the causes that undo what was adopted, shape (u, q), `undone_size`
    mean and spread of each, shape (u, 2).
    """

    baseline: Baseline
    window: Window
    wander: Wander
    undone: Array
    undone_size: Array
    first_step: int
    first_ramp: int
    n_baseline: int
    n_nights: int
    due: int
    often: float
    evidence: float
    period_from: int | None
    carried: Estimate
    in_force: ChangeInForce | None
    crossing: Crossing | None


AS_IN_STATE = tuple(
    field.name for field in fields(WatchCheckpoint) if not field.name.startswith("undone")
)


def arrays_of(state: WatchState) -> dict[str, Array]:
    """Return all numbers of a state, by name."""
    undone = [cause for cause in state.causes.every if cause.name == BACK]
    stored = WatchCheckpoint(
        undone=np.array([cause.direction for cause in undone]).reshape(
            -1, state.baseline.columns.n
        ),
        undone_size=np.array([(cause.mean, cause.spread) for cause in undone]).reshape(-1, 2),
        **{name: getattr(state, name) for name in AS_IN_STATE},
    )
    return _packed("state", stored)


def state_of(machine: Machine, settings: WatchSettings, arrays: Mapping[str, Any]) -> WatchState:
    """Return the state that was kept."""
    stored: WatchCheckpoint = _unpacked(WatchCheckpoint, "state", arrays)
    undone = [
        Cause(BACK, along, mean, spread)
        for along, (mean, spread) in zip(stored.undone, stored.undone_size.tolist(), strict=True)
    ]
    return WatchState(
        machine,
        settings,
        sums=Sums.of(stored.window, stored.wander),
        causes=all_causes(machine, stored.baseline, undone),
        **{name: getattr(stored, name) for name in AS_IN_STATE},
    )


def _packed(name: str, part: Any) -> Arrays:
    """Return arrays of a dataclass and of those in it by name; all else as bytes of a text."""
    packed: Arrays = {}
    words: dict[str, Any] = {}
    for field in fields(part):
        value, own = getattr(part, field.name), f"{name}.{field.name}"
        if isinstance(value, np.ndarray):
            packed[own] = value
        elif is_dataclass(value):
            packed |= _packed(own, value)
        else:
            words[field.name] = value
    return {name: np.frombuffer(json.dumps(words).encode(), dtype=np.uint8)} | packed


def _unpacked(kind: Any, name: str, arrays: Mapping[str, Any]) -> Any:
    values: dict[str, Any] = json.loads(bytes(arrays[name]))
    for field, part in _parts_of(kind).items():
        own, value = f"{name}.{field}", values.get(field)
        if isinstance(value, list):
            values[field] = tuple(value)
        elif field not in values:
            values[field] = _unpacked(part, own, arrays) if part else arrays[own]
    return kind(**values)


@cache
def _parts_of(kind: Any) -> dict[str, Any]:
    """Return the dataclass of each field that has one, or may have none; None of the others.

    Kept, as a night of a thousand motors asks for the same hints seven thousand times.
    """
    return {
        field: next((part for part in (hint, *get_args(hint)) if is_dataclass(part)), None)
        for field, hint in get_type_hints(kind).items()
    }
