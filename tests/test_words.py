"""Names say what they stand for: no name of the code is `one` or `told`."""

from __future__ import annotations

import tokenize
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
WORDS = {"one", "told"}


def test_names_say_what_they_stand_for() -> None:
    places = []
    for package in ("leakage", "pipeline"):
        for path in sorted((ROOT / package).rglob("*.py")):
            with path.open("rb") as file:
                places += [
                    f"{path.relative_to(ROOT)}:{token.start[0]}"
                    for token in tokenize.tokenize(file.readline)
                    if token.type == tokenize.NAME and token.string in WORDS
                ]
    assert places == []
