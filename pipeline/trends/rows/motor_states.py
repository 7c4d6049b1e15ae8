"""A motor's state in one row: what `status` prints, and the table `latest` publishes."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from leakage.estimation.validation import is_poor
from pipeline.trends.nights.decisions import Decision
from pipeline.trends.states.words import FALL

Row = dict[str, Any]

# From what needs attention most to what needs none.
CHANGED = ("alarm", "warning", "common_cause")
ORDER = (*CHANGED, "duty_outside", "stale", "insufficient", "ok")
REFERENCES = ("reference_leakage", "own_reference_leakage", "comparable_drain_flow")
GAP = "gap_change_"
SENSORS = ("pressure_zero", "flow_zero")
TEMPERATURE_EFFECT, MODEL_MISFIT = "temperature_effect", "model_misfit"
OIL_VISCOSITY = "oil_viscosity"
TONIGHTS_FITS = ("training_fit_percent", "validation_fit_percent")
FITS_OF_A_NIGHT = {
    "training_fit_percent": "training",
    "validation_fit_percent": "validation",
    "previous_model_fit_percent": "the model before, on tonight",
}
LIMITS = ("days_to_limit", "days_to_limit_lower", "days_to_limit_upper", "days_to_limit_status")
# States that ask for something.
TOLD = (*CHANGED, "stale")
# States of the looks within the day: a sudden rise, and none.
LOOK_NOW, CLEAR = "look_now", "clear"
ADVICE = {
    "common_cause": "Check oil, temperature and charge pressure of the circuit first.",
    "duty_outside": "Begin a new baseline if this duty is to stay.",
    "stale": "Check whether the motor's logs arrive, and the reason of its last nights.",
    "insufficient": "Wait for more good nights.",
    "ok": "Nothing to do.",
}


@dataclass(frozen=True, slots=True)
class LookStanding:
    """State of a motor's looks, for people."""

    # state, since, reason: as of `LookState`; since None: no change of state yet.
    state: str
    since: dt.datetime | None
    reason: str
    # told, confirmed, withdrawn: rises told, and those that a night confirmed or withdrew.
    told: int = 0
    confirmed: int = 0
    withdrawn: int = 0

    @property
    def words(self) -> str:
        """State in words.

        Examples
        --------
        >>> LookStanding("not_ready", None, "12 of 30 good nights").words
        'within the day not ready: 12 of 30 good nights'
        """
        since = "" if self.since is None else f" since {self.since:%Y-%m-%d %H:%M} UTC"
        return f"within the day {self.state.replace('_', ' ')}{since}: {self.reason}"


@dataclass(frozen=True, slots=True)
class MotorState:
    """A motor's state in its newest night."""

    motor_id: str
    state: str  # the worst of its indicators
    # indicator, reason: that indicator and its reason in words; of a motor that is ok, the drift of
    # a sensor.
    indicator: str | None = None
    reason: str | None = None
    # leakage_l_per_min, deviation_percent: reference leakage now, and its deviation from the
    # baseline; at the motor's own conditions where it is not known at the fleet's. None where
    # neither is known: a figure counts neither if it is older than the change in force, nor if it
    # is stale.
    leakage_l_per_min: float | None = None
    deviation_percent: float | None = None
    sensor_health: str | None = None  # ok, drifted or unknown
    # last_night, last_good_night: last night with a row, and with a fit; None without one.
    last_night: dt.date | None = None
    last_good_night: dt.date | None = None
    # Note of the last acknowledgement since the state began; empty without one.
    acknowledged: str = ""
    leakage_night: dt.date | None = None  # last night with a reference leakage; None without one
    # First night of the newest change in force; None without one.
    change_start: dt.date | None = None
    # poor_fit, failure: sentence on a poor fit of the last good night, and on the last night if it
    # failed; else empty.
    poor_fit: str = ""
    failure: str = ""
    # leakage_indicator, leakage_lower, leakage_upper: indicator that the leakage is from, and its
    # 95 % interval.
    leakage_indicator: str | None = None
    leakage_lower: float | None = None
    leakage_upper: float | None = None
    # gap_path, gap_change_percent: path with the largest gap change now, and that change; None
    # where no gap is known.
    gap_path: str | None = None
    gap_change_percent: float | None = None
    # Verdict on the leakage at the reference conditions; None for that at the motor's own.
    leakage_verdict: str | None = None
    # Dates between which the indicator reaches its limit, in words; empty without one.
    limit_dates: str = ""
    # That loss factors change with temperature, in words; empty where they do not.
    temperature_effect: str = ""
    # That the model does not describe the motor, in words; empty where it does.
    model_misfit: str = ""
    # The same as a verdict: supported, doubtful or disproved; None without one.
    model_verdict: str | None = None
    oil: str = ""  # the oil as measured, in words; empty where its data sheet holds
    path: str | None = None  # paths whose growth explains the state; None where none is told
    # gap_change_lower, gap_change_upper: 95 % interval of the gap change.
    gap_change_lower: float | None = None
    gap_change_upper: float | None = None
    # state_since, known_since: first night of the state, of the indicator that tells it, and of its
    # stretch of warnings, alarms or common causes; None of a motor that is ok.
    state_since: dt.date | None = None
    known_since: dt.date | None = None
    # days_to_limit, days_to_limit_lower, days_to_limit_upper, days_to_limit_status: of the
    # indicator that tells the state, as in `trends`.
    days_to_limit: float | None = None
    days_to_limit_lower: float | None = None
    days_to_limit_upper: float | None = None
    days_to_limit_status: str | None = None
    # Standing of the looks within the day, which the table `latest` does not hold; None where there
    # was none.
    look: LookStanding | None = None
    # data_night, data_age_nights: newest night with samples, and nights from it to the fleet's
    # newest such night.
    data_night: dt.date | None = None
    data_age_nights: int | None = None

    @property
    def sentence(self) -> str:
        """The state in words, a sudden rise within the day first."""
        reason = self.reason or "no change of external leakage"
        rise = self.look.words if self.look is not None and self.is_sudden else ""
        return f"{rise}; {reason}" if rise else reason

    @property
    def notes(self) -> tuple[str, ...]:
        """Further notes on the motor, in words."""
        dates = f"its limit {self.limit_dates}" if self.limit_dates else ""
        oil = "" if self.oil in self.sentence else self.oil
        beside = (self.temperature_effect, self.model_misfit, self.failure, self.poor_fit)
        is_told = self.look is not None and not self.is_sudden and self.look.state != CLEAR
        look = self.look.words if self.look is not None and is_told else ""
        return tuple(note for note in (dates, *beside, oil, look) if note)

    @property
    def why(self) -> str:
        """The sentence with its notes, and an acknowledgement."""
        words = "; ".join((self.sentence, *self.notes))
        return f"{words} (acknowledged: {self.acknowledged})" if self.acknowledged else words

    @property
    def advice(self) -> str:
        """Advice on the state, in words."""
        if self.state in CHANGED and self.reason and FALL in self.reason:
            return "Check oil, sensors and flushing first."
        if self.state in ("warning", "alarm"):
            look = "Look at" if self.state == "alarm" else "Plan a look at"
            parts = (self.path or "").replace("_", " ").replace(" and ", " and the ")
            found = f"the {parts}" if parts else "the motor, as its part is not known,"
            return f"{look} {found}{' at the next stop' if self.state == 'alarm' else ''}."
        if self.failure and self.state not in CHANGED:
            return "Mend what failed in the last night."
        return ADVICE[self.state]

    @property
    def needs_attention(self) -> bool:
        """The state asks for something, or the last night failed."""
        return self.is_sudden or self.state in TOLD or bool(self.failure)

    @property
    def is_sudden(self) -> bool:
        """A sudden rise within the day stands."""
        return self.look is not None and self.look.state == LOOK_NOW


# What `latest` holds.
STORED = tuple(one.name for one in fields(MotorState) if one.name != "look")


def latest_rows(states: Iterable[MotorState], run_id: str) -> list[Row]:
    """Rows of `latest`."""
    own = ({name: getattr(one, name) for name in STORED} | {"sentence": one.why} for one in states)
    return [row | {"run_id": run_id} for row in own]


def fit_words(name: str, percent: float) -> str:
    """A fit with its name; a poor one is called that.

    Examples
    --------
    >>> fit_words("training", 99.14), fit_words("validation", -1295.0)
    ('training 99.1 %', 'validation -1295.0 % (poor: worse than a constant flow)')
    """
    poor = " (poor: worse than a constant flow)" if is_poor(percent) else ""
    return f"{name} {percent:.1f} %{poor}"


def urgency(motor: MotorState) -> tuple[int, float, str]:
    """Sort key of motors: a sudden rise first; a failed night no later than a stale motor."""
    place = -1 if motor.is_sudden else ORDER.index(motor.state)
    if motor.failure:
        place = min(place, ORDER.index("stale"))
    return place, -(motor.deviation_percent or 0.0), motor.motor_id


def with_acknowledgement(state: MotorState, decisions: Sequence[Decision]) -> MotorState:
    """A state with the last acknowledgement since it began, of a motor's decisions."""
    if state.state_since is None:
        return state
    said = [
        one.note or one.kind
        for one in decisions
        if one.indicator in ("", state.indicator)
        and one.kind in ("acknowledged", "finding")
        and one.night >= state.state_since
    ]
    return replace(state, acknowledged=said[-1]) if said else state
