"""The same input, config and code give the same bytes: on one worker or two, in any process."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

import pytest

from tests.pipeline.calling import python
from tests.pipeline.faults.fleet import ENVIRONMENT, OF_RUNS, TinyFleet

RUN = """
import sys
from pathlib import Path
from tests.pipeline.faults.fleet import TinyFleet
folder, output, workers, backend = sys.argv[1:]
TinyFleet(Path(folder)).run(Path(output), workers=int(workers), backend=backend)
"""


def hashes(output: Path) -> dict[str, str]:
    """SHA-256 of every file of tables and state but those of the run itself."""
    return {
        path.relative_to(output).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for name in ("tables", "manifest")
        for path in sorted((output / name).rglob("*"))
        if path.is_file() and path.parent.parent.name not in OF_RUNS and "T" not in path.stem
    }


@pytest.mark.full
def test_two_runs_from_scratch_on_one_and_on_two_workers(
    tiny_fleet: TinyFleet, tmp_path: Path
) -> None:
    """Each a process of its own, with another order of sets."""
    found = []
    for workers, backend in ((1, "sequential"), (2, "loky")):
        output = tmp_path / str(workers)
        environment = ENVIRONMENT | {"PYTHONHASHSEED": str(workers)}
        python(RUN, tiny_fleet.folder, output, workers, backend, env=environment)
        found.append(hashes(output))
    assert len(found[0]) > 30
    assert found[0] == found[1]
    whole = hashlib.sha256(repr(sorted(found[0].items())).encode()).hexdigest()
    sys.stdout.write(f"{len(found[0])} files, on 1 and on 2 workers: {whole}\n")
