"""Scenarios: fleets with a known truth, run by the command, judged by what it publishes."""
