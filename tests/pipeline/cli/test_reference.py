"""The generated pages agree with the code."""

from __future__ import annotations

import datetime as dt
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from pipeline.config import load_fleet
from pipeline.config.section import Section
from tests.reference_pages import FILES, PAGES, main

ROOT = Path(__file__).resolve().parents[3]
DOCS = ROOT / "docs"


def keys() -> dict[str, str]:
    """Keys on the page of the config files, those of a table with its name, and what they are."""
    found, prefix = {}, ""
    for line in PAGES["config.md"]().splitlines():
        if line.startswith("#"):
            table = re.search(r"`\[+([\w.<>]+)\]", line)
            prefix = f"{table[1]}." if table else ""
        elif key := re.match(r"- `([\w.]+)` \((.*?)\): ", line):
            found[prefix + key[1]] = key[2]
    return found


def test_pages_of_the_docs_are_those_of_the_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main([str(tmp_path)])
    for folder in (tmp_path, DOCS):
        main(["--check", str(folder)])
    (tmp_path / "config.md").unlink()
    with (tmp_path / "tables.md").open("a") as page:
        page.write("\n")
    with pytest.raises(SystemExit) as stopped:
        main(["--check", str(tmp_path)])
    assert stopped.value.code == 1
    stale = f"{tmp_path}/config.md, {tmp_path}/tables.md: out of date; run `make docs`\n"
    assert capsys.readouterr().err == stale
    assert [path.name for path in tmp_path.iterdir()] == ["tables.md"]


def test_every_key_of_every_model_is_on_the_page() -> None:
    page = PAGES["config.md"]()
    listed = {part for key in keys() for part in key.split(".")}
    listed |= set(re.findall(r"`\[+(\w+)", page)) | {"law", "value", "minimum", "maximum", "fixed"}
    shipped = (section for section in _below(Section) if section.__module__.startswith("pipeline."))
    stated = {key for model in (*FILES.values(), *shipped) for key in model.model_fields}
    assert stated - listed == set()


def _below(model: type[Section]) -> Iterator[type[Section]]:
    for child in model.__subclasses__():
        yield child
        yield from _below(child)


def test_the_example_is_a_fleet() -> None:
    fleet = load_fleet(DOCS / "example" / "fleet.toml")
    (motor,) = fleet.motors
    assert {path.law for path in motor.motor_type.path} == {"annular_gap", "speed_curve", "laminar"}
    assert motor.settings.cleaning.guard_after_s == 60.0
    assert motor.file.oil_on(dt.date(2026, 8, 31)) == "vg68"
    assert motor.file.oil_on(dt.date(2026, 9, 1)) == "vg46"
    assert motor.file.logs.separator == ";"
