"""Run benchmarks by name or `all`; without a name, list them. One alone may have options."""

from __future__ import annotations

import ast
import importlib
import sys
from inspect import signature
from itertools import dropwhile
from pathlib import Path

BENCHMARKS = (
    "coverage",
    "dates",
    "demo_alarms",
    "fuzz",
    "guard",
    "model_choices",
    "night_cost",
    "noise",
    "notebook",
    "notebook_rivals",
    "residual_tests",
    "scale",
    "speed",
    "watch",
    "wide_plant",
)


def main(arguments: list[str]) -> int:
    """Run the named benchmarks, one after the other; what follows a dash is for the only one."""
    options = list(dropwhile(lambda text: not text.startswith("-"), arguments))
    names = arguments[: len(arguments) - len(options)]
    strangers = sorted(set(names) - {*BENCHMARKS, "all"})
    if strangers:
        sys.stderr.write(f"no benchmark {', '.join(strangers)}\n\n{_usage()}")
        return 2
    if not names:
        sys.stdout.write(_usage())
        return 0
    # What compares with results that are there does not make them, and a record is to be named.
    if names == ["all"]:
        names = [name for name in BENCHMARKS if name not in ("guard", "noise")]
    mains = [importlib.import_module(f"benchmarks.{name}").main for name in names]
    if options and (len(mains) > 1 or "options" not in signature(mains[0]).parameters):
        sys.stderr.write(f"options are for one benchmark that has any, not {', '.join(names)}\n")
        return 2
    return next(filter(None, (main(options) if options else main() for main in mains)), 0)


def _usage() -> str:
    """The call, and a line for each benchmark."""
    lines = ["python -m benchmarks NAME ... | all | NAME OPTIONS", ""]
    for name in BENCHMARKS:
        file = Path(__file__).with_name(name)
        file = file / "__init__.py" if file.is_dir() else file.with_suffix(".py")
        source = file.read_text("utf-8")
        title = (ast.get_docstring(ast.parse(source)) or "").partition("\n")[0]
        lines.append(f"{name:16} {title}")
    return "\n".join([*lines, ""])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
