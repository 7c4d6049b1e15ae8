"""The disk fails, the process dies, others read: what is published stays whole."""
