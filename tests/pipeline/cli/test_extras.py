"""Optional packages are needed only where they are used, and are named if they are missing."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.pipeline.calling import python

ROOT = Path(__file__).parents[3]
# In a process of its own: every module of the program without the extras, then what asks for them.
WITHOUT = """
import importlib, pkgutil, sys
from pathlib import Path
for name in ("dask", "distributed", "obstore"):
    sys.modules[name] = None
import pipeline
for module in pkgutil.walk_packages(pipeline.__path__, "pipeline."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
from pipeline.config import Execution
from pipeline.workers.engine import open_workers
from pipeline.errors import MotorLeakageError
from pipeline.store.object_store import ObjectStore


def dask():
    with open_workers(Execution(backend="dask", scheduler="tcp://127.0.0.1:1")):
        pass


for ask in (dask, lambda: ObjectStore.at("s3://b/x")):
    try:
        ask()
    except MotorLeakageError as error:
        print(error.code, error.message)
"""


def test_without_the_extras_all_modules_load_and_each_use_names_its_extra() -> None:
    told = [line.split(" ", 1) for line in python(WITHOUT).stdout.splitlines()]
    assert [code for code, _ in told] == ["dask_missing", "object_store_missing"]
    for (_, message), extra in zip(told, ("dask", "s3"), strict=True):
        assert f"motor-leakage[{extra}]" in message


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
    return sorted({one for group in groups for one in group if isinstance(one, str)})


def test_what_only_tests_and_docs_use_is_not_installed_to_run() -> None:
    text = (ROOT / "requirements" / "run.txt").read_text("utf-8")
    names = {line.partition("==")[0] for line in text.splitlines() if line[0].isalpha()}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    groups = [project["dependency-groups"][name] for name in ("dev", "full")]
    others = {Requirement(one).name for group in groups for one in group if isinstance(one, str)}
    # Needed by packages that the program needs.
    assert others & names == {"packaging"}


@pytest.mark.parametrize("text", stated())
def test_what_is_stated_is_pinned_within_its_range(text: str) -> None:
    asked = Requirement(text)
    version = pinned()[canonicalize_name(asked.name)]
    assert asked.specifier.contains(version), f"{version} is pinned"
