"""The HTML of the pages, from templates that escape whatever is put into them."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from pipeline.messages import as_sentence, plain
from pipeline.report.words import (
    ABSENT,
    STATES,
    candidates,
    conditions,
    figure,
    name_of,
    of_model,
)
from pipeline.trends.sentences import change_of

FOLDER = Path(__file__).parent


def page_of(template: str, **values: Any) -> str:
    """A page; `values` are what its template names."""
    return _environment().get_template(template).render(**values)


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(FOLDER / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "candidates": candidates,
        "change": change_of,
        "figure": figure,
        "indicator": name_of,
        "of_model": of_model,
        "plain": plain,
        "sentence": as_sentence,
    }
    environment.globals |= {
        "absent": ABSENT,
        "conditions": conditions,
        "states": STATES,
    }
    return environment
