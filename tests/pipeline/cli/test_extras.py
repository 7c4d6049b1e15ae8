"""Optional packages are needed only where they are used, and are named if they are missing."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from pipeline.config import Execution
from pipeline.store.object_store import ObjectStore
from pipeline.workers.engine import open_workers
from tests.pipeline.calling import refused

ROOT = Path(__file__).parents[3]
EXTRAS = ("dask", "distributed", "obstore")


def ask_for_dask() -> None:
    with open_workers(Execution(backend="tcp://127.0.0.1:1")):
        pass


@pytest.mark.parametrize(
    ("ask", "code", "extra"),
    [
        (ask_for_dask, "dask_missing", "dask"),
        (lambda: ObjectStore.at("s3://b/x"), "object_store_missing", "s3"),
    ],
)
def test_each_use_of_an_extra_that_is_missing_names_it(
    ask: Callable[[], object], code: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = [name for name in sys.modules if name.partition(".")[0] in EXTRAS]
    for name in (*EXTRAS, *loaded):
        monkeypatch.setitem(sys.modules, name, None)
    with refused(code, f"motor-leakage[{extra}]"):
        ask()


def imported_at_once(path: Path) -> Iterator[str]:
    """Packages that a module imports as soon as it is loaded."""
    todo: list[ast.AST] = [ast.parse(path.read_text("utf-8"))]
    while todo:
        node = todo.pop()
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield str(node.module).partition(".")[0]
        elif isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            todo += node.orelse
        elif not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            todo += ast.iter_child_nodes(node)


def test_every_module_loads_without_the_extras() -> None:
    paths = (ROOT / "pipeline").rglob("*.py")
    loaded = {path: {*imported_at_once(path)} for path in paths}
    assert "polars" in set().union(*loaded.values())
    assert [path for path, names in loaded.items() if names & {*EXTRAS}] == []


def pinned() -> dict[str, str]:
    """Versions that `requirements/` has, by package."""
    found = {}
    for path in (ROOT / "requirements").iterdir():
        for line in path.read_text("utf-8").splitlines():
            name, is_pin, rest = line.partition("==")
            if is_pin and not line.startswith(" "):
                version = rest.split()[0]
                # Two where one is of another version of Python.
                assert found.setdefault(canonicalize_name(name), version) == version or ";" in rest
    return found


def stated() -> list[str]:
    """Requirements in `pyproject.toml`, including extras and development."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    extras = project["project"]["optional-dependencies"].values()
    groups = [*extras, project["project"]["dependencies"], *project["dependency-groups"].values()]
    return sorted({needed for group in groups for needed in group if isinstance(needed, str)})


def test_what_only_tests_and_docs_use_is_not_installed_to_run() -> None:
    text = (ROOT / "requirements" / "run.txt").read_text("utf-8")
    names = {line.partition("==")[0] for line in text.splitlines() if line[0].isalpha()}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    groups = [project["dependency-groups"][name] for name in ("dev", "docs", "full")]
    others = {Requirement(name).name for group in groups for name in group if isinstance(name, str)}
    # Needed by packages that the program needs.
    assert others & names == {"packaging"}


@pytest.mark.parametrize("text", stated())
def test_what_is_stated_is_pinned_within_its_range(text: str) -> None:
    asked = Requirement(text)
    version = pinned()[canonicalize_name(asked.name)]
    assert asked.specifier.contains(version), f"{version} is pinned"


def test_templates_scripts_and_styles_are_in_the_wheel(tmp_path: Path) -> None:
    # In a copy: what a build leaves beside its sources is not for this folder.
    source = tmp_path / "source"
    source.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    for name in ("leakage", "pipeline", "configs"):
        shutil.copytree(ROOT / name, source / name, symlinks=True)
    code = "import sys; from setuptools.build_meta import build_wheel; build_wheel(sys.argv[1])"
    subprocess.run([sys.executable, "-c", code, tmp_path], cwd=source, check=True)
    (built,) = tmp_path.glob("*.whl")
    names = set(zipfile.ZipFile(built).namelist())
    folder = ROOT / "pipeline" / "report"
    shipped = [*(folder / "assets").iterdir(), *(folder / "templates").iterdir()]
    assert len(shipped) >= 9
    assert {str(path.relative_to(ROOT)) for path in shipped} <= names
