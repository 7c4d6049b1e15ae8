"""A look at strangers' logs: `check`, and `check --suggest`, which proposes config.

Imports `night`, `logs`, `ingest`, `config` and what lies below; the run does without it.
"""
