"""Files of logs to raw channels: one contract, a reader a format.

Imports config, units and errors, nothing else of the pipeline.
"""

from pipeline.ingest.assembly import Samples, log_of_samples
from pipeline.ingest.contract import LogFile, Place, RawChannel, RawLog, Reader, validate
from pipeline.ingest.readers import can_grow, read_log, read_piece, time_span

__all__ = [
    "LogFile",
    "Place",
    "RawChannel",
    "RawLog",
    "Reader",
    "Samples",
    "can_grow",
    "log_of_samples",
    "read_log",
    "read_piece",
    "time_span",
    "validate",
]
