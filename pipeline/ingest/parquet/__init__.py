"""Logs as Parquet, written by others.

Imports `ingest`'s contract, `config` and what lies below.
"""
