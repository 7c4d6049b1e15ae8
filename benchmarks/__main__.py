"""Run a benchmark, with options of its own, or `all`; without a name, list them."""

from __future__ import annotations

import importlib
import sys

# What compares with results that are there does not make them.
BENCHMARKS = {
    "guard": "is the program slower than it was? (not in `all`)",
    "intraday": "false rises of the intraday check on healthy days",
    "mutation": "faults planted in the code, and how many the nearest tests find",
    "speed": "a fleet's first night beside just reading its logs",
    "watch": "false alarms, delays, names and sizes, beside simpler methods",
}


def main(arguments: list[str]) -> int:
    """Run the named benchmark, or all."""
    name, options = (arguments or [""])[0], arguments[1:]
    if name not in (*BENCHMARKS, "all"):
        lines = [f"{known:12} {title}\n" for known, title in BENCHMARKS.items()]
        sys.stdout.writelines(["python -m benchmarks NAME [OPTIONS] | all\n\n", *lines])
        return 2 if name else 0
    names = [known for known in BENCHMARKS if known != "guard"] if name == "all" else [name]
    ended = [importlib.import_module(f"benchmarks.{name}").main(options) for name in names]
    return next(filter(None, ended), 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
