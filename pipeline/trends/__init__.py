"""A motor against its own past and its oil circuit: baselines, states, alarms.

Works on the published tables alone. `stage.py` reads from the top; its rooms, from the bottom up:
`nights`, `figures`, `baselines`, `states`, `why`, `rows`.
"""
