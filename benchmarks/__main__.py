"""Run benchmarks by name, or all: `python -m benchmarks [NAME ...]`; one may have options."""

from __future__ import annotations

import importlib
import sys

BENCHMARKS = (
    "alarms",
    "alternatives",
    "attribution",
    "coverage",
    "cusum_limits",
    "dates",
    "demo_alarms",
    "filtered_nights",
    "fuzz",
    "guard",
    "model_choices",
    "model_verdict",
    "month_files",
    "night_cost",
    "noise",
    "notebook",
    "notebook_rivals",
    "residual_tests",
    "scale",
    "speed",
    "wide_plant",
    "within_day",
)


def main(arguments: list[str]) -> int:
    """Run the named benchmarks, one after the other; what follows a dash is for the only one."""
    first_option = next(
        (place for place, text in enumerate(arguments) if text.startswith("-")), len(arguments)
    )
    names, options = arguments[:first_option], arguments[first_option:]
    strangers = sorted(set(names) - set(BENCHMARKS))
    if strangers:
        sys.stderr.write(
            f"no benchmark {', '.join(strangers)}; there are {', '.join(BENCHMARKS)}\n"
        )
        return 2
    if options:
        (name,) = names
        return int(importlib.import_module(f"benchmarks.{name}").main(options) or 0)
    # What compares with results that are there does not make them, and a record is to be named.
    for name in names or (name for name in BENCHMARKS if name not in ("guard", "noise")):
        if status := importlib.import_module(f"benchmarks.{name}").main():
            return int(status)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
