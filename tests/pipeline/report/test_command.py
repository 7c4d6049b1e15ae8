"""`motor-leakage report`: where it writes, what it says, and how it ends."""

from __future__ import annotations

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
MOTOR = "CB400-01"


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
