"""A motor's log files: their places, records and nights, and the ledger.

Imports `ingest`, `store`, `config` and what lies below.
"""
