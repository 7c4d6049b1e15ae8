"""Looks within the day: new minutes of growing logs against the frozen baseline.

Reads what the nightly run has published and writes a folder and a table of its own; imports
`trends`, `logs`, `telling`, `night` and what lies below.
"""
