"""A motor against its own past and its oil circuit: baselines, states, alarms.

Works on the published tables alone; imports `night` and what lies below.
"""
