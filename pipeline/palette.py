"""Colours of the leakage paths, the same on the pages and in the figures of a motor type."""

from __future__ import annotations

from collections.abc import Iterable

# Of Okabe and Ito, "Color universal design", 2008: distinguished with any kind of colour vision, on
# white and on black paper.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#999999")
# Paths of the thesis's motors have the first places; others follow by name.
FIRST = ("piston_ring", "balance_piston", "balance_sleeve", "cam_roller")


def path_places(names: Iterable[str]) -> dict[str, int]:
    """Place of each path of a motor among the colours; line styles and marks go by it, too.

    Examples
    --------
    >>> path_places(["shaft_seal", "cam_roller"])
    {'cam_roller': 3, 'shaft_seal': 4}
    """
    paths = set(names)
    order = (*FIRST, *sorted(paths.difference(FIRST)))
    return {name: place for place, name in enumerate(order) if name in paths}
