"""One Dask cluster for all tests of a process: its start costs more than most of them."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.pipeline.dask_processes import Processes, scheduler_with


@pytest.fixture(scope="session")
def _cluster() -> Iterator[Processes]:
    with scheduler_with(2) as processes:
        yield processes


@pytest.fixture
def two_workers(_cluster: Processes) -> Processes:
    """Two workers; their nannies start them again where a test before has killed one."""
    _cluster.wait_for(2)
    return _cluster
