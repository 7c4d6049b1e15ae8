"""Tables of a motor's course over the nights: trends, alarms, baselines, changes, decisions."""

from __future__ import annotations

import polars as pl

from pipeline.schema.columns import (
    MOTOR_ID,
    NIGHT,
    RUN_ID,
    TIMESTAMP,
    Column,
    Table,
)


def _per_time(name: str, per: str) -> tuple[Column, ...]:
    return tuple(
        Column(f"slope_{name}{end}", pl.Float64, f"see unit, {per}", what)
        for end, what in (
            ("", "Slope by generalised least squares; null below 20 nights"),
            ("_lower", "Lower end of its interval"),
            ("_upper", "Upper end of its interval"),
        )
    )


INDICATOR = Column(
    "indicator",
    pl.String,
    "",
    "reference_leakage, own_reference_leakage, baseline_deviation, peer_deviation, K_, leakage_ "
    "and gap_change_ with the path's name, C_f, pressure_zero, flow_zero, drain_flow, "
    "comparable_drain_flow, baseline_progress, temperature_effect, model_misfit or oil_viscosity",
)

TRENDS = Table(
    "trends",
    "a motor, a night, an indicator",
    ("motor_id", "night", "indicator"),
    (
        MOTOR_ID,
        NIGHT,
        INDICATOR,
        Column("value", pl.Float64, "see unit", "The night's figure; null without one"),
        Column("unit", pl.String, "", "l/min, m3, %, %/K, bar or 1"),
        Column("lower", pl.Float64, "see unit", "Lower end of its 95 % interval"),
        Column("upper", pl.Float64, "see unit", "Upper end of its 95 % interval"),
        Column("n_nights", pl.Int64, "", "Nights behind it: 1, or those of the filter"),
        Column(
            "gated_reason",
            pl.String,
            "",
            "Why the night does not count, also where it has a figure; null where it does",
        ),
        Column("baseline_start", pl.Date, "", "First night of the baseline in use"),
        Column("baseline_mean", pl.Float64, "see unit", "Its mean; null before there is one"),
        Column("deviation_percent", pl.Float64, "%", "(value − baseline) / baseline"),
        Column("running_hours", pl.Float64, "h", "Running hours since the motor's first night"),
        Column(
            "running_hours_estimated",
            pl.Boolean,
            "",
            "Some of them belong to nights without a log, by the mean share of the 30 before",
        ),
        *_per_time("per_1000_h", "1000 running hours"),
        *_per_time("per_year", "year of 365.25 days"),
        Column("theil_sen_per_year", pl.Float64, "see unit, year", "Median of all pairs' slopes"),
        Column("theil_sen_outside", pl.Boolean, "", "It lies outside the slope's interval"),
        Column("n_slope", pl.Int64, "", "Nights behind the slope"),
        Column(
            "slope_start",
            pl.Date,
            "",
            "First night of the line: since the baseline began or, where a change stands told, "
            "since that began",
        ),
        Column("provisional", pl.Boolean, "", "The slope rests on fewer than 60 nights"),
        Column("p_value", pl.Float64, "", "Of no slope, two-sided"),
        Column("q_value", pl.Float64, "", "The same, controlling false discoveries in the fleet"),
        Column(
            "is_trend",
            pl.Boolean,
            "",
            "q_value is below trend.false_discovery_rate; null without one",
        ),
        Column("cusum", pl.Float64, "sd", "One-sided CUSUM of the whitened deviations"),
        Column("cusum_limit", pl.Float64, "sd", "Beyond it the motor has changed"),
        Column(
            "state",
            pl.String,
            "",
            "ok (no change of external leakage), warning, alarm, common_cause, duty_outside (the "
            "baseline has not seen the night's duty), stale or insufficient",
        ),
        Column("state_reason", pl.String, "", "The state in words; null where ok"),
        Column("path", pl.String, "", "Path whose growth explains the change; null: none is told"),
        Column("path_probability", pl.Float64, "", "That it does"),
        Column("path_reason", pl.String, "", "Why no explanation is told, and what would tell"),
        Column("limit", pl.Float64, "see unit", "The limit that the days count to"),
        Column("days_to_limit", pl.Float64, "d", "Until the limit, as likely later as earlier"),
        Column("days_to_limit_lower", pl.Float64, "d", "Not before: lower end of its 90 % set"),
        Column("days_to_limit_upper", pl.Float64, "d", "Upper end; only of finite"),
        Column(
            "days_to_limit_status",
            pl.String,
            "",
            "finite, not_before, no_trend, already_crossed, beyond_horizon or insufficient; what "
            "earlier versions called unbounded is not_before",
        ),
        Column("oil", pl.String, "", "The night's oil"),
        Column("mean_temperature_c", pl.Float64, "°C", "Mean of the kept samples"),
        Column("flushing_mode", pl.String, "", "none, fixed or estimated"),
        Column("share_reversed", pl.Float64, "", "Share of kept samples with negative speed"),
        Column(
            "coverage",
            pl.Float64,
            "",
            "Overlap of the night's pressures, temperatures and speeds with the baseline's, the "
            "smallest of the three; 1: the same, 0: none",
        ),
        Column(
            "outside_fitted_range",
            pl.Boolean,
            "",
            "The indicator's conditions lie outside what the night's samples saw",
        ),
        Column(
            "sensor_health",
            pl.String,
            "",
            "What the zeros at halts say of the sensors: ok, drifted or unknown",
        ),
        RUN_ID,
        Column("warning_limit", pl.Float64, "see unit", "Level of a warning; null without one"),
        Column("alarm_limit", pl.Float64, "see unit", "Level of an alarm; null without one"),
        Column(
            "change_start",
            pl.Date,
            "",
            "First night of the change that the state tells; null where it tells none",
        ),
        Column(
            "common_factor",
            pl.Float64,
            "1",
            "Factor of all flows since the baseline, from the nights since the change; null unless "
            "its probability is 0.9",
        ),
        Column("common_factor_lower", pl.Float64, "1", "Lower end of its 95 % interval"),
        Column("common_factor_upper", pl.Float64, "1", "Upper end"),
        Column("common_probability", pl.Float64, "", "That all flows changed by one factor"),
        Column(
            "common_origin",
            pl.String,
            "",
            "tank: the other motors of the oil circuit have the factor, too; own_sensor: they have "
            "not; null: neither is told",
        ),
        Column(
            "model_verdict",
            pl.String,
            "",
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
        Column("time", TIMESTAMP, "UTC", "End of the night, never the clock"),
        INDICATOR,
        Column("from_state", pl.String, "", "State of the night before"),
        Column("to_state", pl.String, "", "State of the night"),
        Column("reason", pl.String, "", "In words, with figures and intervals"),
        Column("deviation_percent", pl.Float64, "%", "Of the night from the baseline"),
        Column(
            "way",
            pl.String,
            "",
            "Into a warning or an alarm: level, change (cumulative sum), both, sudden (by "
            "far, in one night), jump (a change that no event explains) or drift (of a "
            "sensor's zero); stale; common_cause; duty_outside; baseline; recovered; recomputed: "
            "what was told before is not in the figures now",
        ),
        Column("path", pl.String, "", "Path whose growth explains the change"),
        Column(
            "rules",
            pl.String,
            "",
            "Change of rules that made this row of a past night: of the program's, such as trends "
            "5 to 6, or of the form of the motor's model (scale of the rollers); null: none",
        ),
        Column("state_before_rules", pl.String, "", "State of the night as told before that"),
        Column(
            "is_silent",
            pl.Boolean,
            "",
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
        Column("time", TIMESTAMP, "UTC", "End of the block that shows it, never the clock"),
        Column("from_state", pl.String, "", "State before"),
        Column(
            "to_state",
            pl.String,
            "",
            "look_now (sudden rise), clear, blind (nothing to judge) or not_ready (no baseline)",
        ),
        Column("since", TIMESTAMP, "UTC", "Begin of the rise; null without one"),
        Column("change_percent", pl.Float64, "%", "Rise of the drain flow over the baseline"),
        Column("change_lower", pl.Float64, "%", "Lower end of its 95 % interval"),
        Column("change_upper", pl.Float64, "%", "Upper end"),
        Column("reason", pl.String, "", "In words, with what to do"),
        Column(
            "verdict",
            pl.String,
            "",
            "told; confirmed or withdrawn: by the night, in a row of its own; else null",
        ),
        Column("confirmed_by", pl.Date, "", "Night that gave the verdict"),
        RUN_ID,
    ),
)

BASELINES = Table(
    "baselines",
    "a motor, an indicator, a baseline as it was frozen in a night",
    ("motor_id", "night", "indicator"),
    (
        MOTOR_ID,
        Column("night", pl.Date, "", "Night in which it was frozen"),
        INDICATOR,
        Column("start", pl.Date, "", "First good night"),
        Column("end", pl.Date, "", "Last good night"),
        Column("n", pl.Int64, "", "Good nights"),
        Column("mean", pl.Float64, "see unit", "Winsorised mean"),
        Column("sd", pl.Float64, "see unit", "Robust standard deviation, not below its floor"),
        Column("unit", pl.String, "", "Unit of both"),
        Column("phi", pl.Float64, "", "Night-to-night correlation, detrended and bias-corrected"),
        Column("provisional", pl.Boolean, "", "To be replaced when there are more nights"),
        Column("sloped", pl.Boolean, "", "The baseline itself has a slope: wear may hide in it"),
        Column("reason", pl.String, "", "What it starts with: first nights, an event, a reset"),
        Column("own_pressure_bar", pl.Float64, "bar", "The motor's own reference conditions"),
        Column("own_temperature_c", pl.Float64, "°C", "The motor's own reference conditions"),
        Column("own_speed_rpm", pl.Float64, "rpm", "The motor's own reference conditions"),
        RUN_ID,
    ),
)

CHANGE_POINTS = Table(
    "change_points",
    "a motor, an indicator, a change as it was seen from a night",
    ("motor_id", "night", "indicator", "change_night"),
    (
        MOTOR_ID,
        Column("night", pl.Date, "", "Night from which it was seen; the latest holds"),
        INDICATOR,
        Column("change_night", pl.Date, "", "First night after the change"),
        Column("size_percent", pl.Float64, "%", "Step, relative to the level before"),
        Column("model", pl.String, "", "step, or trend and step: which explains the nights best"),
        RUN_ID,
    ),
)

DECISIONS = Table(
    "decisions",
    "what people said of a motor",
    ("motor_id", "time", "kind", "indicator"),
    (
        MOTOR_ID,
        Column("time", TIMESTAMP, "UTC", "When it was said"),
        Column("kind", pl.String, "", "acknowledged, finding or baseline_reset"),
        INDICATOR,
        Column("night", pl.Date, "", "Night that it refers to"),
        Column("finding", pl.String, "", "confirmed or not_confirmed; null: no finding"),
        Column("note", pl.String, "", "In words"),
        RUN_ID,
        Column("worn", pl.String, "", "Parts found worn, separated by commas; null: none"),
        Column("sound", pl.String, "", "Parts found sound, separated by commas; null: none"),
    ),
)

LATEST = Table(
    "latest",
    "a motor, as of the last run",
    ("motor_id",),
    (
        MOTOR_ID,
        Column("state", pl.String, "", "State of its newest night: the worst of its indicators"),
        Column("sentence", pl.String, "", "What `status` prints of it: the state in words"),
        Column("indicator", pl.String, "", "Indicator that tells the state; null where ok"),
        Column("path", pl.String, "", "Paths whose growth explains the state; null: none is told"),
        Column("known_since", pl.Date, "", "First night in which the change was told"),
        Column("state_since", pl.Date, "", "First night of the state; null where ok"),
        Column("change_start", pl.Date, "", "First night of the newest change in force"),
        Column("gap_path", pl.String, "", "Path with the largest gap change"),
        Column("gap_change_percent", pl.Float64, "%", "That change; null where none is known"),
        Column("gap_change_lower", pl.Float64, "%", "Lower end of its 95 % interval"),
        Column("gap_change_upper", pl.Float64, "%", "Upper end"),
        Column("leakage_l_per_min", pl.Float64, "l/min", "Leakage now; null where not known"),
        Column("leakage_lower", pl.Float64, "l/min", "Lower end of its 95 % interval"),
        Column("leakage_upper", pl.Float64, "l/min", "Upper end"),
        Column("leakage_indicator", pl.String, "", "Indicator that the leakage is from"),
        Column("leakage_verdict", pl.String, "", "Verdict on it, at the fleet's conditions"),
        Column("leakage_night", pl.Date, "", "Last night with such a leakage"),
        Column("deviation_percent", pl.Float64, "%", "Its deviation from the baseline"),
        Column("days_to_limit", pl.Float64, "d", "As in `trends`, of the indicator"),
        Column("days_to_limit_lower", pl.Float64, "d", "As in `trends`"),
        Column("days_to_limit_upper", pl.Float64, "d", "As in `trends`"),
        Column("days_to_limit_status", pl.String, "", "As in `trends`"),
        Column("limit_dates", pl.String, "", "The same as dates, in words; empty without any"),
        Column("last_night", pl.Date, "", "Newest night with a row"),
        Column("last_good_night", pl.Date, "", "Newest night with a fit"),
        Column("data_night", pl.Date, "", "Newest night with samples"),
        Column("data_age_nights", pl.Int64, "", "Nights from it to the fleet's newest of these"),
        Column("sensor_health", pl.String, "", "ok, drifted or unknown"),
        Column("model_verdict", pl.String, "", "supported, doubtful or disproved; null: not told"),
        Column("reason", pl.String, "", "Reason of the state, or drift of a sensor"),
        Column("failure", pl.String, "", "The last night, if it failed, in words"),
        Column("poor_fit", pl.String, "", "A poor fit of the last good night, in words"),
        Column("temperature_effect", pl.String, "", "Loss factors that change with temperature"),
        Column("model_misfit", pl.String, "", "That the model does not describe the motor"),
        Column("oil", pl.String, "", "The oil as measured; empty where its data sheet holds"),
        Column("acknowledged", pl.String, "", "Note of the last acknowledgement of the state"),
        RUN_ID,
    ),
)
