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

from pipeline.messages import as_sentence, plain
from pipeline.report.charts import Chart
from pipeline.report.findings import Score
from pipeline.report.fleet_page import FleetRow
from pipeline.report.history import MotorHistory
from pipeline.report.plotly_json import figure as plotly_figure
from pipeline.report.plotly_json import script_json
from pipeline.report.sparkline import HEIGHT, WIDTH
from pipeline.report.words import (
    ABSENT,
    DECISIONS,
    GLOSSARY,
    STATES,
    STATUSES,
    candidates,
    figure,
    percent,
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
    counts = [(code, found[code]) for code in ORDER if found[code]]
    return _made("fleet.html", facts, rows=rows, by_rules=by_rules, counts=counts, parts=parts)


def glossary_html(facts: FleetFacts) -> str:
    """The page of terms and states."""
    return _made("glossary.html", facts, terms=GLOSSARY)


def motor_html(
    facts: FleetFacts,
    row: FleetRow,
    motor: MotorHistory,
    charts: Mapping[str, Chart],
    nights: Mapping[str, Any],
    changes: Sequence[Mapping[str, Any]],
    decisions: Sequence[Decision],
) -> str:
    """The page of one motor.

    `charts` are those over its nights by the id of their place, `nights` what the page's script
    needs to choose a night; changes of state and decisions come with the newest first.
    """
    drawn = {name: plotly_figure(chart) for name, chart in charts.items()}
    return _made(
        "motor.html",
        facts,
        row=row,
        last=motor.fits.row(-1, named=True) if motor.nights else None,
        charts=charts,
        payload=script_json({**nights, "figures": drawn}),
        changes=changes,
        decisions=decisions,
    )


def _made(template: str, facts: FleetFacts, **values: Any) -> str:
    return _environment().get_template(template).render(facts=facts, **values)


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
        "day": day,
        "decision": lambda code: DECISIONS.get(code, code),
        "figure": figure,
        "indicator": name_of,
        "percent": percent,
        "plain": plain,
        "sentence": as_sentence,
        "status": lambda code: STATUSES.get(code, code),
    }
    environment.globals |= {
        "absent": ABSENT,
        "states": STATES,
        "spark_width": WIDTH,
        "spark_height": HEIGHT,
    }
    return environment
