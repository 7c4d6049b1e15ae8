"""What the watch knows of a motor: its paths, its oil, and blocks of its nights."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass, replace

import numpy as np
import polars as pl

from leakage import LeakageError, regressors
from leakage.estimation.blocks import with_free_known
from leakage.physics.oil import kinematic_viscosity_mm2_per_s
from leakage.watch import Machine, NightBlocks
from pipeline.arrays import Array
from pipeline.config import MotorSpec
from pipeline.config.settings import Conditions
from pipeline.night.statistics import StoredBlocks
from pipeline.night.time_base import VISCOSITIES

FLUSHING, KNOWN = "flushing", "known"
# Beginning of the coefficients' names of gaps.
LOSS_FACTOR = "K_"
MICROSECONDS = 1e6


@dataclass(frozen=True, slots=True)
class WatchColumns:
    """Paths of a motor, and where its stored statistics have them."""

    paths: tuple[str, ...]  # those with a free coefficient, in the order of the columns
    coefficients: tuple[str, ...]  # names of theirs
    columns: tuple[str, ...]  # of the statistics
    is_flushed: bool  # whether the flushing is estimated
    fixed_flushing: float  # flow of a stated flushing [l/min]
    is_known: bool  # whether there is a flow without a free coefficient
    # Place of the cam rollers among the paths where their scale is estimated, and how much of the
    # known flow it is as stated; None otherwise.
    standard: tuple[int, float] | None = None

    @classmethod
    def of(cls, spec: MotorSpec, night: dt.date) -> WatchColumns:
        """Return the columns of a motor; which night does not matter."""
        flushing = spec.file.flushing
        motor = spec.motor(night, flushing.mode)
        names = tuple(path.name for path in motor.column_paths)
        standard = None
        if spec.roller_is_free:
            stated = spec.stated.motor(night, flushing.mode).standard
            if stated is not None:
                standard = names.index(stated.name), stated.configured_coefficient
        return cls(
            names,
            tuple(path.coefficient_name for path in motor.column_paths),
            tuple(motor.columns),
            flushing.mode == "estimated",
            flushing.flow_l_per_min if flushing.mode == "fixed" else 0.0,
            any(path.configured_coefficient for path in motor.known_paths),
            standard,
        )

    @property
    def watched(self) -> tuple[str, ...]:
        """Paths as the watch has them."""
        further = ((FLUSHING, self.is_flushed), (KNOWN, self.is_known))
        return (*self.paths, *(name for name, is_there in further if is_there))

    @property
    def gaps(self) -> tuple[str, ...]:
        """Those that are gaps."""
        pairs = zip(self.paths, self.coefficients, strict=True)
        return tuple(path for path, name in pairs if name.startswith(LOSS_FACTOR))

    def machine(self, spec: MotorSpec, night: dt.date) -> Machine:
        """Return the motor in a baseline period; an oil that is measured is no other grade."""
        is_logged = any(name in spec.file.channels for name in VISCOSITIES)
        if is_logged or spec.measured_curve(night) is not None:
            return Machine(self.watched, self.gaps)
        oil = spec.oil_on(night).oil()
        at_40, at_100 = kinematic_viscosity_mm2_per_s(
            np.array([40.0, 100.0]), oil.walther_a, oil.walther_b
        ).tolist()
        return Machine(self.watched, self.gaps, (at_40, at_100))

    def blocks(self, spec: MotorSpec, rows: pl.DataFrame) -> StoredBlocks | None:
        """Return blocks of a night's rows, in their columns; None if they are of another model."""
        # As stored, the cam rollers are in the known flow.
        rollers = None if self.standard is None else self.standard[0]
        columns = tuple(name for place, name in enumerate(self.columns) if place != rollers)
        stored = StoredBlocks.of(spec, rows.sort("block_start"), columns)
        if stored is None or self.standard is None:
            return stored
        return replace(stored, factors=with_free_known(stored.factors, *self.standard))

    def night_blocks(self, stored: StoredBlocks) -> NightBlocks:
        """Return block means of a night, by the oil as measured, without the stated flushing."""
        factors = stored.factors
        # The column of ones times all columns: R'R of it.
        sums = np.einsum("bij,bi->bj", factors, factors[:, :, -3])
        means = sums / sums[:, -3, None]
        begin, end = (
            stored.rows[name].to_physical().to_numpy() / MICROSECONDS
            for name in ("block_start", "block_end")
        )
        middle = (begin + end) / 2.0
        return NightBlocks(
            stored.rows["night"][0].toordinal(),
            middle - begin[0],
            self.driven(means[:, :-1]),
            means[:, -1] - self.fixed_flushing,
            np.abs(stored.block_means()),
        )

    def drives_at(self, spec: MotorSpec, night: dt.date, at: Conditions) -> Array | str:
        """Return flow a unit of each coefficient without flushing; a text where the model fails."""
        try:
            row = regressors(spec.motor(night, spec.file.flushing.mode), at.operating)
        except LeakageError as error:
            return str(error)
        row[:, -2] = 0.0
        drives: Array = self.driven(row)[0]
        return drives

    def driven(self, columns: Array) -> Array:
        """Return columns of the paths as the watch has them, of those up to the known flow."""
        taken = [True] * len(self.paths) + [self.is_flushed, self.is_known]
        chosen: Array = columns[:, np.array(taken)]
        return chosen
