"""Published tables in other formats.

Imports `store` and `schema`.
"""
