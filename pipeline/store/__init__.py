"""Files of an output: whole or not at all, checksummed, published, copied to a URL.

Knows nothing of motors; imports `config` and `schema`.
"""
