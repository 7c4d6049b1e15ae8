"""The HTML of the pages, from templates that escape whatever is put into them."""

from __future__ import annotations

import datetime as dt
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from leakage.estimation.validation import POOR_FIT_PERCENT, is_poor
from pipeline.report.encoding import script_json
from pipeline.report.findings import Score
from pipeline.report.fleet_page import FleetRow
from pipeline.report.history import MotorHistory
from pipeline.report.sparkline import HEIGHT, STRIP_HEIGHT, WIDTH
from pipeline.report.words import (
    ABSENT,
    DECISIONS,
    STATES,
    STATUSES,
    candidates,
    figure,
    plain,
    sentence,
    signed,
)
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.rows.motor_states import ORDER
from pipeline.trends.sentences import day, name_of

FOLDER = Path(__file__).parent
UTC = ZoneInfo("UTC")
ASSETS = tuple(sorted((FOLDER / "assets").iterdir()))


@dataclass(frozen=True, slots=True)
class FleetFacts:
    """Facts on the fleet that all pages show."""

    name: str
    # first, newest: the fleet's first and newest night.
    first: dt.date | None
    newest: dt.date | None
    faults: tuple[str, ...] = ()  # table files that could not be read
    undelivered: tuple[str, ...] = ()  # alarms that a receiver has not taken, in words
    made: dt.datetime | None = None  # time of making; None: it is not told
    zone: ZoneInfo = UTC  # time zone of the fleet
    old_after_nights: int = 7  # nights after which a motor's newest data are old


def fleet_html(
    facts: FleetFacts,
    rows: Sequence[FleetRow],
    by_rules: Sequence[Mapping[str, Any]] = (),
    parts: Mapping[str, Score] | None = None,
) -> str:
    """The fleet's page.

    `by_rules`: rows of `alarms` that a change of rules made; `parts`: parts named by alarms against
    those that inspections found, by type of motor.
    """
    found = Counter(row.state.state for row in rows)
    return (
        _environment()
        .get_template("fleet.html")
        .render(
            facts=facts,
            rows=rows,
            by_rules=by_rules,
            counts=[(code, found[code]) for code in ORDER if found[code]],
            types=sorted({row.motor_type for row in rows if row.motor_type}),
            parts=parts or {},
        )
    )


def motor_html(
    facts: FleetFacts,
    row: FleetRow,
    motor: MotorHistory,
    payload: Mapping[str, Any],
    changes: Sequence[Mapping[str, Any]],
    decisions: Sequence[Decision],
) -> str:
    """The page of one motor; its changes of state and decisions come with the newest first."""
    last = motor.fits.row(-1, named=True) if motor.nights else None
    return (
        _environment()
        .get_template("motor.html")
        .render(
            facts=facts,
            row=row,
            last=last,
            payload=script_json(payload),
            changes=changes,
            decisions=decisions,
            has_shown=bool(payload["shown"]),
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
        "candidates": candidates,
        "day": day,
        "decision": lambda code: DECISIONS.get(code, code),
        "figure": figure,
        "percent": lambda share: signed(None if share is None else 100.0 * share),
        "indicator": name_of,
        "plain": plain,
        "sentence": sentence,
        "signed": signed,
        "status": lambda code: STATUSES.get(code, code),
    }
    environment.globals |= {
        "absent": ABSENT,
        "poor_fit_percent": POOR_FIT_PERCENT,
        "states": STATES,
        "spark_width": WIDTH,
        "spark_height": HEIGHT,
        "strip_height": STRIP_HEIGHT,
    }
    return environment
