"""The intraday check: the night so far, judged by the watch of the nights before.

Reads growing logs and what the nightly run has published, and writes a table of its own; imports
`trends`, `logs`, `notification`, `night` and what lies below.
"""
