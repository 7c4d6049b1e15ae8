"""Sums of the science as a run makes them."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from threadpoolctl import threadpool_limits


@pytest.fixture(autouse=True, scope="module")
def _one_thread() -> Iterator[None]:
    """As in a run; many small products would wait for one another."""
    with threadpool_limits(1):
        yield
