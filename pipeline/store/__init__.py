"""Files of an output: whole or not at all, checksummed, published, kept in an object store.

Knows nothing of motors; imports `config` and `schema`.
"""
