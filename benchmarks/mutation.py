"""Faults planted in the code, and how many the nearest tests find.

A sample of small faults (an operator, a comparison, a number, a loop that does not run) by
cosmic-ray's operators, as many in each area: at most one at a place of the text, chosen by a hash
of its function and operator, so that a change elsewhere leaves the sample as it is. Each is planted
in a copy of the project, and the tests nearest to its module run until any fails or their time is
up. What survives is listed with its reason, by hand, from `benchmarks/mutation.toml`, which names
the function, the operator, and which of the operator's places in that function it is.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import hashlib
import json
import multiprocessing
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names
from hypothesis import Phase, settings

from benchmarks import RESULTS, made
from validation.tables import Row, Table, show

ROOT, REASONS = Path(__file__).parents[1], Path(__file__).with_suffix(".toml")
FOUND = RESULTS / "mutation.json"
FAULTS, PROCESSOR_S, LIMIT_S = 43, 120, 1200
# Modules of an area, and its tests: files, the first place, and what imports from them of others.
AREAS = {
    "physics": ("leakage/physics/*.py", "leakage/physics leakage/estimation"),
    "estimation": ("leakage/estimation/*.py", "leakage/estimation pipeline/night"),
    "watch": ("leakage/watch/*.py", "leakage/watch"),
    "times": (
        "pipeline/ingest/time_stamps.py pipeline/night/time_*.py",
        "pipeline/ingest/test_time_stamps.py pipeline/ingest pipeline/night",
    ),
    "units": ("pipeline/units.py", "pipeline/test_units.py pipeline/config pipeline/ingest"),
    "hashes": (
        "pipeline/config/hashes.py",
        "pipeline/config/test_hashes.py pipeline/config pipeline/run",
    ),
    "publishing": (
        "pipeline/store/publish*.py",
        "pipeline/store/test_tables.py pipeline/store pipeline/faults",
    ),
}
# Has arguments, changes nothing, or no code could be so: `1.5 << 2`, `x < y` as `x is y`.
LEFT_OUT = re.compile(
    "Variable|RemoveDecorator|NoOp|[qtE]_Is|Is_(?!IsNot)|IsNot_(?!Is$)|(UAdd|USub)_(Invert|Not)"
    "|Invert_|(Add|Sub|Mul|Div|Mod|Pow)_(.Shift|Bit)|Shift_(?!.Shift)|Bit[A-Za-z]+_(?!Bit)"
)


class Fault(NamedTuple):
    """A fault: where it is planted, and the module's text with it."""

    key: str  # Module, function, operator, and which of its places in the function.
    module: str
    line: int
    change: str  # The line before and after.
    text: str


def main(options: Sequence[str] = ()) -> None:
    """Plant the faults, run the tests, and write `benchmarks/results/mutation.md`."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks mutation")
    parser.add_argument("--only", choices=AREAS, action="append", help="areas; all without it")
    parser.add_argument("--jobs", type=int, default=2)
    asked = parser.parse_args(list(options))
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    results: dict[str, Any] = json.loads(FOUND.read_text("utf-8"))
    fork = multiprocessing.get_context("forkserver")
    fork.set_forkserver_preload([__name__, "polars", "pyarrow.parquet", "pydantic", "scipy.stats"])
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(asked.jobs) as pool:
        copies = [_copy(Path(scratch) / str(number)) for number in range(asked.jobs)]

        def passes(folder: Path, tests: list[str]) -> bool:
            run = fork.Process(target=_run, args=(folder, tests))
            run.start()
            run.join()
            with contextlib.suppress(ProcessLookupError):
                os.killpg(run.pid or 0, signal.SIGKILL)
            return run.exitcode == 0

        def tried(fault: Fault) -> dict[str, Any]:
            folder = copies.pop()
            (folder / fault.module).write_text(fault.text, "utf-8")
            is_found = not passes(folder, _tests(fault.module, area))
            shutil.copy2(ROOT / fault.module, folder / fault.module)
            copies.append(folder)
            sys.stderr.write(f"{'found' if is_found else 'SURVIVES'} {fault.line} {fault.key}\n")
            return {"key": fault.key, "line": fault.line, "change": fault.change, "found": is_found}

        for area in asked.only or AREAS:
            planted = _sample(area)
            tests = {test for fault in planted for test in _tests(fault.module, area)}
            if not passes(copies[0], sorted(tests)):
                parser.exit(1, f"{area}: a test fails without a fault\n")
            results |= {area: list(pool.map(tried, planted))}
            lines = (f'"{of}": {json.dumps(r, ensure_ascii=False)}' for of, r in results.items())
            FOUND.write_text("{\n" + ",\n".join(lines) + "\n}\n", "utf-8")
    show([made(), *_tables(results)], RESULTS / "mutation.md")


def _copy(folder: Path) -> Path:
    """The project's own files, compiled, with their times: no fault runs another's code."""
    folder.mkdir()
    packed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True)
    names = packed.stdout.decode().rstrip("\0").split("\0")
    subprocess.run(["cp", "-P", "--parents", "-p", *names, folder], cwd=ROOT, check=True)
    subprocess.run([sys.executable, "-m", "compileall", "-q", folder], check=True)
    return folder


def _sample(area: str) -> list[Fault]:
    modules = [path for part in AREAS[area][0].split() for path in ROOT.glob(part)]
    places = sorted(place for module in modules for place in _places(module))
    faults: dict[tuple[str, int, int], Fault] = {}
    for _, key, name, line, column, operator, occurrence in places:
        if len(faults) < FAULTS and (name, line, column) not in faults:
            text = (ROOT / name).read_text("utf-8")
            after = mutate_code(text, get_operator(operator)(), occurrence) or text
            old, new = (lines.splitlines()[line - 1].strip() for lines in (text, after))
            with contextlib.suppress(SyntaxError):
                ast.parse(after if old != new else "no fault")
                faults[name, line, column] = Fault(key, name, line, f"{old} -> {new}", after)
    return list(faults.values())


def _places(module: Path) -> Iterator[tuple[str, str, str, int, int, str, int]]:
    """Where operators can change something in a module, each with its rank and its key."""
    text, name = module.read_text("utf-8"), module.relative_to(ROOT).as_posix()
    nodes, idle, functions = list(ast_nodes(get_ast(text))), list(_idle(text)), _functions(text)
    for operator in operator_names():
        if LEFT_OUT.search(operator) or get_operator(operator).arguments():
            continue
        places = [at for node in nodes for at in get_operator(operator)().mutation_positions(node)]
        seen = Counter[str]()
        for number, (start, _) in enumerate(places):
            # Functions stand in order of their first line: the last that holds the line is inmost.
            inside = [names for first, last, names in functions if first <= start[0] <= last]
            function = inside[-1] if inside else "module"
            seen[function] += 1
            if not any(first <= start < last for first, last in idle):
                change = operator.removeprefix("core/")
                key = f"{name}:{function}: {change} {seen[function]}"
                rank = hashlib.sha256(key.encode()).hexdigest()
                yield rank, key, name, *start, operator, number


def _functions(text: str) -> list[tuple[int, int, str]]:
    """First and last line and full name of each function and class of a module, in order."""
    spans: list[tuple[int, int, str]] = []

    def visit(node: ast.AST, prefix: str) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef | ast.ClassDef):
                full = f"{prefix}{child.name}"
                spans.append((child.lineno, child.end_lineno or child.lineno, full))
                visit(child, f"{full}.")

    visit(ast.parse(text), "")
    return sorted(spans)


def _idle(text: str) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Text that does nothing: annotations, decorators, `strict=True`."""
    for node in ast.walk(ast.parse(text)):
        parts = [getattr(node, "annotation", None), getattr(node, "returns", None)]
        parts += getattr(node, "decorator_list", [])
        parts += [node] if isinstance(node, ast.keyword) and node.arg == "strict" else []
        for part in filter(None, parts):
            yield (part.lineno, part.col_offset), (part.end_lineno, part.end_col_offset)


def _tests(module: str, area: str) -> list[str]:
    """The module's own examples, then the tests that import most of its things first."""
    tree = ast.parse((ROOT / module).read_text("utf-8"))
    names = {getattr(node, "name", module) for node in tree.body} | {Path(module).stem}
    worth: dict[str, tuple[int, int]] = {}
    places = AREAS[area][1].split()
    for place in places:
        path = ROOT / "tests" / place
        for file in path.rglob("test_*.py") if path.is_dir() else [path]:
            near = len(names & _imported(file))
            if near or file == path or place == places[0]:
                worth[str(file.relative_to(ROOT))] = -near, file.stat().st_size
    return [module, *sorted(worth, key=worth.__getitem__)]


@cache
def _imported(file: Path) -> set[str]:
    nodes = ast.walk(ast.parse(file.read_text("utf-8")))
    imports = [node for node in nodes if isinstance(node, ast.ImportFrom)]
    modules = {(node.module or "").rpartition(".")[2] for node in imports}
    return modules | {name.name for node in imports for name in node.names}


def _run(folder: Path, tests: list[str]) -> None:
    """Tests in a process of their own, which has all libraries but nothing of the project."""
    os.setsid()
    os.chdir(folder)
    sys.path[:] = [str(folder), *(place for place in sys.path if place not in {"", str(ROOT)})]
    os.environ |= {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    sys.dont_write_bytecode = True
    resource.setrlimit(resource.RLIMIT_CPU, (PROCESSOR_S, PROCESSOR_S))
    signal.alarm(LIMIT_S)
    for stream in (1, 2):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
    # The same examples each time, and none made smaller.
    settings.register_profile("same", derandomize=True, database=None, phases=[Phase.generate])
    settings.load_profile("same")
    quiet = ["-x", "-q", "--tb=no", "--assert=plain", "-p", "no:cacheprovider", "-n", "0"]
    # Most faults are found by the nearest files: only then are the others read.
    for part in (tests[:2], tests[2:5], tests[5:]):
        if part and pytest.main([*quiet, "-m", "not full", *part]) not in {0, 5}:
            os._exit(1)
    os._exit(0)


def _tables(results: dict[str, Any]) -> Iterator[Table]:
    every = [fault for faults in results.values() for fault in faults]
    rows: list[Row] = []
    for area, faults in (*results.items(), ("all", every)):
        n, n_found = len(faults), sum(fault["found"] for fault in faults)
        rows.append({
            "area": area, "faults": str(n), "found": str(n_found), "share": f"{n_found / n:.0%}"
        })  # fmt: skip
    yield Table("found by area", rows)
    reasons = tomllib.loads(REASONS.read_text("utf-8"))
    yield Table("not found, with the reason", [
        {
            "fault": f"`{fault['key']}`",
            "change": f"`{fault['change']}`".replace("|", "\\|"),
            "reason": reasons.get(fault["key"], ""),
        }
        for fault in every if not fault["found"]
    ])  # fmt: skip
