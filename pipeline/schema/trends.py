"""Tables of a motor's course over the nights: trends, alarms, baselines, changes, decisions."""

from __future__ import annotations

import polars as pl

from pipeline.schema.columns import (
    MOTOR_ID,
    NIGHT,
    RUN_ID,
    Column,
    Table,
    count,
    day,
    flag,
    moment,
    number,
    text,
)


def _per_time(name: str, per: str) -> tuple[Column, ...]:
    return tuple(
        number(f"slope_{name}{end}", f"see unit, {per}", what)
        for end, what in (
            ("", "Slope by generalised least squares; null below 20 nights"),
            ("_lower", "Lower end of its interval"),
            ("_upper", "Upper end of its interval"),
        )
    )


INDICATOR = text(
    "indicator",
    "reference_leakage, own_reference_leakage, baseline_deviation, peer_deviation, K_, "
    "leakage_ and gap_change_ with the path's name, C_f, pressure_zero, flow_zero, "
    "drain_flow, comparable_drain_flow, baseline_progress, temperature_effect, "
    "model_misfit or oil_viscosity",
)

TRENDS = Table(
    "trends",
    "a motor, a night, an indicator",
    ("motor_id", "night", "indicator"),
    (
        MOTOR_ID,
        NIGHT,
        INDICATOR,
        number("value", "see unit", "The night's figure; null without one"),
        text("unit", "l/min, m3, %, %/K, bar or 1"),
        number("lower", "see unit", "Lower end of its 95 % interval"),
        number("upper", "see unit", "Upper end of its 95 % interval"),
        count("n_nights", "Nights behind it: 1, or those of the filter"),
        text(
            "gated_reason",
            "Why the night does not count, also where it has a figure; null where it does",
        ),
        day("baseline_start", "First night of the baseline in use"),
        number("baseline_mean", "see unit", "Its mean; null before there is one"),
        number("deviation_percent", "%", "(value − baseline) / baseline"),
        number("running_hours", "h", "Running hours since the motor's first night"),
        flag(
            "running_hours_estimated",
            "Some of them belong to nights without a log, by the mean share of the 30 before",
        ),
        *_per_time("per_1000_h", "1000 running hours"),
        *_per_time("per_year", "year of 365.25 days"),
        number("theil_sen_per_year", "see unit, year", "Median of all pairs' slopes"),
        flag("theil_sen_outside", "It lies outside the slope's interval"),
        count("n_slope", "Nights behind the slope"),
        day(
            "slope_start",
            "First night of the line: since the baseline began or, where a change stands told, "
            "since that began",
        ),
        flag("provisional", "The slope rests on fewer than 60 nights"),
        number("p_value", "", "Of no slope, two-sided"),
        number("q_value", "", "The same, controlling false discoveries in the fleet"),
        flag("is_trend", "q_value is below trend.false_discovery_rate; null without one"),
        number("cusum", "sd", "One-sided CUSUM of the whitened deviations"),
        number("cusum_limit", "sd", "Beyond it the motor has changed"),
        text(
            "state",
            "ok (no change of external leakage), warning, alarm, common_cause, duty_outside (the "
            "baseline has not seen the night's duty), stale or insufficient",
        ),
        text("state_reason", "The state in words; null where ok"),
        text("path", "Path whose growth explains the change; null: none is told"),
        number("path_probability", "", "That it does"),
        text("path_reason", "Why no explanation is told, and what would tell"),
        number("limit", "see unit", "The limit that the days count to"),
        number("days_to_limit", "d", "Until the limit, as likely later as earlier"),
        number("days_to_limit_lower", "d", "Not before: lower end of its 90 % set"),
        number("days_to_limit_upper", "d", "Upper end; only of finite"),
        text(
            "days_to_limit_status",
            "finite, not_before, no_trend, already_crossed, beyond_horizon or insufficient; what "
            "earlier versions called unbounded is not_before",
        ),
        text("oil", "The night's oil"),
        number("mean_temperature_c", "°C", "Mean of the kept samples"),
        text("flushing_mode", "none, fixed or estimated"),
        number("share_reversed", "", "Share of kept samples with negative speed"),
        number(
            "coverage",
            "",
            "Overlap of the night's pressures, temperatures and speeds with the baseline's, the "
            "smallest of the three; 1: the same, 0: none",
        ),
        flag(
            "outside_fitted_range",
            "The indicator's conditions lie outside what the night's samples saw",
        ),
        text("sensor_health", "What the zeros at halts say of the sensors: ok, drifted or unknown"),
        RUN_ID,
        number("warning_limit", "see unit", "Level of a warning; null without one"),
        number("alarm_limit", "see unit", "Level of an alarm; null without one"),
        day(
            "change_start",
            "First night of the change that the state tells; null where it tells none",
        ),
        number(
            "common_factor",
            "1",
            "Factor of all flows since the baseline, from the nights since the change; null unless "
            "its probability is 0.9",
        ),
        number("common_factor_lower", "1", "Lower end of its 95 % interval"),
        number("common_factor_upper", "1", "Upper end"),
        number("common_probability", "", "That all flows changed by one factor"),
        text(
            "common_origin",
            "tank: the other motors of the oil circuit have the factor, too; own_sensor: they have "
            "not; null: neither is told",
        ),
        text(
            "model_verdict",
            "Of model_misfit, over the last ten nights that tell it: supported, doubtful (above "
            "0.59 %) or disproved (above 1 %; 1.5 % before there are ten); else null",
        ),
        Column(
            "likely_iso_vg",
            pl.Int64,
            "mm²/s",
            "ISO grade whose filling would explain common_factor; a proposal for an oil_change, "
            "null where the oil's own or no grade does",
        ),
    ),
)

ALARMS = Table(
    "alarms",
    "a change of state",
    ("motor_id", "night", "indicator"),
    (
        MOTOR_ID,
        NIGHT,
        moment("time", "End of the night, never the clock"),
        INDICATOR,
        text("from_state", "State of the night before"),
        text("to_state", "State of the night"),
        text("reason", "In words, with figures and intervals"),
        number("deviation_percent", "%", "Of the night from the baseline"),
        text(
            "way",
            "Into a warning or an alarm: level, change (cumulative sum), both, sudden (by far, in "
            "one night), jump (a change that no event explains) or drift (of a sensor's zero); "
            "stale; common_cause; duty_outside; baseline; recovered; recomputed: what was told "
            "before is not in the figures now",
        ),
        text("path", "Path whose growth explains the change"),
        text(
            "rules",
            "Change of rules that made this row of a past night: of the program's, such as trends "
            "5 to 6, or of the form of the motor's model (scale of the rollers); null: none",
        ),
        text("state_before_rules", "State of the night as told before that"),
        flag(
            "is_silent",
            "True: made by a change of rules and not sent, as its state was told before or passed",
        ),
        RUN_ID,
    ),
)
# Columns of what a row says; the others are its key, or follow from it.
ALARM_CONTENT = ("from_state", "to_state", "way", "path", "reason")

LOOKS = Table(
    "looks",
    "a change of state of the look within the day",
    ("motor_id", "time", "to_state"),
    (
        MOTOR_ID,
        moment("time", "End of the block that shows it, never the clock"),
        text("from_state", "State before"),
        text(
            "to_state",
            "look_now (sudden rise), clear, blind (nothing to judge) or not_ready (no baseline)",
        ),
        moment("since", "Begin of the rise; null without one"),
        number("change_percent", "%", "Rise of the drain flow over the baseline"),
        number("change_lower", "%", "Lower end of its 95 % interval"),
        number("change_upper", "%", "Upper end"),
        text("reason", "In words, with what to do"),
        text(
            "verdict", "told; confirmed or withdrawn: by the night, in a row of its own; else null"
        ),
        day("confirmed_by", "Night that gave the verdict"),
        RUN_ID,
    ),
)

BASELINES = Table(
    "baselines",
    "a motor, an indicator, a baseline as it was frozen in a night",
    ("motor_id", "night", "indicator"),
    (
        MOTOR_ID,
        day("night", "Night in which it was frozen"),
        INDICATOR,
        day("start", "First good night"),
        day("end", "Last good night"),
        count("n", "Good nights"),
        number("mean", "see unit", "Winsorised mean"),
        number("sd", "see unit", "Robust standard deviation, not below its floor"),
        text("unit", "Unit of both"),
        number("phi", "", "Night-to-night correlation, detrended and bias-corrected"),
        flag("provisional", "To be replaced when there are more nights"),
        flag("sloped", "The baseline itself has a slope: wear may hide in it"),
        text("reason", "What it starts with: first nights, an event, a reset"),
        number("own_pressure_bar", "bar", "The motor's own reference conditions"),
        number("own_temperature_c", "°C", "The motor's own reference conditions"),
        number("own_speed_rpm", "rpm", "The motor's own reference conditions"),
        RUN_ID,
    ),
)

CHANGE_POINTS = Table(
    "change_points",
    "a motor, an indicator, a change as it was seen from a night",
    ("motor_id", "night", "indicator", "change_night"),
    (
        MOTOR_ID,
        day("night", "Night from which it was seen; the latest holds"),
        INDICATOR,
        day("change_night", "First night after the change"),
        number("size_percent", "%", "Step, relative to the level before"),
        text("model", "step, or trend and step: which explains the nights best"),
        RUN_ID,
    ),
)

DECISIONS = Table(
    "decisions",
    "what people said of a motor",
    ("motor_id", "time", "kind", "indicator"),
    (
        MOTOR_ID,
        moment("time", "When it was said"),
        text("kind", "acknowledged, finding or baseline_reset"),
        INDICATOR,
        day("night", "Night that it refers to"),
        text("finding", "confirmed or not_confirmed; null: no finding"),
        text("note", "In words"),
        RUN_ID,
        text("worn", "Parts found worn, separated by commas; null: none"),
        text("sound", "Parts found sound, separated by commas; null: none"),
    ),
)

LATEST = Table(
    "latest",
    "a motor, as of the last run",
    ("motor_id",),
    (
        MOTOR_ID,
        text("state", "State of its newest night: the worst of its indicators"),
        text("sentence", "What `status` prints of it: the state in words"),
        text("indicator", "Indicator that tells the state; null where ok"),
        text("path", "Paths whose growth explains the state; null: none is told"),
        day("known_since", "First night in which the change was told"),
        day("state_since", "First night of the state; null where ok"),
        day("change_start", "First night of the newest change in force"),
        text("gap_path", "Path with the largest gap change"),
        number("gap_change_percent", "%", "That change; null where none is known"),
        number("gap_change_lower", "%", "Lower end of its 95 % interval"),
        number("gap_change_upper", "%", "Upper end"),
        number("leakage_l_per_min", "l/min", "Leakage now; null where not known"),
        number("leakage_lower", "l/min", "Lower end of its 95 % interval"),
        number("leakage_upper", "l/min", "Upper end"),
        text("leakage_indicator", "Indicator that the leakage is from"),
        text("leakage_verdict", "Verdict on it, at the fleet's conditions"),
        day("leakage_night", "Last night with such a leakage"),
        number("deviation_percent", "%", "Its deviation from the baseline"),
        number("days_to_limit", "d", "As in `trends`, of the indicator"),
        number("days_to_limit_lower", "d", "As in `trends`"),
        number("days_to_limit_upper", "d", "As in `trends`"),
        text("days_to_limit_status", "As in `trends`"),
        text("limit_dates", "The same as dates, in words; empty without any"),
        day("last_night", "Newest night with a row"),
        day("last_good_night", "Newest night with a fit"),
        day("data_night", "Newest night with samples"),
        count("data_age_nights", "Nights from it to the fleet's newest of these"),
        text("sensor_health", "ok, drifted or unknown"),
        text("model_verdict", "supported, doubtful or disproved; null: not told"),
        text("reason", "Reason of the state, or drift of a sensor"),
        text("failure", "The last night, if it failed, in words"),
        text("poor_fit", "A poor fit of the last good night, in words"),
        text("temperature_effect", "Loss factors that change with temperature"),
        text("model_misfit", "That the model does not describe the motor"),
        text("oil", "The oil as measured; empty where its data sheet holds"),
        text("acknowledged", "Note of the last acknowledgement of the state"),
        RUN_ID,
    ),
)
