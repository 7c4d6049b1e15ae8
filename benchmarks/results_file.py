"""Where and how benchmarks leave their figures."""

from __future__ import annotations

import platform
import sys
from collections.abc import Sequence
from pathlib import Path

RESULTS = Path(__file__).parent / "results"


def write_results(
    name: str, title: str, header: Sequence[str], rows: Sequence[Sequence[str]]
) -> None:
    """Write one Markdown table to `benchmarks/results/`, and print it."""
    lines = [
        f"# {title}",
        "",
        f"Python {platform.python_version()}, {platform.machine()}, made by "
        f"`python -m benchmarks {name}`.",
        "",
        "| " + " | ".join(header) + " |",
        "|" + "---|" * len(header),
        *("| " + " | ".join(row) + " |" for row in rows),
        "",
    ]
    RESULTS.mkdir(exist_ok=True)
    text = "\n".join(lines)
    (RESULTS / f"{name}.md").write_text(text, "utf-8")
    sys.stdout.write(text)
