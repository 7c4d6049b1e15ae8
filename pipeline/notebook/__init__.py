"""For notebooks: samples cleaned as the nightly run does, published tables, a plot of a course.

Imports `leakage`, `logs`, `store`, `night`, `ingest`'s contract, `config` and `schema`.
"""

from pipeline.notebook.course import plot_course
from pipeline.notebook.periods import fit_periods
from pipeline.notebook.preparing import Prepared, prepare, prepare_log
from pipeline.notebook.results import Tables, open_tables

__all__ = [
    "Prepared",
    "Tables",
    "fit_periods",
    "open_tables",
    "plot_course",
    "prepare",
    "prepare_log",
]
