"""Slow studies and measurements; `make bench` runs them and writes to `benchmarks/results/`.

Simulated nights are made in one of three ways: `simulated_nights` (a duty, and its nights
compressed), which `night_kinds` fits by length, rate and errors and `simulated_fleets` draws motors
from; `model_verdict` (sensor faults, other models); `machine_nights` (a machine that is not the
model), which `grey_box_nights` watches as a run does.
"""
