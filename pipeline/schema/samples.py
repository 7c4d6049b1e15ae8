"""Tables of a night's samples: refused ones, statistics of blocks, how the motor was run."""

from __future__ import annotations

from dataclasses import dataclass

import polars as pl

from pipeline.schema.columns import (
    COUNTS,
    MOTOR_ID,
    NAMES,
    NIGHT,
    NUMBERS,
    RUN_ID,
    SHORT_NUMBERS,
    TIMESTAMP,
    Column,
    Table,
)

# Edges of the coarse histograms of `block_statistics`: the last bin holds all beyond.
PRESSURE_EDGES_BAR = tuple(float(edge) for edge in range(0, 401, 20))

TEMPERATURE_EDGES_C = tuple(float(edge) for edge in range(-20, 121, 5))
SPEED_EDGES_RPM = tuple(float(edge) for edge in range(0, 151, 10))


@dataclass(frozen=True, slots=True)
class Reason:
    """A reason of `quality`: its words on a page, and its meaning in a sentence."""

    words: str
    meaning: str


# Reasons of `quality`, in the order of the rules; those behind `transport_delay` are of the time
# base, where all channels have come together, or of the night's windows.
QUALITY_REASONS: dict[str, Reason] = {
    "missing": Reason(
        "no value", "A blank cell where the channel's own period says that a sample is due"
    ),
    "bad_quality": Reason(
        "not good by the log's own word", "The log itself does not call the sample good"
    ),
    "not_finite": Reason("not a finite number", "Not a number, or infinite"),
    "no_interval": Reason(
        "count without an interval",
        "A count of which the interval is not known: the first, or behind a gap",
    ),
    "counter_reset": Reason(
        "counter set back", "A running total that fell other than by rolling over"
    ),
    "out_of_range": Reason("out of its valid range", "Outside the channel's valid range"),
    "at_maximum": Reason(
        "sensor at its maximum", "The sensor at its maximum, as the drain flow's under back-flow"
    ),
    "spike": Reason("spike", "Too far from the median of its neighbourhood (Hampel filter)"),
    "frozen": Reason("sensor frozen", "No change beyond the sensor's resolution for too long"),
    "backward_time": Reason(
        "time running backward",
        "A time before that of the sample before; noted: put back in its place",
    ),
    "duplicate_time": Reason("time stamp twice", "The time of the sample before once more"),
    "jitter": Reason(
        "off its period",
        "Never refused; noted: neither one nor several periods after the sample before",
    ),
    "gap": Reason(
        "gap in the log", "Times of the time base at which the channel is silent for too long"
    ),
    "transport_delay": Reason(
        "flow too small to say when it arrives",
        "No inputs are known from as long before as the oil takes to the sensor",
    ),
    "standstill": Reason("motor at standstill", "The motor does not turn"),
    "guard": Reason(
        "guard time around a halt or back-flow",
        "Too soon before or after a standstill or a sensor at its maximum",
    ),
    "transient": Reason("speed or pressure changing fast", "Pressure or speed changes too fast"),
    "incomplete": Reason(
        "a channel without a value", "A channel has no sample there, for whatever reason"
    ),
    "thin_block": Reason("block with too few samples", "Kept, but in a block of which too few are"),
    "short_stretch": Reason(
        "stretch too short", "Kept, but in a stretch between two gaps that is too short to fit"
    ),
    "outside_periods": Reason(
        "outside the periods chosen by hand", "Kept, but outside the periods that are set by hand"
    ),
    "any": Reason("refused by any rule", "Refused by at least one rule: each sample once"),
}

QUALITY = Table(
    "quality",
    "a motor, a night, a channel, a reason",
    ("motor_id", "night", "channel", "reason"),
    (
        MOTOR_ID,
        NIGHT,
        Column("channel", pl.String, "", "A channel, or time_base for rules that need them all"),
        Column(
            "reason",
            pl.String,
            "",
            "The rule; a sample is counted under each that refuses it, and once under any: "
            + ", ".join(QUALITY_REASONS),
        ),
        Column("n_samples", pl.Int64, "", "Samples that the rule looked at"),
        Column("n_refused", pl.Int64, "", "Samples that it refused"),
        RUN_ID,
        Column(
            "n_noted",
            pl.Int64,
            "",
            "Samples that were kept although it applies: put back in order, or off their period",
        ),
    ),
)

BLOCK_STATISTICS = Table(
    "block_statistics",
    "a motor, a block",
    ("motor_id", "night", "block_start"),
    (
        MOTOR_ID,
        NIGHT,
        Column("block_start", TIMESTAMP, "UTC", "Start of the block"),
        Column("block_end", TIMESTAMP, "UTC", "End of the block, excluded"),
        Column("part", pl.String, "", "training, validation or guard"),
        Column("n", pl.Int64, "", "Kept samples"),
        Column("columns", NAMES, "", "Columns of the statistics, in order"),
        Column(
            "statistics",
            NUMBERS,
            "",
            "Upper triangle of the factor R of the samples' columns, row by row",
        ),
        Column("mean_pressure_bar", pl.Float64, "bar", "Mean magnitude"),
        Column("minimum_pressure_bar", pl.Float64, "bar", "Smallest magnitude"),
        Column("maximum_pressure_bar", pl.Float64, "bar", "Largest magnitude"),
        Column("pressure_histogram", COUNTS, "", "Samples by magnitude, 20 bins of 20 bar from 0"),
        Column("mean_temperature_c", pl.Float64, "°C", "Mean"),
        Column("minimum_temperature_c", pl.Float64, "°C", "Smallest"),
        Column("maximum_temperature_c", pl.Float64, "°C", "Largest"),
        Column("temperature_histogram", COUNTS, "", "Samples, 28 bins of 5 °C from −20 °C"),
        Column("mean_speed_rpm", pl.Float64, "rpm", "Mean magnitude"),
        Column("minimum_speed_rpm", pl.Float64, "rpm", "Smallest magnitude"),
        Column("maximum_speed_rpm", pl.Float64, "rpm", "Largest magnitude"),
        Column("speed_histogram", COUNTS, "", "Samples by magnitude, 15 bins of 10 rpm from 0"),
        Column("share_reversed", pl.Float64, "", "Share of samples with negative speed"),
        Column("n_beyond_curve", pl.Int64, "", "Samples beyond the range of a speed curve"),
        Column("model_hash", pl.String, "", "Blocks of different hash never merge"),
        RUN_ID,
        Column(
            "short_means",
            SHORT_NUMBERS,
            "",
            "Of each block of two minutes that was merged into this one: its place on the clock, "
            "counted from the start in such blocks, its samples, and the means of the columns but "
            "one; null where none was merged, and in rows of before version 6",
        ),
        Column(
            "viscosity_ratio",
            pl.Float64,
            "1",
            "Viscosity by the log over that of the data sheet, by the whole night's readings; null "
            "without such a channel. The statistics are those of the data sheet's oil",
        ),
    ),
)

OPERATION = Table(
    "operation",
    "a motor, a night with samples",
    ("motor_id", "night"),
    (
        MOTOR_ID,
        NIGHT,
        Column("logged_hours", pl.Float64, "h", "Time with a credible speed"),
        Column("kept_hours", pl.Float64, "h", "Time of the samples kept for statistics"),
        Column("running_share", pl.Float64, "", "Share of the logged time above standstill"),
        Column(
            "running_hours",
            pl.Float64,
            "h",
            "Running hours of the night: of the log's counter, else running_share of the night",
        ),
        Column("running_hours_source", pl.String, "", "counter or share; null: unknown"),
        Column("oil", pl.String, "", "The night's oil"),
        Column("mean_pressure_bar", pl.Float64, "bar", "Mean magnitude of the kept samples"),
        Column("mean_temperature_c", pl.Float64, "°C", "Mean of the kept samples"),
        Column("mean_speed_rpm", pl.Float64, "rpm", "Mean magnitude of the kept samples"),
        Column("mean_flow_l_per_min", pl.Float64, "l/min", "Mean drain flow of the kept samples"),
        Column("share_reversed", pl.Float64, "", "Share of kept samples with negative speed"),
        Column("pressure_histogram", COUNTS, "", "Kept samples, bins of 20 bar from 0"),
        Column("temperature_histogram", COUNTS, "", "Kept samples, bins of 5 °C from −20 °C"),
        Column("speed_histogram", COUNTS, "", "Kept samples, bins of 10 rpm from 0"),
        Column("n_halts", pl.Int64, "", "Halts without pressure that show the sensors' zeros"),
        Column("pressure_zero_bar", pl.Float64, "bar", "What the pressure difference read at them"),
        Column(
            "pressure_zero_standard_error_bar",
            pl.Float64,
            "bar",
            "From the scatter between halts; null for fewer than three",
        ),
        Column(
            "flow_zero_l_per_min",
            pl.Float64,
            "l/min",
            "What the drain flow read at them, the flushing included",
        ),
        Column(
            "flow_zero_standard_error_l_per_min",
            pl.Float64,
            "l/min",
            "From the scatter between halts",
        ),
        RUN_ID,
    ),
)
