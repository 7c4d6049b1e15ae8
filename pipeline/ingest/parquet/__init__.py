"""Logs as Parquet, written by others.

Imports `ingest`'s contract, `config` and what lies below.
"""

from pipeline.ingest.contract import Reader
from pipeline.ingest.parquet.log import parquet_time_span, parquet_units, read_parquet_log

__all__ = ["READER"]

READER = Reader(read_parquet_log, parquet_time_span, units=parquet_units)
