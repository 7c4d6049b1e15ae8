"""A motor's log files: where they are, what is known of each, and the ledger of what was read.

Imports `ingest`, `store`, `config` and what lies below.
"""
