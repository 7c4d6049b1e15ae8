"""Names on top of the package."""

from __future__ import annotations

import pytest

import leakage


def test_names_on_top_are_few_and_there() -> None:
    assert len(leakage.__all__) < 20
    assert all(hasattr(leakage, name) for name in leakage.__all__)


def test_an_unknown_name_is_none() -> None:
    with pytest.raises(AttributeError, match="no attribute 'slip'"):
        _ = leakage.slip
