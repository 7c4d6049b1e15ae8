"""Figures of a motor type as files, the choice of type and oil, and the command."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import matplotlib as mpl
import pytest

from leakage import Constant, Motor, Parameter
from pipeline.config import load_fleet
from pipeline.config.motor_types import OilFile
from pipeline.config.settings import Settings
from pipeline.demo import shipped_configs
from pipeline.model_figures import (
    ModelSubject,
    choose,
    model_figures,
    subject_of,
    write_model_figures,
)
from pipeline.model_figures.canvas import ImageFormat, drawing, save
from tests.pipeline.calling import Call, python, refused
from tests.pipeline.model_figures.conftest import (
    DISTRIBUTOR,
    FIGURES,
    RING,
    ROLLER,
    type_with,
    words,
)


# A map with contours and a stack with hatches: what an SVG numbers at random.
@pytest.mark.parametrize(
    ("name", "image_format"),
    [("shares", "png"), ("shares", "svg"), ("piston_ring_leakage", "svg")],
)
def test_same_bytes_whatever_a_user_prefers(
    cb560: ModelSubject, tmp_path: Path, name: str, image_format: ImageFormat
) -> None:
    contents = []
    for size in (9.0, 20.0):
        with mpl.rc_context({"font.size": size, "lines.linewidth": size}), drawing():
            save(model_figures(cb560)[name](), tmp_path / "figure", image_format)
        contents.append((tmp_path / "figure").read_bytes())
    assert contents[0] == contents[1]
    assert contents[0].startswith(b"\x89PNG" if image_format == "png" else b"<?xml")
    assert b"<dc:date>" not in contents[0]
    assert b"Matplotlib v" not in contents[0]


def test_names_from_files_are_text_and_nothing_else(oil: OilFile, tmp_path: Path) -> None:
    hostile = "$\\frac{ <script>alert(1)</script> & 漢字\n" + "x" * 200
    motor_type = type_with({**DISTRIBUTOR, "source": "placeholder"})
    subject = subject_of(motor_type, oil.model_copy(update={"name": hostile}), Settings())
    for path in write_model_figures(subject, tmp_path, "svg"):
        root = ElementTree.parse(path).getroot()  # noqa: S314
        assert root.tag.endswith("svg")
        assert not any(one.tag.endswith("script") for one in root.iter())


@pytest.mark.parametrize(
    ("path", "figures"),
    [
        (DISTRIBUTOR, ["distributor_leakage", "viscosity", "shares"]),
        (
            {**ROLLER, "coefficients": (0.0,), "speed_range_rpm": (0.0, 50.0)},
            ["roller_speed_curve", "viscosity", "shares"],
        ),
        (RING, ["ring_leakage", "viscosity", "shares", "films"]),
    ],
    ids=["laminar", "speed curve that is 0", "gap"],
)
def test_other_motors_have_the_figures_of_their_paths(
    oil: OilFile, path: dict[str, object], figures: list[str]
) -> None:
    found = model_figures(subject_of(type_with(path), oil, Settings()))
    assert list(found) == figures
    for draw in found.values():
        assert "X1" in words(draw())


def test_motor_of_a_flushing_alone(cb560: ModelSubject, tmp_path: Path) -> None:
    flushing = Constant("flushing", Parameter("C_f", "l_per_min", 2.0, 0.0, 20.0))
    subject = replace(cb560, motor=Motor("X1", (flushing,), cb560.motor.oil))
    (tmp_path / "mine.txt").write_text("stays")
    (tmp_path / "X1_shares.png").write_text("is replaced")
    written = write_model_figures(subject, tmp_path)
    assert [path.name for path in written] == ["X1_viscosity.png", "X1_shares.png"]
    assert {path.name for path in tmp_path.iterdir()} == {"mine.txt", *(p.name for p in written)}
    assert written[1].read_bytes().startswith(b"\x89PNG")


def test_oil_that_the_equation_does_not_hold_for(oil: OilFile, tmp_path: Path) -> None:
    thin = oil.model_copy(update={"reference_viscosities_mm2_per_s": (0.5, 0.25)})
    settings = Settings.model_validate({"reference": {"temperature_c": 149.0}})
    with refused("model_range", "X1_distributor_leakage.png"):
        write_model_figures(subject_of(type_with(DISTRIBUTOR), thin, settings), tmp_path)


def test_oil_is_that_of_the_first_motor_of_the_type() -> None:
    fleet = load_fleet(shipped_configs() / "fleet.toml")
    first = min(
        (spec for spec in fleet.motors if spec.motor_type.motor_type == "CB400"),
        key=lambda spec: spec.motor_id,
    )
    assert choose(fleet, "CB400").oil_name == fleet.oils[first.file.oil].name
    assert choose(fleet, "CB400", "vg32").oil_name == fleet.oils["vg32"].name


@pytest.mark.parametrize(
    ("motor_type", "oil_name", "code", "message"),
    [
        ("CB561", None, "unknown_type", "'CB561'; there are CB1120, CB400, CB560"),
        ("../CB560", None, "unknown_type", "there are"),
        ("CB560", "vg99", "unknown_oil", "no oil 'vg99'; name one with --oil: vg32, vg46, vg68"),
    ],
)
def test_what_there_is_not(motor_type: str, oil_name: str | None, code: str, message: str) -> None:
    with refused(code, message):
        choose(load_fleet(shipped_configs() / "fleet.toml"), motor_type, oil_name)


def test_type_that_no_motor_has_needs_its_oil_named() -> None:
    fleet = load_fleet(shipped_configs() / "fleet.toml")
    others = tuple(one for one in fleet.motors if one.motor_type.motor_type != "CB560")
    fleet = replace(fleet, motors=others)
    with refused("unknown_oil"):
        choose(fleet, "CB560")
    assert choose(fleet, "CB560", "vg46").motor.motor_type == "CB560"


def test_command_lists_what_it_wrote(tmp_path: Path) -> None:
    program = (
        "import sys; from pipeline.cli import main; before = 'matplotlib' in sys.modules\n"
        "try: main()\n"
        "finally: print(before, 'matplotlib.pyplot' in sys.modules, file=sys.stderr)"
    )
    done = python(program, "model", "--type", "CB560", cwd=tmp_path)
    written = [tmp_path / name for name in done.stdout.splitlines()]
    assert [path.name for path in written] == [f"CB560_{name}.png" for name in FIGURES]
    assert sorted((tmp_path / "out" / "figures").iterdir()) == sorted(written)
    # Neither waits for matplotlib where it is not needed, nor has its global state.
    assert done.stderr.split() == ["False", "False"]


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--type", "CB561"], 2, "motor-leakage: unknown_type: no motor type 'CB561'"),
        (["--type", "CB560", "--output", "file"], 4, "store_write: CB560_piston_ring_leakage.png"),
        (["--type", "CB560", "--config", "none.toml"], 2, "none.toml: cannot be read"),
        (["--type", "CB560", "--format", "pdf"], 2, "pdf"),
        ([], 2, "--type"),
    ],
)
def test_command_with_bad_input(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    call: Call,
    arguments: list[str],
    code: int,
    message: str,
) -> None:
    (tmp_path / "file").write_text("stays")
    monkeypatch.chdir(tmp_path)
    found, out, err = call("model", *arguments)
    assert (found, out) == (code, "")
    assert message in err
    assert (tmp_path / "file").read_text() == "stays"
