"""Looks within the day: new minutes of growing logs against the watch of the nights before.

Reads what the nightly run has published and kept, and writes a folder and a table of its own;
imports `trends`, `logs`, `notification`, `night` and what lies below.
"""
