"""Logs as delimited text.

Imports `ingest`'s contract, `config` and what lies below.
"""
