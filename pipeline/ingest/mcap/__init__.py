"""Logs as MCAP, and the message encodings in it.

Imports `ingest`'s contract, `config` and what lies below.
"""

from pipeline.ingest.contract import Reader
from pipeline.ingest.mcap.log import mcap_time_span, read_mcap_log

__all__ = ["READER"]

READER = Reader(read_mcap_log, mcap_time_span)
