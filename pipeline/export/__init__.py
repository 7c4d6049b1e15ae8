"""Published tables as CSV.

Imports `store` and `schema`.
"""
