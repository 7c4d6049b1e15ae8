"""One motor's night, from raw channels to rows of the tables; `fit_night` reads from the top.

Imports `leakage`, `ingest`'s contract, `config`, `schema`; stages import one another
for types alone.
"""
