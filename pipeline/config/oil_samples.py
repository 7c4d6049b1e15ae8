"""Oil samples as a laboratory reports them, and the file of an oil circuit, which holds its own."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Annotated

import numpy as np
from pydantic import Field

from leakage.physics.oil import walther_coefficients, walther_through
from pipeline.config.motor_types import OilFile
from pipeline.config.section import Misfit, Section, Stage

Walther = tuple[float, float]
# A viscosity further from the data sheet, by this factor, is a slip or another oil.
FURTHEST = 3.0


class OilSample(Section):
    """An analysis of the oil in use."""

    shapes = Stage.FIGURES

    date: dt.date
    """Day on which it was drawn."""
    viscosity_40_c_mm2_per_s: Annotated[float, Field(ge=2, le=2000)] | None = None
    """Kinematic viscosity at 40 °C."""
    viscosity_100_c_mm2_per_s: Annotated[float, Field(ge=1, le=200)] | None = None
    """The same at 100 °C; by default by the data sheet's slope."""
    water_mg_per_kg: Annotated[float | None, Field(ge=0, le=100_000), Stage.TRENDS] = None
    """Water content, for information."""

    def misfits(self) -> Iterator[Misfit]:
        at_40, at_100 = self.viscosity_40_c_mm2_per_s, self.viscosity_100_c_mm2_per_s
        if at_40 is None and self.water_mg_per_kg is None:
            yield (), "expected viscosity_40_c_mm2_per_s or water_mg_per_kg", None
        if at_100 is not None and (at_40 is None or at_100 >= at_40):
            message = "expected viscosity_40_c_mm2_per_s beside it, and less than that"
            yield ("viscosity_100_c_mm2_per_s",), message, at_100

    def curve(self, oil: OilFile) -> Walther | None:
        """Return Walther constants of the sample; None without a viscosity."""
        at_40, at_100 = self.viscosity_40_c_mm2_per_s, self.viscosity_100_c_mm2_per_s
        if at_40 is None:
            return None
        if at_100 is not None:
            return walther_coefficients(40.0, at_40, 100.0, at_100)
        slope = oil.oil().walther_b
        return walther_through(40.0, at_40, slope), slope


class OilCircuitFile(Section):
    """`oil_circuits/<oil_circuit>.toml`: samples of the oil that motors share."""

    oil_samples: tuple[OilSample, ...] = ()
    """Analyses of the oil, by date."""

    def misfits(self) -> Iterator[Misfit]:
        return order_faults(self.oil_samples)


def order_faults(samples: Sequence[OilSample]) -> Iterator[Misfit]:
    """Yield samples that are not in order of their dates."""
    for index, (before, after) in enumerate(pairwise(samples), start=1):
        if after.date <= before.date:
            message = f"expected a date after {before.date}, that of the sample before"
            yield ("oil_samples", index, "date"), message, after.date.isoformat()


def measured_curve(
    samples: Sequence[OilSample], oil: OilFile, filled: dt.date | None, night: dt.date
) -> Walther | None:
    """Return Walther constants in a night by the samples of a filling; None: by the data sheet.

    Between two samples A and B are linear in time, and so is log log Z = A − B log T (ASTM D341).
    A filling with a date begins as the data sheet has it.
    """
    known = [(sample.date, curve) for sample in samples if (curve := sample.curve(oil)) is not None]
    if known and filled is not None and filled < known[0][0]:
        sheet = oil.oil()
        known.insert(0, (filled, (sheet.walther_a, sheet.walther_b)))
    if not known or night < known[0][0]:
        return None
    days = [date.toordinal() for date, _ in known]
    a, b = (
        float(np.interp(night.toordinal(), days, constants))
        for constants in zip(*(curve for _, curve in known), strict=True)
    )
    return a, b
