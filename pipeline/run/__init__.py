"""The nightly run: plan, tasks of motors and chunks, publishing, trends, telling.

Imports every room but `cli`, `report`, `export`, `setup` and `demo`.
"""
