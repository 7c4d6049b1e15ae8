"""`motor-leakage report`: where it writes, what it says, and how it ends."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

from tests.conftest import OwnFleet
from tests.pipeline.calling import Call

ROOT = Path(__file__).resolve().parents[3]
MOTOR = "CB400-01"


def test_with_a_config_it_lies_in_the_output_and_bears_the_fleet_s_name(
    call: Call, own_fleet: OwnFleet
) -> None:
    fleet = own_fleet(MOTOR, fitted=True)
    motor_file = fleet.parent / "motors" / f"{MOTOR}.toml"
    event = '\n[[events]]\ndate = 2026-01-03\nkind = "overhaul"\nnote = "new <b>seals</b>"\n'
    motor_file.write_text(motor_file.read_text("utf-8") + event, "utf-8")
    code, out, err = call("report", fleet)
    index = fleet.parent.parent / "out" / "report" / "index.html"
    assert (code, err) == (0, "")
    assert re.fullmatch(
        r"1 motor, 3 nights updated, \d+ files written, 0 removed; open .*", out.strip()
    )
    assert out.strip().endswith(str(index))
    assert "<h1>Demo fleet</h1>" in index.read_text("utf-8")
    page = (index.parent / "motors" / f"{MOTOR}.html").read_text("utf-8")
    assert "overhaul: new &lt;b&gt;seals&lt;/b&gt;" in page
    # The fleet's page alone tells when it was made.
    assert call("report", fleet)[1].startswith("1 motor, 0 nights updated, 1 file written")


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
