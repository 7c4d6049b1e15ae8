"""Faults planted in the code, and how many the nearest tests find.

A seeded sample of small faults (an operator, a comparison, a number, a loop that does not run), as
many in each area, by cosmic-ray's operators. Each is planted in a copy of the project, and the
tests of its area run until one fails. What survives is listed with its reason, by hand, from
`benchmarks/mutation.toml`.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from queue import SimpleQueue

import numpy as np
from cosmic_ray.ast import ast_nodes, get_ast_from_path
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

from benchmarks.results_file import Part, description, store, stored, write_parts

NAME, TITLE = "mutation", "Faults that tests find"
ROOT = Path(__file__).parents[1]
REASONS = Path(__file__).with_suffix(".toml")
SEED, FAULTS, LIMIT_S = 2026, 300, 600
# Modules of an area, and the tests nearest to them.
AREAS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "physics": (("leakage/physics/*.py",), ("leakage/physics",)),
    "estimation": (("leakage/estimation/*.py",), ("leakage/estimation", "pipeline/night")),
    "watch": (("leakage/watch/*.py",), ("leakage/watch", "pipeline/trends")),
    "times": (
        ("pipeline/ingest/*time*.py", "pipeline/ingest/wall_clock.py", "pipeline/night/time_*.py"),
        ("pipeline/ingest", "pipeline/night"),
    ),
    "units": (("pipeline/units.py",), ("pipeline/test_units.py", "pipeline/ingest")),
    "hashes": (("pipeline/config/hashes.py",), ("pipeline/config", "pipeline/run")),
    "publishing": (("pipeline/store/publish*.py",), ("pipeline/store", "pipeline/faults")),
}
# `X | None` of annotations is no code, a cache that is left out no fault; `NoOp` changes nothing.
LEFT_OUT = ("BitOr", "RemoveDecorator", "NoOp", "Variable")


@dataclass(frozen=True)
class Fault:
    """One change of a module's text, and whether a test found it."""

    area: str
    module: str
    line: int
    before: str
    after: str
    found: bool = False

    @property
    def key(self) -> str:
        return f"{self.module}: {self.before} -> {self.after}"


def main(options: Sequence[str] = ()) -> None:
    """Plant the faults, run the tests, and write `benchmarks/results/mutation.md`."""
    parser = argparse.ArgumentParser(prog=f"python -m benchmarks {NAME}")
    parser.add_argument("--only", choices=AREAS, action="append", help="areas; all without it")
    parser.add_argument("--faults", type=int, default=FAULTS, help="in all areas together")
    parser.add_argument("--jobs", type=int, default=2)
    asked = parser.parse_args(list(options))
    with tempfile.TemporaryDirectory() as scratch:
        copies: SimpleQueue[Path] = SimpleQueue()
        for number in range(asked.jobs):
            copies.put(_copy(Path(scratch) / str(number)))
        for area in asked.only or AREAS:
            planted = _sample(area, asked.faults // len(AREAS))
            with ThreadPoolExecutor(asked.jobs) as pool:
                done = [pool.submit(_tried, *one, copies) for one in planted]
                store(NAME, area, [asdict(one.result()) for one in done])
    found = {area: [Fault(**one) for one in faults] for area, faults in stored(NAME).items()}
    write_parts(NAME, TITLE, description(__doc__), list(_parts(found)))


def _copy(folder: Path) -> Path:
    """The project's own files in another folder, and the data beside it that tests look for."""
    listed = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.splitlines()
    for name in listed:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, folder / name, follow_symlinks=False)
    return folder


def _sample(area: str, count: int) -> list[tuple[Fault, str]]:
    """Faults of an area, each with its module's text."""
    modules = sorted(path for pattern in AREAS[area][0] for path in ROOT.glob(pattern))
    places = [(module, *place) for module in modules for place in _places(module)]
    rng = np.random.default_rng([SEED, sorted(AREAS).index(area)])
    chosen = rng.permutation(len(places))
    faults: list[tuple[Fault, str]] = []
    for number in chosen:
        module, operator, occurrence = places[number]
        text = module.read_text("utf-8")
        after = mutate_code(text, get_operator(operator)(), occurrence)
        if after is None or after == text:
            continue
        pairs = enumerate(zip(text.splitlines(), after.splitlines(), strict=False), start=1)
        line, (old, new) = next(one for one in pairs if one[1][0] != one[1][1])
        name = module.relative_to(ROOT).as_posix()
        faults.append((Fault(area, name, line, old.strip(), new.strip()), after))
        if len(faults) == count:
            break
    return faults


def _places(module: Path) -> Iterator[tuple[str, int]]:
    """Operators that can change something in a module, each with the number of the place."""
    tree = get_ast_from_path(module)
    for name in operator_names():
        if any(part in name for part in LEFT_OUT) or get_operator(name).arguments():
            continue
        operator = get_operator(name)()
        count = sum(len(list(operator.mutation_positions(node))) for node in ast_nodes(tree))
        yield from ((name, occurrence) for occurrence in range(count))


def _tried(fault: Fault, text: str, copies: SimpleQueue[Path]) -> Fault:
    """The fault, planted in a copy that is free, and whether the tests found it."""
    folder = copies.get()
    path = folder / fault.module
    path.write_text(text, "utf-8")
    # The examples of its own docstrings first.
    tests = [fault.module, *(f"tests/{place}" for place in AREAS[fault.area][1])]
    call = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-m", "not full", *tests]
    try:
        done = subprocess.run(call, cwd=folder, capture_output=True, timeout=LIMIT_S, check=False)
        found = done.returncode != 0
    except subprocess.TimeoutExpired:
        found = True
    finally:
        shutil.copy2(ROOT / fault.module, path)
        copies.put(folder)
    sys.stderr.write(f"{'found' if found else 'SURVIVES'} {fault.key}\n")
    return Fault(**asdict(fault) | {"found": found})


def _parts(found: dict[str, list[Fault]]) -> Iterator[Part]:
    rows = [(area, str(len(of)), _share(of)) for area, of in found.items()]
    together = [fault for of in found.values() for fault in of]
    rows.append(("all", str(len(together)), _share(together)))
    yield Part("Found", "By area.", "area | faults | found", rows)
    reasons = tomllib.loads(REASONS.read_text("utf-8")) if REASONS.exists() else {}
    survivors = [
        (f"{one.module}:{one.line}", f"`{one.before}`", f"`{one.after}`", reasons.get(one.key, ""))
        for one in together
        if not one.found
    ]
    yield Part("Not found", "With the reason.", "place | before | after | reason", survivors)


def _share(faults: Sequence[Fault]) -> str:
    return f"{100.0 * np.mean([fault.found for fault in faults]):.0f} %"
