"""A motor's nights as its blocks are stored, with the truth beside them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from leakage.watch import Machine, NightBlocks
from pipeline.arrays import Array

BLOCK_S = 120.0


@dataclass(frozen=True)
class Event:
    """What happens to a motor, and what may be said of it."""

    course: Callable[[int], Any]  # its state in each night
    nights: int
    begin: int | None = None  # night from which on something is otherwise than it was
    right: frozenset[str] = frozenset()  # causes that are true
    near: frozenset[str] = frozenset()  # causes that say less than the truth, and nothing false
    is_step: bool = True


class Asked(NamedTuple):
    """Conditions of which the leakage is asked for after the last night, and what it is."""

    drives: Array  # of the paths, shape (p,)
    conditions: Array  # [°C], [bar], [rpm]
    leakage: float  # [l/min]


@dataclass(frozen=True, slots=True)
class History:
    """A motor's nights, what the watch is given of it, and what is true."""

    machine: Machine
    nights: tuple[NightBlocks, ...]
    # What is measured over what the machine as at first has at the conditions as read, less 1, of
    # each night and without errors: at the night's conditions, and at those of the baseline.
    newest_night: Array
    change: Array
    asked: tuple[Asked, ...] = ()


def block_means(samples: Array, step_s: float) -> Array:
    """Means of blocks of two minutes of the first axis."""
    rows = round(BLOCK_S / step_s)
    n = len(samples) // rows
    found: Array = samples[: n * rows].reshape(n, rows, *samples.shape[1:]).mean(axis=1)
    return found


def night_blocks(drives: Array, flow: Array, conditions: Array) -> tuple[NightBlocks, ...]:
    """Nights from means of shape (blocks, nights, p), (blocks, nights), (blocks, nights, 3)."""
    middle_s = np.asarray(BLOCK_S * (np.arange(len(flow)) + 0.5), np.float64)
    return tuple(
        NightBlocks(day, middle_s, drives[:, day], flow[:, day], conditions[:, day])
        for day in range(flow.shape[1])
    )
