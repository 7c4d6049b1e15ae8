"""The nightly run: plan, tasks of motors, publishing, trends, notification.

Imports every room but `cli`, `report`, `export`, `setup` and `demo`.
"""
