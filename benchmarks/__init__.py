"""Slow studies and measurements; `make bench` runs them and writes to `benchmarks/results/`.

Simulated nights are made in one of two ways: `simulated_nights` (a duty, and its nights compressed;
`night_kinds` fits them by length, rate and errors), and `watch` (a motor's nights as stored blocks,
fitted or not, for what is told from night to night).
"""
