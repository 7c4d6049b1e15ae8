"""Logs as loggers of many makes write them: the same content in any dialect.

Shared by the tests and the benchmarks. The writers know the formats from their specifications and
from the formats' own libraries, and nothing of the readers.
"""
