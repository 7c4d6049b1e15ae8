"""One motor's night, from raw channels to rows of the tables; `fit_night` reads from the top.

Reads and writes no file. Imports `leakage`, `ingest`'s contract, `config` and `schema`.
"""
