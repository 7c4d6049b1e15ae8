"""Logs as MCAP, and the message encodings in it.

Imports `ingest`'s contract, `config` and what lies below.
"""

from pipeline.ingest.mcap.log import READER

__all__ = ["READER"]
