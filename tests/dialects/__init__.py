"""Logs as loggers of many makes write them: the same content in any dialect.

The writers know the formats from their specifications and
from the formats' own libraries, and nothing of the readers.
"""
