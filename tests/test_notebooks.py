"""The notebooks of the docs run from top to bottom on the demo fleet, and hold no output."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("nbclient", reason="nbclient is of requirements/docs.txt")

import nbformat

from tests.notebooks import DOCS, NAMES, executed, figures


def test_the_notebooks_run_and_their_pictures_are_in_the_docs(
    tmp_path: Path, demo_folder: Path, fitted_output: Path
) -> None:
    for name in ("configs", "demo"):
        (tmp_path / name).symlink_to(demo_folder / name)
    (tmp_path / "out").symlink_to(fitted_output)
    for name, notebook in executed(NAMES, tmp_path).items():
        stored = nbformat.read(DOCS / "notebooks" / f"{name}.ipynb", 4)
        code = [cell for cell in stored.cells if cell.cell_type == "code"]
        assert all(not cell.outputs and cell.execution_count is None for cell in code)
        drawn = [picture for picture, _ in figures(name, notebook)]
        assert drawn
        assert sorted(drawn) == sorted(path.name for path in DOCS.glob(f"pictures/{name}_*.png"))
        outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
        word = "placeholder" if name == "motor_type" else "identified"
        assert any(word in str(output.get("data", output)) for output in outputs)
