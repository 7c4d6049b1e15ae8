"""The reader through the conformance kit of motor-leakage: run with the package installed."""

from __future__ import annotations

import gc
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from asammdf import MDF, Signal

from pipeline.ingest.conformance import T0_US, Check, Format, Row, checks_of

# asammdf says so where it gives up on a damaged file.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")


def write(path: Path, rows: Sequence[Row], names: Sequence[str]) -> None:
    """Write rows as MDF 4.10: a group a signal, cells without a number as invalid samples."""
    with MDF(version="4.10") as mdf:
        mdf.start_time = datetime.fromtimestamp(T0_US / 1e6, UTC)
        for name in names:
            own = [row for row in rows if name in row.cells]
            cells = [row.cells[name] for row in own]
            signal = Signal(
                np.array([np.nan if cell is None else cell for cell in cells], np.float64),
                np.array([(row.time_us - T0_US) / 1e6 for row in own], np.float64),
                name=name,
                invalidation_bits=np.array([cell is None for cell in cells], np.bool_),
            )
            mdf.append([signal], acq_name=f"{name} raster")
        mdf.save(path.with_suffix(".mf4"), overwrite=True)
    path.with_suffix(".mf4").rename(path)


# asammdf 8 ends the process on some files with a flipped bit.
MDF4 = Format("mdf4", "mdf4", write, wide=False, holds_text=False, survives_damage=False)


@pytest.mark.parametrize("check", checks_of(MDF4), ids=lambda check: check.__name__)
def test_conformance(check: Check, tmp_path: Path) -> None:
    check(MDF4, tmp_path)
    gc.collect()
