"""Proof on machines that nobody of this project simulated; docs/evidence.md has the results.

Development only: the package does not contain it, and nothing of the program imports it.
"""
