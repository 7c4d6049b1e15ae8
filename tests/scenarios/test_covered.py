"""No command and no option without a scenario that runs it and reads what it gives."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from pathlib import Path

from tests.scenarios.command import ROOT
from tests.scenarios.covering import DECLARED, Item, all_items

PAGES = [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "examples").rglob("*")]


def test_every_command_and_option_of_the_help_has_a_scenario() -> None:
    for path in Path(__file__).parent.glob("test_*.py"):
        importlib.import_module(f"tests.scenarios.{path.stem}")
    declared = {item for items in DECLARED.values() for item in items}
    assert declared == all_items()


def named_on_pages() -> Iterator[tuple[str, Item]]:
    """Commands and options in calls on pages and in examples."""
    for page in PAGES:
        if page.suffix not in (".md", ".service", ".yaml", ""):
            continue
        if not page.is_file():
            continue
        for command, rest in re.findall(
            r"motor-leakage ((?:baseline )?[a-z][a-z-]+)((?: [^\s`;&|>]+)*)",
            page.read_text("utf-8"),
        ):
            for option in re.findall(r" (--[a-z][a-z-]*)", rest):
                yield page.name, (command, option)


def test_pages_and_examples_name_options_that_there_are() -> None:
    named = list(named_on_pages())
    assert len(named) > 20
    known = all_items()
    assert [place for place in named if place[1] not in known] == []
