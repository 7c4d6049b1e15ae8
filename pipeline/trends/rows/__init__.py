"""Rows of the trend tables, and a motor's state in one row."""
