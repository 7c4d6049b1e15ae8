"""The notebooks of the docs run from top to bottom on the demo fleet, and hold no output."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest

from leakage.frame_result import FrameFit

NOTEBOOKS = Path(__file__).parent.parent / "docs" / "notebooks"


@pytest.fixture
def demo(
    tmp_path: Path, demo_folder: Path, fitted_output: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("configs", "demo"):
        (tmp_path / name).symlink_to(demo_folder / name)
    (tmp_path / "out").symlink_to(fitted_output)
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("demo")
@pytest.mark.parametrize("name", ["one_motor", "fleet_year"])
def test_a_notebook_runs(name: str) -> None:
    mpl.use("agg")
    document = json.loads((NOTEBOOKS / f"{name}.ipynb").read_text("utf-8"))
    cells = [cell for cell in document["cells"] if cell["cell_type"] == "code"]
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in cells)
    names: dict[str, Any] = {}
    for cell in cells:
        exec(compile("".join(cell["source"]), name, "exec"), names)  # noqa: S102
    found = names["found"]
    assert isinstance(found, FrameFit)
    assert "identified" in {judged.verdict for judged in found.judgements.values()}
    assert plt.get_fignums()
    plt.close("all")
