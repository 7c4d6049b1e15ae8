"""Tables of a night's samples: refused ones, statistics of blocks, how the motor was run."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.schema.columns import (
    COUNTS,
    MOTOR_ID,
    NAMES,
    NIGHT,
    NUMBERS,
    RUN_ID,
    SHORT_NUMBERS,
    Column,
    Table,
    count,
    moment,
    number,
    text,
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
        text("channel", "A channel, or time_base for rules that need them all"),
        text(
            "reason",
            "The rule; a sample is counted under each that refuses it, and once under any: "
            + ", ".join(QUALITY_REASONS),
        ),
        count("n_samples", "Samples that the rule looked at"),
        count("n_refused", "Samples that it refused"),
        RUN_ID,
        count(
            "n_noted",
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
        moment("block_start", "Start of the block"),
        moment("block_end", "End of the block, excluded"),
        text("part", "training, validation or guard"),
        count("n", "Kept samples"),
        Column("columns", NAMES, "", "Columns of the statistics, in order"),
        Column(
            "statistics",
            NUMBERS,
            "",
            "Upper triangle of the factor R of the samples' columns, row by row",
        ),
        number("mean_pressure_bar", "bar", "Mean magnitude"),
        number("minimum_pressure_bar", "bar", "Smallest magnitude"),
        number("maximum_pressure_bar", "bar", "Largest magnitude"),
        Column("pressure_histogram", COUNTS, "", "Samples by magnitude, 20 bins of 20 bar from 0"),
        number("mean_temperature_c", "°C", "Mean"),
        number("minimum_temperature_c", "°C", "Smallest"),
        number("maximum_temperature_c", "°C", "Largest"),
        Column("temperature_histogram", COUNTS, "", "Samples, 28 bins of 5 °C from −20 °C"),
        number("mean_speed_rpm", "rpm", "Mean magnitude"),
        number("minimum_speed_rpm", "rpm", "Smallest magnitude"),
        number("maximum_speed_rpm", "rpm", "Largest magnitude"),
        Column("speed_histogram", COUNTS, "", "Samples by magnitude, 15 bins of 10 rpm from 0"),
        number("share_reversed", "", "Share of samples with negative speed"),
        count("n_beyond_curve", "Samples beyond the range of a speed curve"),
        text("model_hash", "Blocks of different hash never merge"),
        RUN_ID,
        Column(
            "short_means",
            SHORT_NUMBERS,
            "",
            "Of each block of two minutes that was merged into this one: its place on the clock, "
            "counted from the start in such blocks, its samples, and the means of the columns but "
            "one; null where none was merged, and in rows of before version 6",
        ),
        number(
            "viscosity_ratio",
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
        number("logged_hours", "h", "Time with a credible speed"),
        number("kept_hours", "h", "Time of the samples kept for statistics"),
        number("running_share", "", "Share of the logged time above standstill"),
        number(
            "running_hours",
            "h",
            "Running hours of the night: of the log's counter, else running_share of the night",
        ),
        text("running_hours_source", "counter or share; null: unknown"),
        text("oil", "The night's oil"),
        number("mean_pressure_bar", "bar", "Mean magnitude of the kept samples"),
        number("mean_temperature_c", "°C", "Mean of the kept samples"),
        number("mean_speed_rpm", "rpm", "Mean magnitude of the kept samples"),
        number("mean_flow_l_per_min", "l/min", "Mean drain flow of the kept samples"),
        number("share_reversed", "", "Share of kept samples with negative speed"),
        Column("pressure_histogram", COUNTS, "", "Kept samples, bins of 20 bar from 0"),
        Column("temperature_histogram", COUNTS, "", "Kept samples, bins of 5 °C from −20 °C"),
        Column("speed_histogram", COUNTS, "", "Kept samples, bins of 10 rpm from 0"),
        count("n_halts", "Halts without pressure that show the sensors' zeros"),
        number("pressure_zero_bar", "bar", "What the pressure difference read at them"),
        number(
            "pressure_zero_standard_error_bar",
            "bar",
            "From the scatter between halts; null for fewer than three",
        ),
        number(
            "flow_zero_l_per_min",
            "l/min",
            "What the drain flow read at them, the flushing included",
        ),
        number("flow_zero_standard_error_l_per_min", "l/min", "From the scatter between halts"),
        RUN_ID,
    ),
)
