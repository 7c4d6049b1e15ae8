"""Channels that `init` has right, wrong and asks for, by styles of header."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from pipeline.setup.propose import propose
from tests.pipeline.setup.header_styles import BLIND, STYLES, Style
from tests.pipeline.setup.plants.plant import CHANNELS, ROWS, stamp, value
from tests.pipeline.setup.text_logs import in_unit

LEAST_RIGHT = 0.8


def written(style: Style, folder: Path) -> Path:
    """A log of a motor at work, with a style's header."""
    lines = [style.separator.join([style.time, *style.columns]), *filter(None, [style.units])]
    for row in range(ROWS):
        cells = [stamp(row, style.form)]
        for at, meant in enumerate(style.columns.values()):
            kind, _, unit = meant.partition(" ")
            made = {"?": "low" if at else "high", "x": "other"}.get(kind, kind)
            number = in_unit(value(made, 1, row), unit.strip("-"))
            cells.append(f"{number:.3f}".replace(".", style.decimal))
        lines.append(style.separator.join(cells))
    path = folder / "log.csv"
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return path


def score(style: Style, folder: Path) -> Counter[str]:
    """Channels that are right, wrong and asked; a question is right where the log says nothing."""
    found = {
        place.column.keys["source"]: (channel, place.unit)
        for motor in propose(written(style, folder), {}).motors
        for channel, place in motor.channels.items()
    }
    counts: Counter[str] = Counter()
    for name, meant in style.columns.items():
        kind, _, unit = meant.partition(" ")
        got, right = found.get(name), (CHANNELS.get(kind), None if unit == "-" else unit)
        if kind in "?x":
            counts["wrong"] += got is not None
        elif got == right:
            counts["right"] += 1
        else:
            counts["asked" if got is None or got == (right[0], None) else "wrong"] += 1
    return counts


@pytest.mark.parametrize(
    "styles",
    [
        [one for one in STYLES if not one.is_held_out],
        [one for one in STYLES if one.is_held_out],
        BLIND,
    ],
    ids=["known", "held out", "blind"],
)
def test_most_channels_are_right_at_first_sight_and_none_is_wrong(
    tmp_path: Path, styles: list[Style]
) -> None:
    total = sum((score(one, tmp_path) for one in styles), Counter[str]())
    assert total["wrong"] == 0
    assert total["right"] >= LEAST_RIGHT * total.total()
