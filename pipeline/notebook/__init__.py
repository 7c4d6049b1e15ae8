"""For notebooks: samples cleaned as the nightly run does, and published tables.

Imports `leakage`, `logs`, `store`, `night`, `ingest`'s contract, `config` and `schema`.
"""

from pipeline.notebook.preparing import Prepared, fit_periods, prepare, prepare_log
from pipeline.notebook.results import Tables, open_tables

__all__ = [
    "Prepared",
    "Tables",
    "fit_periods",
    "open_tables",
    "prepare",
    "prepare_log",
]
