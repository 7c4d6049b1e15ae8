"""Logs as delimited text.

Imports `ingest`'s contract, `config` and what lies below.
"""

from pipeline.ingest.contract import Reader
from pipeline.ingest.csv.log import (
    csv_can_grow,
    csv_time_span,
    csv_units,
    read_csv_log,
    read_csv_piece,
)

__all__ = ["READER"]

READER = Reader(
    read_csv_log,
    csv_time_span,
    units=csv_units,
    can_grow=csv_can_grow,
    piece=read_csv_piece,
)
