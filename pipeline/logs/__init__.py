"""A motor's log files: places, nights, the record of processed ones; nights of a database.

Imports `ingest`, `store`, `config` and what lies below.
"""
