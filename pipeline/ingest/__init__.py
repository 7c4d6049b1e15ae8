"""Files of logs to raw channels: a common contract, a reader a format.

Imports config, units and errors, nothing else of the pipeline.
"""

from pipeline.ingest.assembly import Samples, log_of_samples
from pipeline.ingest.contract import (
    LogFile,
    RawChannel,
    RawLog,
    Reader,
    read_log,
    time_span,
    validate,
)

__all__ = [
    "LogFile",
    "RawChannel",
    "RawLog",
    "Reader",
    "Samples",
    "log_of_samples",
    "read_log",
    "time_span",
    "validate",
]
