"""Round trip of data through pages: it comes out unchanged, and nothing is added."""

from __future__ import annotations

import json
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.report.encoding import numbers, script_json, whole_numbers
from tests.pipeline.report.packed import unpacked


@given(st.lists(st.floats(-1e30, 1e30)))
def test_numbers_keep_seven_digits(values: list[float]) -> None:
    kept = unpacked(numbers(values))
    assert kept.dtype == np.float32
    np.testing.assert_allclose(kept, values, rtol=6e-8, atol=1.2e-38)


def test_what_no_chart_can_show_is_no_number() -> None:
    kept = unpacked(numbers([1.0, np.nan, np.inf, -np.inf, 1e300]))
    assert kept[0] == 1.0
    assert np.isnan(kept[1:]).all()
    with pytest.raises(ValueError, match="JSON"):
        script_json({"value": float("nan")})


@given(st.lists(st.integers(-(2**31), 2**31 - 1)))
def test_whole_numbers_are_exact(values: list[int]) -> None:
    assert unpacked(whole_numbers(values)).tolist() == values


class Scripts(HTMLParser):
    """Counts the elements of a page, as a browser would find them."""

    def __init__(self) -> None:
        super().__init__()
        self.started: list[str] = []

    def handle_starttag(self, tag: str, attrs: object) -> None:  # noqa: ARG002
        self.started.append(tag)


@given(
    st.text() | st.sampled_from(["</script><img src=x>", "<!--<script>", "]]>", "\u2028", "&lt;"])
)
def test_no_name_ends_the_script_it_stands_in(name: str) -> None:
    text = script_json({name: [name]})
    parser = Scripts()
    parser.feed(f"<script>{text}</script>")
    assert parser.started == ["script"]
    assert json.loads(text) == {name: [name]}
    assert not set(text) & set("<>&\u2028\u2029")
