"""The HTML of the pages, from templates that escape whatever is put into them."""

from __future__ import annotations

import datetime as dt
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from leakage.validation import is_poor
from pipeline.report.encoding import script_json
from pipeline.report.fleet_page import FleetRow
from pipeline.report.history import MotorHistory
from pipeline.report.sparkline import HEIGHT, STRIP_HEIGHT, WIDTH
from pipeline.report.words import ABSENT, LEAKAGE_KINDS, STATES, STATUSES, figure, plain, signed
from pipeline.trends.motor_states import ORDER

FOLDER = Path(__file__).parent
ASSETS = tuple(sorted((FOLDER / "assets").iterdir()))


@dataclass(frozen=True, slots=True)
class FleetFacts:
    """Facts on the fleet that all pages show.

    Attributes
    ----------
    first, newest
        The fleet's first and newest night.
    faults
        Table files that could not be read.
    """

    name: str
    first: dt.date | None
    newest: dt.date | None
    faults: tuple[str, ...]


def fleet_html(facts: FleetFacts, rows: Sequence[FleetRow]) -> str:
    """The fleet's page."""
    found = Counter(row.state.state for row in rows)
    return (
        _environment()
        .get_template("fleet.html")
        .render(
            facts=facts,
            rows=rows,
            counts=[(code, found[code]) for code in ORDER if found[code]],
            types=sorted({row.motor_type for row in rows if row.motor_type}),
        )
    )


def motor_html(
    facts: FleetFacts, row: FleetRow, motor: MotorHistory, payload: dict[str, Any]
) -> str:
    """The page of one motor."""
    last = motor.fits.row(-1, named=True) if motor.nights else None
    return (
        _environment()
        .get_template("motor.html")
        .render(
            facts=facts,
            row=row,
            last=last,
            payload=script_json(payload),
            conditions=payload["conditions"],
            has_trend=bool(payload["trend"]["indicators"]),
        )
    )


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(FOLDER / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.tests["poor"] = is_poor
    environment.filters |= {
        "figure": figure,
        "plain": plain,
        "signed": signed,
        "status": _status,
    }
    environment.globals |= {
        "absent": ABSENT,
        "kinds": LEAKAGE_KINDS,
        "states": STATES,
        "spark_width": WIDTH,
        "spark_height": HEIGHT,
        "strip_height": STRIP_HEIGHT,
    }
    return environment


def _status(code: str) -> str:
    return STATUSES.get(code, code)
