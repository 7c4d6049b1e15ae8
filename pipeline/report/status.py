"""The fleet's state as published, and what inspections made of its alarms."""

from __future__ import annotations

import datetime as dt
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import polars as pl

from pipeline.errors import UsageError
from pipeline.look.state import look_standings
from pipeline.schema import ALARMS, FITS, WATCH
from pipeline.store.heartbeat import Beat, last_good_run, read_heartbeat
from pipeline.store.published import TableFault, faults_of
from pipeline.store.tables import read_rows
from pipeline.telling.outbox import Backlog, backlogs
from pipeline.telling.receivers import Receiver
from pipeline.trends.nights.decisions import Decision, read_decisions
from pipeline.trends.rows.motor_states import CHANGED, MotorState, published_states, urgency

# Nights up to the last one before the opening in which the newest alarm counts: a motor may stand
# for weeks before it is opened.
NIGHTS_BEFORE = 7
COEFFICIENT = "K_"
# Causes that leave open which part it is.
NO_PART = ("all_gaps", "all_flows", "cannot_be_told")


@dataclass(frozen=True, slots=True)
class Score:
    """Parts that inspections looked at."""

    # named_right, named_wrong: parts that an alarm named: worn, and sound.
    named_right: int = 0
    named_wrong: int = 0
    cannot_be_told: int = 0  # worn parts of a motor in alarm of which no part was named
    missed: int = 0  # worn parts that no alarm named, though it named others or there was none


@dataclass(frozen=True, slots=True)
class FleetStatus:
    """All motors, those that need attention first."""

    motors: tuple[MotorState, ...]
    # When the last run ended that went through all motors; None where none did.
    last_good_run: dt.datetime | None
    # findings_confirmed, findings: alarms with wear found at the inspection, and all inspected
    # alarms.
    findings_confirmed: int
    findings: int
    beat: Beat | None = None  # heartbeat of the current or the last run; None before the first
    receivers: tuple[Backlog, ...] = ()  # changes of state not yet delivered, by receiver
    # Parts named by alarms against those that inspections found worn, by motor type.
    parts: Mapping[str, Score] = field(default_factory=dict)
    # States of past nights that a change of the program's rules raised, changed or withdrew.
    n_by_rules: int = 0
    # Published files that are gone, or were written to since and are not what was published.
    damage: tuple[TableFault, ...] = ()


def fleet_status(
    output: Path, motor_ids: Sequence[str], receivers: Sequence[Receiver] = ()
) -> FleetStatus:
    """The state of some motors, and undelivered changes by receiver.

    Raises StoreError if a table is damaged.
    """
    motors = current_states(output, motor_ids)
    decisions = read_decisions(output)
    findings = last_findings(decisions)
    alarms = read_rows(output, ALARMS, motor_ids, ("rules", "state_before_rules", "to_state"))
    return FleetStatus(
        tuple(sorted(motors, key=urgency)),
        last_good_run(output),
        findings.count("confirmed"),
        len(findings),
        read_heartbeat(output),
        backlogs(output, receivers),
        read_scores(output, motor_ids, decisions),
        changed_by_rules(alarms).height,
        faults_of(output),
    )


def current_states(output: Path, motor_ids: Sequence[str]) -> list[MotorState]:
    """States of some motors as the last run left them, with their looks within the day.

    Raises StoreError if a table is damaged.
    """
    looks = look_standings(output, motor_ids)
    found = published_states(output, motor_ids)
    return [replace(one, look=looks.get(one.motor_id)) for one in found]


def changed_by_rules(alarms: pl.DataFrame) -> pl.DataFrame:
    """Rows of `alarms` in which a change of rules raised, changed or withdrew something."""
    before, after = pl.col("state_before_rules"), pl.col("to_state")
    raised = before.is_in(CHANGED) | after.is_in(CHANGED)
    return alarms.filter(pl.col("rules").is_not_null() & (before != after) & raised)


def last_findings(decisions: Sequence[Decision]) -> list[str]:
    """Finding of each alarm that was inspected; of several the last."""
    found = {
        (one.motor_id, one.indicator, one.night): one.finding
        for one in decisions
        if one.finding is not None
    }
    return list(found.values())


def read_scores(
    output: Path, motor_ids: Sequence[str], decisions: Sequence[Decision]
) -> dict[str, Score]:
    """Scores by motor type; the tables are read only where there are findings."""
    if not any(one.kind == "finding" for one in decisions):
        return {}
    fits = read_rows(output, FITS, motor_ids, ("motor_id", "night", "motor_type")).sort("night")
    types = dict(fits.select("motor_id", "motor_type").iter_rows())
    columns = ("motor_id", "night", "state", "cause")
    return scores(decisions, read_rows(output, WATCH, motor_ids, columns), types)


def scores(
    decisions: Iterable[Decision], watch: pl.DataFrame, types: Mapping[str, str]
) -> dict[str, Score]:
    """Parts named by alarms against those that inspections found, by type of motor.

    Of several findings on a part of the same night the last counts.
    """
    inspected = {one: is_worn for said in decisions for one, is_worn in _parts(said)}
    found: dict[str, Counter[str]] = {}
    for (motor_id, night, part), is_worn in sorted(inspected.items()):
        if motor_id in types:
            named = _named(watch.filter(motor_id=motor_id), night)
            found.setdefault(types[motor_id], Counter())[
                _outcome(part, named, is_worn=is_worn)
            ] += 1
    return {
        motor_type: Score(**{name: n for name, n in counts.items() if name})
        for motor_type, counts in sorted(found.items())
    }


def _parts(said: Decision) -> list[tuple[tuple[str, dt.date, str], bool]]:
    """Parts of a finding, and whether each is worn; that on a loss factor is one on its path."""
    parts = [(part, True) for part in said.worn_parts]
    parts += [(part, False) for part in said.sound_parts]
    if said.finding is not None and said.indicator.startswith(COEFFICIENT):
        parts.append((said.indicator.removeprefix(COEFFICIENT), said.finding == "confirmed"))
    return [((said.motor_id, said.night, part), is_worn) for part, is_worn in parts]


def _named(watch: pl.DataFrame, opened: dt.date) -> Sequence[str] | None:
    """Parts that a motor's newest alarm before its opening named; None: there was none."""
    nights = watch.filter(pl.col("night") <= opened)
    last = nights["night"].max()
    if not isinstance(last, dt.date):
        return None
    is_late = pl.col("night") > last - dt.timedelta(days=NIGHTS_BEFORE)
    alarmed = nights.filter(is_late, pl.col("state").is_in(("warning", "alarm"))).sort("night")
    if alarmed.is_empty():
        return None
    cause = alarmed["cause"][-1]
    return [] if cause is None or cause in NO_PART else cause.split(" and ")


def _outcome(part: str, named: Sequence[str] | None, *, is_worn: bool) -> str:
    """The count of `Score` that a part belongs to; none of a sound part that nobody named."""
    if named is not None and part in named:
        return "named_right" if is_worn else "named_wrong"
    if not is_worn:
        return ""
    return "missed" if named is None or named else "cannot_be_told"


def last_alarm(output: Path, motor_id: str, indicator: str, states: Collection[str]) -> dt.date:
    """The night of the last alarm of an indicator in one of some states.

    Raises UsageError (``no_alarm``) if there was none; the message lists the alarms so far.
    """
    rows = read_rows(output, ALARMS, [motor_id], ("motor_id", "night", "indicator", "to_state"))
    raised = rows.filter(pl.col("to_state").is_in(list(states)))
    night = raised.filter(indicator=indicator)["night"].max()
    if not isinstance(night, dt.date):
        named = ", ".join(sorted(raised["indicator"].unique())) or "none"
        raise UsageError(
            "no_alarm", f"{motor_id} has had no alarm of {indicator!r}; alarms so far: {named}"
        )
    return night
