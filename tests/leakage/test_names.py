"""Names on top of the package, and those that were."""

from __future__ import annotations

import importlib

import pytest

import leakage


def test_names_on_top_are_few_and_there() -> None:
    assert len(leakage.__all__) < 20
    assert all(hasattr(leakage, name) for name in leakage.__all__)


@pytest.mark.parametrize("name", leakage._MOVED)
def test_a_moved_name_still_works_and_says_where_it_is(name: str) -> None:
    module = f"leakage.{leakage._MOVED[name]}"
    with pytest.warns(DeprecationWarning, match=rf"leakage\.{name} .* from {module}$"):
        found = getattr(leakage, name)
    assert found is getattr(importlib.import_module(module), name)


def test_an_unknown_name_is_none() -> None:
    with pytest.raises(AttributeError, match="no attribute 'slip'"):
        _ = leakage.slip
