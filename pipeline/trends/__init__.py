"""A motor against its own past and its oil circuit: baselines, states, alarms.

Works on the published tables alone. `stage.py` reads from the top; its modules from the bottom up
stand in the contracts of `pyproject.toml`.
"""
