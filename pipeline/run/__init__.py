"""The nightly run: plan, one task a motor, publishing, trends, telling.

Imports every room but `cli`, `report`, `export`, `setup`, `model_figures` and `demo`.
"""
