"""Slow studies and measurements; `make bench` runs them and writes to `benchmarks/results/`."""
