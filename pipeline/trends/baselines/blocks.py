"""Blocks of a motor's nights for comparisons at another duty; those of its baseline are kept.

What is kept only saves the reading of the baseline's nights, and is made anew where their files
are not those that it was read from.
"""

from __future__ import annotations

import datetime as dt
import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import polars as pl

from leakage.course.balanced_baseline import DutyBlocks
from pipeline.config import MotorSpec
from pipeline.config.hashes import hash_of
from pipeline.errors import StoreError
from pipeline.night.stored_blocks import BLOCK_COLUMNS, StoredBlocks
from pipeline.schema import BLOCK_STATISTICS
from pipeline.store.atomic_files import put
from pipeline.store.sealed import read_if_whole
from pipeline.store.tables import night_stamps, read_rows
from pipeline.trends.nights.kept_nights import decoded, encoded, kept_folder
from pipeline.trends.nights.records import Layout, record_digest

log = logging.getLogger(__name__)

FILE = "baseline"


@dataclass(slots=True)
class BlockFiles:
    """Blocks of some motors' nights; each file is read once."""

    output: Path
    motor_ids: Sequence[str]
    _rows: dict[dt.date, pl.DataFrame] = field(default_factory=dict)

    def of(
        self, spec: MotorSpec, layout: Layout, nights: Sequence[dt.date], model: str
    ) -> DutyBlocks | None:
        """Blocks of a model; None where there are none, or some are of another one."""
        told = []
        for night in nights:
            found = self._night(spec, layout, night, model)
            if found is None:
                return None
            if found.rows.height:
                told.append(found)
        if not told:
            return None
        labels = [one.rows["night"].to_numpy().astype("M8[D]").astype(np.int64) for one in told]
        return DutyBlocks(
            np.concatenate([one.factors for one in told]),
            np.concatenate([one.block_means() for one in told]),
            np.concatenate(labels),
        )

    def _night(
        self, spec: MotorSpec, layout: Layout, night: dt.date, model: str
    ) -> StoredBlocks | None:
        if night not in self._rows:
            self._rows[night] = read_rows(
                self.output, BLOCK_STATISTICS, self.motor_ids, BLOCK_COLUMNS, nights=[night]
            )
        rows = self._rows[night].filter(motor_id=spec.motor_id)
        return layout.blocks(spec, rows) if set(rows["model_hash"]) <= {model} else None

    def of_baseline(
        self, spec: MotorSpec, layout: Layout, nights: Sequence[dt.date], model: str
    ) -> DutyBlocks | None:
        """The same of a baseline's nights, as kept by a run before where that still holds."""
        path, size = kept_folder(self.output) / spec.motor_id / FILE, len(layout.columns)
        of_what = {"records": record_digest(layout), "model": model, "files": self._stamps(nights)}
        key = hash_of(of_what | {"oil": [spec.measured_curve(night) for night in nights]})
        kept = read_if_whole(path, decoded)
        if kept is not None and kept[0]["key"] == key:
            factors, conditions, labels = map(np.frombuffer, kept[1], (float, float, np.int64))
            return DutyBlocks(factors.reshape(-1, size, size), conditions.reshape(-1, 3), labels)
        found = self.of(spec, layout, nights, model)
        if found is not None:
            arrays = found.factors, found.conditions, found.nights
            try:
                put(path, encoded({"key": key}, *arrays), durable=False)
            except StoreError as error:
                log.warning("%s; the next run reads the nights again", error)
        return found

    def _stamps(self, nights: Sequence[dt.date]) -> list[tuple[str, str]]:
        """The files of some nights, as they are now."""
        labels = [night.isoformat() for night in nights]
        of_month = {
            month: night_stamps(self.output, BLOCK_STATISTICS, month)
            for month in {one[:7] for one in labels}
        }
        return [(label, of_month[label[:7]].get(label, "")) for label in labels]
