"""Run benchmarks by name, or all: `python -m benchmarks [NAME ...]`."""

from __future__ import annotations

import importlib
import sys

BENCHMARKS = (
    "alarms",
    "coverage",
    "cusum_limits",
    "demo_alarms",
    "demo_dialects",
    "demo_run",
    "demo_truth",
    "fuzz",
    "mcap_reading",
    "model_choices",
    "multi_start",
    "night_cost",
    "report",
    "residual_tests",
    "scale",
    "table_reading",
)


def main(names: list[str]) -> int:
    """Run the named benchmarks, one after the other."""
    strangers = sorted(set(names) - set(BENCHMARKS))
    if strangers:
        sys.stderr.write(
            f"no benchmark {', '.join(strangers)}; there are {', '.join(BENCHMARKS)}\n"
        )
        return 2
    for name in names or BENCHMARKS:
        importlib.import_module(f"benchmarks.{name}").main()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
