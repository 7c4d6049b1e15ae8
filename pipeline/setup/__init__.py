"""Strangers' logs: `init` sniffs them, names their columns and proposes config; `check` looks on.

Imports `night`, `logs`, `ingest`, `config` and what lies below; the run does without it.
"""
