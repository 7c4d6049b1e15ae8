"""Indicators of a motor's nights that are told night by night, each with its interval."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from leakage.course.baseline import COEFFICIENT_FLOOR, LEAKAGE_FLOOR
from pipeline.trends.figures.filtered_nights import WIDEST_COEFFICIENT, Filtered, filtered
from pipeline.trends.figures.temperature import Effect
from pipeline.trends.nights.history import History
from pipeline.trends.nights.records import FLUSHING

Array = NDArray[np.float64]

REFERENCE, OWN_REFERENCE = "reference_leakage", "own_reference_leakage"
DEVIATION, PEER_DEVIATION = "baseline_deviation", "peer_deviation"
# Told from the first night on, and not watched.
DRAIN_FLOW, COMPARABLE_FLOW = "drain_flow", "comparable_drain_flow"
BASELINE_PROGRESS, TEMPERATURE_EFFECT = "baseline_progress", "temperature_effect"
MODEL_MISFIT, OIL_VISCOSITY = "model_misfit", "oil_viscosity"
# An indicator around 0 is watched as a ratio around 1.
SHIFTS = {DEVIATION: 1.0}
NO_BASELINE = "no baseline yet"


@dataclass(frozen=True, slots=True)
class Indicator:
    """A figure over a motor's nights; shape (n,) each."""

    # name, unit: as in `trends`.
    name: str
    unit: str
    path: str  # the leakage path whose coefficient it is; empty for none
    value: Array  # nan where there is none
    # lower, upper: 95 % interval; nan where there is none.
    lower: Array
    upper: Array
    gated: tuple[str, ...]  # why a night does not count; empty where it does
    floor: float  # least standard deviation of its baseline, relative to the mean
    outside: NDArray[np.bool_]  # whether its conditions lie outside what the night's samples saw
    # Whether the figure was known in its own night: what is relative to a baseline is not known
    # before that is.
    told: NDArray[np.bool_]
    n_nights: NDArray[np.int32]  # nights behind it
    allowance: Array | float = 0.0  # relative ± that nights of one temperature share; 0 for none
    # Watched series where it is another one than the value: at the duty of the baseline.
    compared: Array | None = None

    @classmethod
    def of(
        cls, name: str, unit: str, value: Array, gated: Sequence[str], floor: float, **more: Any
    ) -> Indicator:
        """Figures that each night tells alone, known in their night and without interval.

        `more` are those of the other fields that are not so.
        """
        n = len(value)
        nothing, no = np.full(n, np.nan), np.zeros(n, dtype=np.bool_)
        blank = {"path": "", "lower": nothing, "upper": nothing, "outside": no, "told": ~no}
        one_night = np.ones(n, dtype=np.int32)
        fields = {**blank, "n_nights": one_night, **more}
        return cls(name=name, unit=unit, value=value, gated=tuple(gated), floor=floor, **fields)

    def with_allowance(self, allowance: Array) -> Indicator:
        """The same with a relative ± that nights of one temperature share, in its interval, too."""
        size = np.abs(allowance * (self.value + self.shift))
        return replace(
            self,
            lower=self.value - np.hypot(self.value - self.lower, size),
            upper=self.value + np.hypot(self.upper - self.value, size),
            allowance=allowance,
        )

    @property
    def shift(self) -> float:
        """Constant added to the value for watching."""
        return SHIFTS.get(self.name, 0.0)

    @property
    def watched(self) -> Array:
        """Watched series, shape (n,): positive; nan where gated."""
        return self.trusted if self.compared is None else self.compared

    @property
    def trusted(self) -> Array:
        """The value as absolute limits take it, shape (n,): positive; nan where gated."""
        counts = np.array([not reason for reason in self.gated], dtype=np.bool_)
        return np.where(counts, self.value + self.shift, np.nan)


def with_filtered(own: Indicator, found: Filtered, widest: float, size: Array) -> Indicator:
    """An indicator with the filter's figures in the nights that have none of their own.

    A filtered figure counts up to the half-width `widest`, relative to `size`, shape (n,).
    """
    taken = np.isnan(own.value) & np.isfinite(found.half)
    counts = found.counts(widest * size)
    gated = list(own.gated)
    for place in np.flatnonzero(taken).tolist():
        gated[place] = "" if counts[place] else found.why(place, float(size[place]), widest)
    return replace(
        own,
        value=np.where(taken, found.value, own.value),
        lower=np.where(taken, found.value - found.half, own.lower),
        upper=np.where(taken, found.value + found.half, own.upper),
        gated=tuple(gated),
        n_nights=np.where(taken, found.n_nights, own.n_nights),
    )


def coefficients(history: History, effect: Effect) -> Iterator[Indicator]:
    """The coefficient of each free path at T₀, and the flushing where it is estimated."""
    layout, n = history.layout, len(history)
    moved = effect.per_kelvin[:, None] * history.records["response"]
    for number, name in enumerate(layout.coefficients):
        # The rollers are the standard: which indicators are watched hangs on the config alone.
        if layout.standard is not None and number == layout.standard[0]:
            continue
        figures = history.records["figures"][:, number]
        is_flow = name == FLUSHING
        place = len(layout.free) - 1 if is_flow else number
        factor = np.ones(n) if is_flow else effect.factor
        value, lower, upper = ((figures + moved[:, place, None]) / factor[:, None]).T
        alone = Indicator.of(
            name,
            "l/min" if is_flow else "m3" if name.startswith("K_") else "1",
            value,
            history.why(np.isfinite(figures[:, 0]), number),
            LEAKAGE_FLOOR if is_flow else COEFFICIENT_FLOOR,
            path="" if is_flow else layout.paths[number],
            lower=lower,
            upper=upper,
        )
        if not layout.free[place]:
            yield alone
            continue
        found = filtered(history.records, np.eye(len(layout.free))[place])
        yield with_filtered(alone, found, WIDEST_COEFFICIENT, history.records["scale"][:, place])
