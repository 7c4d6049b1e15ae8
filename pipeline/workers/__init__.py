"""Processes in which tasks run: of this machine, or of a Dask cluster.

Knows nothing of motors; imports `store` and `config`.
"""
