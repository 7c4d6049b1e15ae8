"""Tables below a fit: its parameters, their systematic errors, and its starts."""

from __future__ import annotations

from pipeline.schema.columns import (
    FIT_KEY,
    FIT_KEY_NAMES,
    NAMES,
    NUMBERS,
    RUN_ID,
    Column,
    Table,
    count,
    flag,
    half_widths,
    number,
    text,
)

PARAMETERS = Table(
    "parameters",
    "a fit, a parameter",
    (*FIT_KEY_NAMES, "parameter"),
    (
        *FIT_KEY,
        text(
            "parameter",
            "K_, h_, e_, share_ or film_thickness_ratio_ and the path's name; C_f for the flushing",
        ),
        number("value", "see unit", "Estimate; null where only a range is known"),
        text("unit", "m3, um, l_per_min or 1"),
        number("lower", "see unit", "Lower end of the 95 % interval"),
        number("upper", "see unit", "Upper end of the 95 % interval"),
        number("bootstrap_lower", "see unit", "The same by a block bootstrap"),
        number("bootstrap_upper", "see unit", "The same by a block bootstrap"),
        number("systematic", "see unit", "± from stated tolerances"),
        number("feasible_min", "see unit", "Least value that the K allows"),
        number("feasible_max", "see unit", "Largest value that the K allows"),
        text(
            "verdict",
            "identified, uncertain (by its total ±), only_in_combination, not_excited, at_bound, "
            "fixed or too_little_data; of shares as reference_verdict",
        ),
        text("reason", "The verdict in words"),
        number(
            "spread_over_starts",
            "see unit",
            "Largest minus smallest value over the starts at the minimum; null without a search",
        ),
        RUN_ID,
        flag(
            "geometry_is_placeholder",
            "The value is made from a placeholder of the path's geometry and means nothing; null "
            "where no geometry is in it, and in rows of before version 3",
        ),
        number(
            "interval_degrees_of_freedom",
            "",
            "Of a coefficient's interval; 4 are needed; null of other parameters",
        ),
        number(
            "largest_block_share",
            "",
            "Share of what is known of a coefficient that rests on one block; at most 0.5",
        ),
        *half_widths("", "see unit"),
    ),
)

SENSITIVITIES = Table(
    "sensitivities",
    "a fit, an indicator, a source of systematic error",
    (*FIT_KEY_NAMES, "indicator", "source"),
    (
        *FIT_KEY,
        text("indicator", "A coefficient, reference_leakage or own_conditions_leakage"),
        text("source", "A channel's offset or gain, or a constant"),
        number("tolerance", "see tolerance_unit", "Assumed error, as stated"),
        text("tolerance_unit", "bar, °C, rpm, l_per_min, or 1: a relative one"),
        number("effect", "see unit", "Change of the indicator, signed"),
        text("unit", "m3, l_per_min or 1"),
        RUN_ID,
        text(
            "assumed_sensor",
            "Kind of sensor whose tolerance is assumed, as none is stated: class 1, Pt100 class B "
            "or gear meter; it is in no `systematic`. Null where it is stated",
        ),
    ),
)

STARTS = Table(
    "starts",
    "a fit, a start",
    (*FIT_KEY_NAMES, "start"),
    (
        *FIT_KEY,
        count("start", "0 is the configured starting point"),
        number("cost", "(l/min)²", "Criterion V (20) where the search ended"),
        text("status", "The tolerance that was met, iteration_limit or failed"),
        text("reason", "In words"),
        count("iterations", "Evaluations of the criterion"),
        flag("at_minimum", "Within 1e-4 of the certificate's criterion"),
        Column("parameters", NAMES, "", "Names of the free parameters"),
        Column("initial_values", NUMBERS, "µm, 1, l/min", "In that order"),
        Column("final_values", NUMBERS, "µm, 1, l/min", "In that order"),
        RUN_ID,
    ),
)
