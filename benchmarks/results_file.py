"""Where and how benchmarks leave their figures."""

from __future__ import annotations

import argparse
import datetime as dt
import json
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parent / "results"


@dataclass(frozen=True, slots=True)
class Part:
    """A section of a results file: what was measured, in words and in one table."""

    heading: str
    text: str
    header: str  # names of the columns, with " | " between them
    rows: Sequence[Sequence[str]]


def write_results(name: str, title: str, header: str, rows: Sequence[Sequence[str]]) -> None:
    """Write one Markdown table to `benchmarks/results/`, and print it."""
    _write(name, title, table(header, rows))


def write_parts(name: str, title: str, text: str, parts: Sequence[Part]) -> None:
    """Write several Markdown tables with their words to one file, and print them."""
    _write(name, title, [text, "", *_sections(parts)])


def show_parts(parts: Sequence[Part]) -> None:
    """Print several Markdown tables with their words."""
    sys.stdout.write("\n".join(_sections(parts)))


def write_stored(
    name: str,
    title: str,
    text: str,
    makers: Mapping[str, Callable[[], Part]],
    options: Sequence[str],
) -> None:
    """Measure all parts or some (`--only A,B`); the others are as they were stored."""
    parser = argparse.ArgumentParser(prog=f"python -m benchmarks {name}")
    parser.add_argument("--only", default=",".join(makers), help=f"of {', '.join(makers)}")
    asked = parser.parse_args(list(options)).only.split(",")
    if strangers := sorted(set(asked) - set(makers)):
        parser.error(f"no part {', '.join(strangers)}; there are {', '.join(makers)}")
    for one in asked:
        begin = time.perf_counter()
        sys.stderr.write(f"{one}: begins, load {os.getloadavg()[0]:.1f}\n")
        store(name, one, asdict(makers[one]()))
        sys.stderr.write(f"{one}: {time.perf_counter() - begin:.0f} s\n")
    found = stored(name)
    write_parts(name, title, text, [Part(**found[one]) for one in makers if one in found])


def in_folder(make: Callable[[Path], Part]) -> Part:
    """A part made in a folder of its own, with the load of the machine before it began."""
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        part = make(Path(folder))
    return replace(part, text=f"{part.text} Load before it began: {load:.1f}.")


def stored(name: str) -> dict[str, Any]:
    """All that runs of a benchmark have found so far, by part."""
    file = RESULTS / f"{name}.json"
    found: dict[str, Any] = json.loads(file.read_text("utf-8")) if file.exists() else {}
    return found


def store(name: str, part: str, found: object) -> None:
    """Keep what was found of a part beside the others, a part a line."""
    parts = (stored(name) | {part: found}).items()
    lines = (f'"{one}": {json.dumps(of, ensure_ascii=False)}' for one, of in parts)
    (RESULTS / f"{name}.json").write_text("{\n" + ",\n".join(lines) + "\n}\n", "utf-8")


def description(doc: str | None) -> str:
    """A benchmark's docstring without its first line, which is the title."""
    return (doc or "").split("\n\n", 1)[1].strip()


def _sections(parts: Sequence[Part]) -> list[str]:
    lines = []
    for part in parts:
        lines += [f"## {part.heading}", "", part.text, "", *table(part.header, part.rows)]
    return lines


def table(header: str, rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table."""
    line = "|" + "---|" * len(header.split(" | "))
    return [f"| {header} |", line, *(f"| {' | '.join(row)} |" for row in rows), ""]


def _write(name: str, title: str, body: Sequence[str]) -> None:
    lines = [
        f"# {title}",
        "",
        f"Python {platform.python_version()}, {platform.machine()}, made by "
        f"`python -m benchmarks {name}` on {dt.datetime.now(dt.UTC):%Y-%m-%d %H:%M} UTC.",
        "",
        *body,
    ]
    RESULTS.mkdir(exist_ok=True)
    text = "\n".join(lines)
    (RESULTS / f"{name}.md").write_text(text, "utf-8")
    sys.stdout.write(text)
