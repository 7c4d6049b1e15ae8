"""The score of `init` on each plant: channels mapped right, wrong and asked."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from tests.pipeline.setup.plants.control_systems import CONTROL_SYSTEMS
from tests.pipeline.setup.plants.plant import Plant
from tests.pipeline.setup.plants.score import score_of
from tests.pipeline.setup.plants.tables import TABLES
from tests.pipeline.setup.plants.unseen import UNSEEN

KINDS = ("right", "asked", "wrong")


def main() -> None:
    for name, plants in (("Plants", (*CONTROL_SYSTEMS, *TABLES)), ("Unseen plants", UNSEEN)):
        print(f"\n| {name} | {' | '.join(KINDS)} |\n|---|---|---|---|")  # noqa: T201
        for line in _lines(plants):
            print(line)  # noqa: T201


def _lines(plants: Iterable[Plant]) -> Iterable[str]:
    total: Counter[str] = Counter()
    for plant in plants:
        with tempfile.TemporaryDirectory() as folder:
            counts = score_of(plant, Path(folder))
        total += counts
        yield f"| {plant.name} | {' | '.join(str(counts[kind]) for kind in KINDS)} |"
    yield f"| all | {' | '.join(str(total[kind]) for kind in KINDS)} |"


if __name__ == "__main__":
    main()
