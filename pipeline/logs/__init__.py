"""A motor's log files: places, nights, the record of processed ones.

Imports `ingest`, `store`, `config` and what lies below.
"""
