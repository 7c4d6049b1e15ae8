"""Alarms and metrics of a run, once it has published; neither costs anybody the run."""

from __future__ import annotations

import datetime as dt
import logging
from collections.abc import Sequence

from pipeline.config import Fleet
from pipeline.errors import LockedError, StoreError
from pipeline.intraday.rows import open_rises
from pipeline.notification.delivery import Receiver, UndeliveredError
from pipeline.notification.mail import EMAIL
from pipeline.notification.outbox import backlogs, deliver, deliver_summary
from pipeline.run.metrics import metrics_text, write_metrics
from pipeline.run.tasks import RunResult
from pipeline.store.heartbeat import last_good_run
from pipeline.store.state import State, open_state
from pipeline.trends.rows.motor_states import published_states, urgency

log = logging.getLogger(__name__)


def settle_intraday(fleet: Fleet, state: State) -> None:
    """Let published nights settle what the intraday check reported; if not now, the next run's."""
    try:
        rises = open_rises(fleet.output, [spec.motor_id for spec in fleet.motors])
        if rises:
            # Most runs need none of it.
            from pipeline.intraday.check import settle_rises

            settle_rises(fleet, state, rises)
    except (LockedError, StoreError) as error:
        log.warning("intraday check: %s; the next run settles what it reported", error)


def summary_rows(fleet: Fleet) -> list[dict[str, str]]:
    """Return state of each motor for a summary, the most urgent first."""
    states = published_states(fleet.output, [spec.motor_id for spec in fleet.motors])
    return [
        {
            "motor_id": state.motor_id,
            "state": state.state,
            "headline": state.headline,
            "sentence": state.why,
            "advice": state.advice,
        }
        for state in sorted(states, key=urgency)
    ]


def deliver_alarms(fleet: Fleet, receivers: Sequence[Receiver]) -> None:
    """Deliver what waits; that it cannot be delivered costs nobody the run."""
    try:
        with open_state(fleet.output) as state:
            for fault in deliver(state, receivers, fleet.name):
                log.warning("%s", fault)
            for receiver in receivers:
                if receiver.name == EMAIL:
                    _deliver_summary(fleet, state, receiver)
    except StoreError as error:
        log.warning("alarms: %s; what was delivered may be delivered again", error)


def _deliver_summary(fleet: Fleet, state: State, receiver: Receiver) -> None:
    """Deliver the summary that is due; where it is not taken, the next run does it."""
    today = dt.datetime.now(fleet.settings.nights.zone).date()
    due = fleet.settings.alarms.email.summary_due(today)
    try:
        if due is not None:
            deliver_summary(state, receiver, fleet.name, due, lambda: summary_rows(fleet))
    except UndeliveredError as error:
        log.warning("%s: summary: %s; the next run tries again", receiver.label, error.why)


def measure(fleet: Fleet, receivers: Sequence[Receiver], result: RunResult) -> None:
    """Write the metrics; that they cannot be written costs nobody the run."""
    if fleet.metrics_file is None:
        return
    output = fleet.output
    try:
        text = metrics_text(
            fleet,
            published_states(output, [spec.motor_id for spec in fleet.motors]),
            result.outcomes,
            result.seconds_by_stage,
            backlogs(output, receivers),
            last_good_run(output),
        )
        write_metrics(fleet.metrics_file, text)
    except StoreError as error:
        log.warning("%s; there are no metrics of this run", error)
