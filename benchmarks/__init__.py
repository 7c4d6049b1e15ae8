"""Slow measurements; `make bench` runs them and writes to `benchmarks/results/`.

Pages of results without a benchmark here were measured once; each says when and how.
"""
