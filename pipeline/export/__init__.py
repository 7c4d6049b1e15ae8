"""Published tables in other formats.

Imports `store` and `schema`.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Exported:
    """A table that was written: where to, its rows, and the version of a Delta table."""

    table: str
    place: str
    n_rows: int
    version: int | None = None
