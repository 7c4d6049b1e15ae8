"""Which motor to look at first, and why, in words.

Where a run has judged trends, its states decide. Where none has, only what can be said without
alarm rules is said: what failed, what has no recent fit, and what has clearly changed.
"""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from typing import Final

import numpy as np

from pipeline.report.history import FIRST_NIGHTS, LAST_NIGHTS, Change, MotorHistory
from pipeline.report.trends import Standing
from pipeline.report.words import plain, signed

# As the levels of model.md, section 7: a path's leakage 15 % above where it began.
TELLING_RATIO: Final = 1.15
STALE_AFTER: Final = dt.timedelta(days=7)
RECENT_NIGHTS: Final = 30
# Fewer fitted nights than this share of the recent ones is worth a look.
FEW_GOOD: Final = 0.5
GOOD: Final = "ok"

# By code, the most urgent first; the words that stand for it.
STATES: Final = {
    "alarm": "alarm",
    "failed": "last night failed",
    "warning": "warning",
    "never": "no good night yet",
    "stale": "no recent good night",
    "sensor": "a sensor has drifted",
    "grown": "leakage has grown",
    "gap": "a gap has changed",
    "fallen": "leakage has fallen",
    "common_cause": "common cause",
    "thin": "few good nights",
    "few": "change cannot be told",
    "unchanged": "no change of external leakage",
}
DRIFTED: Final = "drifted"
ZEROS: Final = "the readings at halts say that a zero of pressure or flow has moved"
OF_TRENDS: Final = {"stale": "stale", "insufficient": "few", "ok": "unchanged"}


@dataclass(frozen=True, slots=True)
class Attention:
    """How a motor stands.

    Attributes
    ----------
    code
        One of `STATES`.
    reason
        Why, in a sentence's words.
    size
        Orders motors of one state: the larger, the more urgent.
    """

    code: str
    reason: str
    size: float = 0.0

    @property
    def label(self) -> str:
        """The state in words."""
        return STATES[self.code]

    @property
    def rank(self) -> tuple[int, float]:
        """Sorts the most urgent first."""
        return list(STATES).index(self.code), -self.size


@dataclass(frozen=True, slots=True)
class Changes:
    """What has changed since the first good nights.

    Attributes
    ----------
    leakage
        Of the leakage; None: too few nights.
    gap
        Of the loss factor that changed most, with the name of its path; None: too few nights.
    """

    leakage: Change | None
    gap: tuple[str, Change] | None


def changes(motor: MotorHistory) -> Changes:
    """Changes of leakage and gaps since a motor's first good nights.

    Leakage at each night's own conditions moves with them, so it tells no change.
    """
    kind, course = motor.leakage
    leakage = None if kind == "own" else motor.change(course)
    found = [
        (name.removeprefix("K_"), change)
        for name, course in motor.coefficients.items()
        if name.startswith("K_") and (change := motor.change(course)) is not None
    ]
    clear = [one for one in found if one[1].is_clear] or found
    largest = max(clear, key=lambda one: abs(np.log(one[1].ratio)), default=None)
    return Changes(leakage, largest)


def attention(
    motor: MotorHistory, changed: Changes, standing: Standing | None, newest: dt.date | None
) -> Attention:
    """How a motor stands."""
    if standing is not None and standing.state == "alarm":
        return _moved(standing)
    if not motor.nights:
        return Attention("never", "no night of this motor is in the tables")
    last = motor.fits.row(-1, named=True)
    if last["status"] == "failed":
        return Attention("failed", f"{motor.nights[-1]}: {last['reason']}")
    if standing is not None and standing.state in ("warning", "common_cause"):
        return _moved(standing)
    absent = _absent(motor, newest)
    if absent is not None:
        return absent
    if standing is not None and standing.sensor_health == DRIFTED:
        return Attention("sensor", ZEROS)
    if standing is not None:
        return Attention(OF_TRENDS[standing.state], standing.reason)
    return _unjudged(motor, changed)


def _moved(standing: Standing) -> Attention:
    """An indicator is beyond its limits; whether it may be a sensor's doing is said with it."""
    drifted = standing.sensor_health == DRIFTED
    reason = f"{standing.reason}; {ZEROS}" if drifted else standing.reason
    return Attention(standing.state, reason, standing.deviation_percent or 0.0)


def _absent(motor: MotorHistory, newest: dt.date | None) -> Attention | None:
    good = [n for n, status in zip(motor.nights, motor.statuses, strict=True) if status == GOOD]
    last = motor.fits.row(-1, named=True)
    if not good:
        return Attention("never", f"{motor.nights[-1]}: {last['reason'] or 'no reason is stated'}")
    silent = (newest or motor.nights[-1]) - good[-1]
    if silent > STALE_AFTER:
        why = f"; {motor.nights[-1]}: {last['reason']}" if last["reason"] else ""
        return Attention("stale", f"none for {silent.days} nights{why}", float(silent.days))
    recent = motor.statuses[-RECENT_NIGHTS:]
    n_good = recent.count(GOOD)
    if n_good < FEW_GOOD * len(recent):
        return Attention("thin", f"{n_good} of the last {len(recent)} nights are fitted")
    return None


def _unjudged(motor: MotorHistory, changed: Changes) -> Attention:
    """What can be told of a motor whose trends no run has judged."""
    if changed.leakage is None and changed.gap is None:
        return _nothing_to_compare(motor)
    leakage = changed.leakage if changed.leakage and _is_telling(changed.leakage) else None
    path, gap = changed.gap if changed.gap and _is_telling(changed.gap[1]) else ("", None)
    told = []
    if leakage is not None:
        told.append(f"leakage {signed(leakage.percent, 0)} %")
    if gap is not None:
        told.append(f"{plain(path)} gap {signed(gap.gap_percent, 0)} %")
    if not told:
        return Attention(
            "unchanged", "nothing has clearly moved by 15 % since the first good nights"
        )
    state = "gap" if leakage is None else "grown" if leakage.ratio > 1 else "fallen"
    size = max(abs(np.log(one.ratio)) for one in (leakage, gap) if one is not None)
    return Attention(state, f"{', '.join(told)} since the first good nights", float(size))


def _is_telling(change: Change) -> bool:
    return change.is_clear and not 1.0 / TELLING_RATIO < change.ratio < TELLING_RATIO


def _nothing_to_compare(motor: MotorHistory) -> Attention:
    n_good = motor.statuses.count(GOOD)
    needed = FIRST_NIGHTS + LAST_NIGHTS
    if n_good < needed:
        return Attention("few", f"{n_good} good nights; {needed} are needed to compare")
    reason = motor.fits.filter(status=GOOD).row(-1, named=True)["reference_reason"]
    return Attention("few", f"no leakage at reference conditions: {reason or 'not determined'}")
