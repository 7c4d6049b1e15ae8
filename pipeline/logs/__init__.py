"""A motor's log files: their places, records and nights, and the ledger; nights of a database.

Imports `ingest`, `store`, `config` and what lies below.
"""
