"""What may be wrong with units and columns, by the newest log as a motor's first run reads it."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.errors import LogError

if TYPE_CHECKING:
    from pipeline.config import MotorSpec
    from pipeline.ingest import RawChannel
    from pipeline.night.time_base import Samples


@dataclass(slots=True)
class FirstLook:
    """Findings that `check` has as well; what they need is loaded where there is a first run."""

    findings: list[str] = field(default_factory=list)

    def at_log(
        self,
        spec: MotorSpec,
        night: dt.date,
        dated: Sequence[tuple[dt.date, str]],
        path_of: Callable[[str], Path],
        channels: Mapping[str, RawChannel],
    ) -> None:
        """Judge the headers of the first and the newest log, and the newest night's channels."""
        from pipeline.setup.column_check import column_changes, differing_units, suspect_units

        with suppress(LogError):  # of a log that was changed since, which the run says
            self.findings += column_changes(spec, dated, path_of)
            self.findings += differing_units(path_of(dated[-1][1]), spec.file)
        self.findings += suspect_units(spec, night, channels)

    def at_samples(self, samples: Samples) -> None:
        """Judge the samples that cleaning kept of that night."""
        from pipeline.setup.operation import swapped

        self.findings += swapped(samples)
