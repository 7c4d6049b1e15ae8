"""Names, types, units and meaning of every column of every table. The only place.

``docs/tables.md`` and the table ``data_dictionary`` are made from here. Columns are only ever
added; each addition raises the version.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import polars as pl

SCHEMA_VERSION = 3

TIMESTAMP = pl.Datetime("us", "UTC")
NUMBERS = pl.List(pl.Float64)
COUNTS = pl.List(pl.Int64)
NAMES = pl.List(pl.String)

# Edges of the coarse histograms of `block_statistics`: the last bin holds all beyond.
PRESSURE_EDGES_BAR = tuple(float(edge) for edge in range(0, 401, 20))
TEMPERATURE_EDGES_C = tuple(float(edge) for edge in range(-20, 121, 5))
SPEED_EDGES_RPM = tuple(float(edge) for edge in range(0, 151, 10))


@dataclass(frozen=True, slots=True)
class Column:
    """A column: its name (with its unit, where it has one), type, unit and meaning."""

    name: str
    type: pl.DataType | type[pl.DataType]
    unit: str
    description: str


@dataclass(frozen=True, slots=True)
class Table:
    """A table: its key sorts the rows, and no two rows share it."""

    name: str
    row: str
    key: tuple[str, ...]
    columns: tuple[Column, ...]

    @property
    def schema(self) -> dict[str, pl.DataType | type[pl.DataType]]:
        """Polars types by column name."""
        return {column.name: column.type for column in self.columns}


RUN_ID = Column("run_id", pl.String, "", "Run that wrote the row: hash of inputs, code and config")
MOTOR_ID = Column("motor_id", pl.String, "", "The motor")
NIGHT = Column("night", pl.Date, "", "Local date on which the night ends")
FLUSHING_MODE = Column("flushing_mode", pl.String, "", "none, fixed or estimated")
FIT_KEY = (MOTOR_ID, NIGHT, FLUSHING_MODE)
FIT_KEY_NAMES = ("motor_id", "night", "flushing_mode")


def _interval(name: str, unit: str, what: str) -> tuple[Column, Column]:
    stem = name.removesuffix("_l_per_min")
    return (
        Column(f"{stem}_lower", pl.Float64, unit, f"Lower end of the 95 % interval of {what}"),
        Column(f"{stem}_upper", pl.Float64, unit, f"Upper end of the 95 % interval of {what}"),
    )


FITS = Table(
    "fits",
    "a motor, a night, a flushing mode",
    FIT_KEY_NAMES,
    (
        MOTOR_ID,
        Column("motor_type", pl.String, "", "The motor's type"),
        NIGHT,
        Column("window_start", TIMESTAMP, "UTC", "First sample that was used; null without a fit"),
        Column("window_end", TIMESTAMP, "UTC", "Last sample that was used; null without a fit"),
        FLUSHING_MODE,
        Column("is_primary", pl.Boolean, "", "The configured mode: exactly one a night"),
        Column(
            "status",
            pl.String,
            "",
            "ok, stood_still, no_new_data (no log covers the night), insufficient_data or failed",
        ),
        Column("reason", pl.String, "", "Why there is no fit, in words; null where status is ok"),
        Column("error_code", pl.String, "", "Stable code of the failure; null unless failed"),
        Column("n_training", pl.Int64, "", "Samples that the model was fitted to"),
        Column("n_validation", pl.Int64, "", "Samples that it was validated on"),
        Column("training_fit_percent", pl.Float64, "%", "Fit (23) on the training samples"),
        Column(
            "validation_fit_percent",
            pl.Float64,
            "%",
            "Fit (23) on the validation samples; negative where worse than their mean; null where "
            "the flow has no shape to fit",
        ),
        Column(
            "previous_model_fit_percent",
            pl.Float64,
            "%",
            "Fit (23) of the motor's model before, on all of tonight's samples",
        ),
        Column("training_rmse_l_per_min", pl.Float64, "l/min", "Root mean squared error"),
        Column("validation_rmse_l_per_min", pl.Float64, "l/min", "Root mean squared error"),
        Column("smoothing_s", pl.Float64, "s", "Length of the moving average; 0: none"),
        Column("fpe", pl.Float64, "(l/min)²", "Final prediction error (25)"),
        Column("aic", pl.Float64, "", "Akaike's information criterion"),
        Column("aicc", pl.Float64, "", "The same, corrected for small samples"),
        Column("bic", pl.Float64, "", "Bayesian information criterion"),
        Column(
            "n_effective",
            pl.Float64,
            "",
            "Training samples that would carry as much if their errors were independent: "
            "N(1−φ)/(1+φ), φ the lag-one correlation",
        ),
        Column(
            "lag_one_autocorrelation", pl.Float64, "", "Of the training errors, φ of n_effective"
        ),
        Column("aic_effective", pl.Float64, "", "aic with n_effective in place of n_training"),
        Column("aicc_effective", pl.Float64, "", "aicc with n_effective"),
        Column("bic_effective", pl.Float64, "", "bic with n_effective"),
        Column("n_parameters", pl.Int64, "", "Identified coefficients: d of fpe, aic and bic"),
        Column(
            "is_best_on_validation",
            pl.Boolean,
            "",
            "The night's mode of flushing with the highest validation fit",
        ),
        Column("cost", pl.Float64, "(l/min)²", "Criterion V (20) at the published estimate"),
        Column(
            "certificate_gap",
            pl.Float64,
            "",
            "(V of the best start − V of the certificate) / V of the certificate",
        ),
        Column(
            "dual_residual",
            pl.Float64,
            "",
            "Proof of the minimum: largest relative violation of the optimality conditions",
        ),
        Column("n_starts", pl.Int64, "", "Starting points of the search"),
        Column("n_starts_at_minimum", pl.Int64, "", "Starts within 1e-4 of the minimum"),
        Column("rank", pl.Int64, "", "Rank of the free regressors, columns scaled"),
        Column("condition_number", pl.Float64, "", "Of the free regressors, columns scaled"),
        Column("singular_values", NUMBERS, "", "Of the free regressors, columns scaled to norm 1"),
        Column("correlation_time_s", pl.Float64, "s", "Time over which the training errors forget"),
        Column("interval_status", pl.String, "", "ok, or why the night has no intervals"),
        Column("n_interval_blocks", pl.Int64, "", "Blocks behind the intervals, after lengthening"),
        Column(
            "reference_leakage_l_per_min",
            pl.Float64,
            "l/min",
            "Leakage of the fitted model at the reference conditions, flushing excluded; null "
            "unless identified or fixed",
        ),
        *_interval("reference_leakage", "l/min", "the reference leakage"),
        Column("reference_leakage_systematic", pl.Float64, "l/min", "± from stated tolerances"),
        Column(
            "reference_verdict",
            pl.String,
            "",
            "identified, fixed, not_identified, outside_fitted_range or too_little_data",
        ),
        Column("reference_reason", pl.String, "", "The verdict in words; null where identified"),
        Column("reference_pressure_bar", pl.Float64, "bar", "Reference conditions"),
        Column("reference_temperature_c", pl.Float64, "°C", "Reference conditions"),
        Column("reference_speed_rpm", pl.Float64, "rpm", "Reference conditions"),
        Column(
            "own_conditions_leakage_l_per_min",
            pl.Float64,
            "l/min",
            "Leakage of the fitted model at the night's own mean conditions, flushing excluded; "
            "null unless identified or fixed",
        ),
        *_interval("own_conditions_leakage", "l/min", "the leakage at own conditions"),
        Column(
            "own_conditions_leakage_systematic", pl.Float64, "l/min", "± from stated tolerances"
        ),
        Column("own_conditions_verdict", pl.String, "", "As reference_verdict"),
        Column("own_conditions_reason", pl.String, "", "The verdict in words"),
        Column(
            "own_pressure_bar",
            pl.Float64,
            "bar",
            "Mean magnitude over the training samples",
        ),
        Column("own_temperature_c", pl.Float64, "°C", "Mean over the training samples"),
        Column("own_speed_rpm", pl.Float64, "rpm", "Mean magnitude over the training samples"),
        Column(
            "outside_fitted_range",
            pl.Boolean,
            "",
            "The reference conditions lie outside what the training samples saw",
        ),
        Column("mean_flow_l_per_min", pl.Float64, "l/min", "Mean measured drain flow"),
        Column("kept_share", pl.Float64, "", "Share of the running motor's samples that was kept"),
        Column("film_pressure", pl.String, "", "thesis (with its share) or slot"),
        Column("two_sided", pl.Boolean, "", "Paths leak from both sides to the case"),
        Column("loss", pl.String, "", "squared or huber"),
        Column("oil", pl.String, "", "The night's oil"),
        Column("model_hash", pl.String, "", "Hash of all that shapes the statistics"),
        RUN_ID,
        Column(
            "transport_delay_s",
            pl.Float64,
            "s",
            "Mean delay (14) that the samples were paired with; null where it is off",
        ),
        Column(
            "estimated_transport_delay_s",
            pl.Float64,
            "s",
            "The same by cross-correlation of measured and predicted flow; null where it is off, "
            "nothing moves, or the best agreement lies at the longest delay tried",
        ),
        Column("columns", NAMES, "", "Columns of the statistics: of each free path, one, known, y"),
        Column(
            "coefficients", NUMBERS, "m3, l/min", "θ: a coefficient for each free path, then C_f"
        ),
        Column(
            "coefficient_covariance",
            NUMBERS,
            "squares of those",
            "Upper triangle of their covariance, row by row; 0 where fixed; null without intervals",
        ),
        Column(
            "night_factor",
            NUMBERS,
            "",
            "Upper triangle of the factor R of all kept samples of the night, row by row",
        ),
        Column("n_kept", pl.Int64, "", "Kept samples of the night, of all parts"),
        Column("sample_period_s", pl.Float64, "s", "Period of the time base"),
        Column(
            "mean_charge_over_case_bar",
            pl.Float64,
            "bar",
            "Mean charge above case pressure; null unless two_sided",
        ),
        Column(
            "weight_inflation",
            pl.Float64,
            "",
            "Factor on standard errors that robust weights ask for; 1 without them",
        ),
        Column(
            "is_refitted",
            pl.Boolean,
            "",
            "Fitted anew from its statistics after a change of settings, without its log: what "
            "needs samples (`sensitivities`, `starts`, `predictions`, `residual_tests`, ± from "
            "tolerances, correlation_time_s, n_effective, delays) is of the settings before",
        ),
        Column(
            "training_mean_error_l_per_min",
            pl.Float64,
            "l/min",
            "Mean of measured less predicted flow on the training samples",
        ),
        Column(
            "validation_mean_error_l_per_min",
            pl.Float64,
            "l/min",
            "The same on the validation samples",
        ),
        Column(
            "previous_model_rmse_l_per_min",
            pl.Float64,
            "l/min",
            "Root mean squared error of the motor's model before, on all of tonight's samples",
        ),
        Column(
            "previous_model_mean_error_l_per_min",
            pl.Float64,
            "l/min",
            "Mean of measured flow less that of the motor's model before, on all of tonight's "
            "samples",
        ),
        Column(
            "n_effective_summed",
            pl.Float64,
            "",
            "As n_effective, by the sum of all correlations: N/(1 + 2Σρ(k)); smaller where white "
            "noise hides a slow error; null where the errors remember longer than can be told",
        ),
        Column("validation_n_effective", pl.Float64, "", "n_effective of the validation samples"),
        Column(
            "validation_n_effective_summed",
            pl.Float64,
            "",
            "n_effective_summed of the validation samples",
        ),
        Column(
            "training_whiteness",
            pl.String,
            "",
            "Whether the unsmoothed training errors tell of one another: passed, failed or "
            "not_tested; see residual_verdicts",
        ),
        Column(
            "training_independence",
            pl.String,
            "",
            "Whether an input tells of the unsmoothed training errors: failed if any does",
        ),
        Column("validation_whiteness", pl.String, "", "The same of the validation errors"),
        Column("validation_independence", pl.String, "", "The same of the validation errors"),
    ),
)

PARAMETERS = Table(
    "parameters",
    "a fit, a parameter",
    (*FIT_KEY_NAMES, "parameter"),
    (
        *FIT_KEY,
        Column(
            "parameter",
            pl.String,
            "",
            "K_, h_, e_, share_ or film_thickness_ratio_ and the path's name; C_f for the flushing",
        ),
        Column("value", pl.Float64, "see unit", "Estimate; null where only a range is known"),
        Column("unit", pl.String, "", "m3, um, l_per_min or 1"),
        Column("lower", pl.Float64, "see unit", "Lower end of the 95 % interval"),
        Column("upper", pl.Float64, "see unit", "Upper end of the 95 % interval"),
        Column("bootstrap_lower", pl.Float64, "see unit", "The same by a block bootstrap"),
        Column("bootstrap_upper", pl.Float64, "see unit", "The same by a block bootstrap"),
        Column("systematic", pl.Float64, "see unit", "± from stated tolerances"),
        Column("feasible_min", pl.Float64, "see unit", "Least value that the K allows"),
        Column("feasible_max", pl.Float64, "see unit", "Largest value that the K allows"),
        Column(
            "verdict",
            pl.String,
            "",
            "identified, only_in_combination, not_excited, at_bound, fixed or too_little_data; of "
            "shares as reference_verdict",
        ),
        Column("reason", pl.String, "", "The verdict in words"),
        Column(
            "spread_over_starts",
            pl.Float64,
            "see unit",
            "Largest minus smallest value over the starts at the minimum",
        ),
        RUN_ID,
        Column(
            "geometry_is_placeholder",
            pl.Boolean,
            "",
            "The value is made from a placeholder of the path's geometry and means nothing; null "
            "where no geometry is in it, and in rows of before version 3",
        ),
    ),
)

SENSITIVITIES = Table(
    "sensitivities",
    "a fit, an indicator, a source of systematic error",
    (*FIT_KEY_NAMES, "indicator", "source"),
    (
        *FIT_KEY,
        Column(
            "indicator",
            pl.String,
            "",
            "A coefficient, reference_leakage or own_conditions_leakage",
        ),
        Column("source", pl.String, "", "A channel's offset or gain, or a constant"),
        Column("tolerance", pl.Float64, "see tolerance_unit", "Assumed error, as stated"),
        Column("tolerance_unit", pl.String, "", "bar, °C, rpm, l_per_min, or 1: a relative one"),
        Column("effect", pl.Float64, "see unit", "Change of the indicator, signed"),
        Column("unit", pl.String, "", "m3, l_per_min or 1"),
        RUN_ID,
    ),
)

STARTS = Table(
    "starts",
    "a fit, a start",
    (*FIT_KEY_NAMES, "start"),
    (
        *FIT_KEY,
        Column("start", pl.Int64, "", "0 is the configured starting point"),
        Column("cost", pl.Float64, "(l/min)²", "Criterion V (20) where the search ended"),
        Column("status", pl.String, "", "The tolerance that was met, iteration_limit or failed"),
        Column("reason", pl.String, "", "In words"),
        Column("iterations", pl.Int64, "", "Evaluations of the criterion"),
        Column("at_minimum", pl.Boolean, "", "Within 1e-4 of the certificate's criterion"),
        Column("parameters", NAMES, "", "Names of the free parameters"),
        Column("initial_values", NUMBERS, "µm, 1, l/min", "In that order"),
        Column("final_values", NUMBERS, "µm, 1, l/min", "In that order"),
        RUN_ID,
    ),
)

PART_OF_RESIDUALS = (
    Column("part", pl.String, "", "training, validation or guard"),
    Column(
        "smoothed", pl.Boolean, "", "On the smoothed columns, as the fit; else before smoothing"
    ),
    Column("test", pl.String, "", "whiteness: autocorrelation (27); independence: (26)"),
    Column(
        "input",
        pl.String,
        "",
        "pressure_difference and speed (magnitudes), oil_temperature; none for whiteness",
    ),
)
RESIDUAL_KEY_NAMES = (*FIT_KEY_NAMES, "part", "smoothed", "test", "input")

RESIDUAL_TESTS = Table(
    "residual_tests",
    "a fit, a part, a test (and input), a lag",
    (*RESIDUAL_KEY_NAMES, "lag"),
    (
        *FIT_KEY,
        *PART_OF_RESIDUALS,
        Column("lag", pl.Int64, "", "In samples; positive: past input on present error"),
        Column("lag_s", pl.Float64, "s", "The same as time"),
        Column(
            "value",
            pl.Float64,
            "",
            "Correlation, over pairs of samples without a gap between them; null where they are "
            "too few",
        ),
        Column(
            "bound",
            pl.Float64,
            "",
            "99 % of the correlations of independent errors lie within ± this; null at lag 0 of "
            "whiteness",
        ),
        Column("outside", pl.Boolean, "", "The correlation is larger than its bound"),
        RUN_ID,
    ),
)

RESIDUAL_VERDICTS = Table(
    "residual_verdicts",
    "a fit, a part, a test (and input)",
    RESIDUAL_KEY_NAMES,
    (
        *FIT_KEY,
        *PART_OF_RESIDUALS,
        Column(
            "verdict",
            pl.String,
            "",
            "failed where p_value is below 0.01, else passed; not_tested",
        ),
        Column("reason", pl.String, "", "Why it was not tested; null where it was"),
        Column("n", pl.Int64, "", "Samples"),
        Column(
            "mean_error_l_per_min",
            pl.Float64,
            "l/min",
            "Mean of measured less predicted flow, which the tests leave out",
        ),
        Column(
            "statistic",
            pl.Float64,
            "",
            "Of all lags together: Ljung and Box's Q, or the squares of the correlations over "
            "their covariances",
        ),
        Column("degrees_of_freedom", pl.Int64, "", "Of the statistic's chi-square distribution"),
        Column(
            "p_value",
            pl.Float64,
            "",
            "Probability that independent errors give a larger statistic by chance",
        ),
        Column("n_lags", pl.Int64, "", "Lags with a bound"),
        Column("n_outside", pl.Int64, "", "Lags whose correlation is larger than its bound"),
        Column(
            "n_expected_outside",
            pl.Float64,
            "",
            "How many of independent errors would be, on average: one in a hundred",
        ),
        Column("largest_value", pl.Float64, "", "The correlation that is largest in size"),
        Column("largest_lag", pl.Int64, "", "Its lag, in samples"),
        Column("largest_lag_s", pl.Float64, "s", "Its lag as time"),
        RUN_ID,
    ),
)

PREDICTIONS = Table(
    "predictions",
    "a fit, a point in time (thinned for plots: extremes are kept, so means are not the night's)",
    (*FIT_KEY_NAMES, "time"),
    (
        *FIT_KEY,
        Column("time", TIMESTAMP, "UTC", "Time of the sample"),
        Column("part", pl.String, "", "training, validation or guard"),
        Column("pressure_difference_bar", pl.Float64, "bar", "Magnitude"),
        Column("oil_temperature_c", pl.Float64, "°C", "Oil temperature"),
        Column("speed_rpm", pl.Float64, "rpm", "Magnitude"),
        Column("measured_l_per_min", pl.Float64, "l/min", "Measured drain flow"),
        Column("predicted_l_per_min", pl.Float64, "l/min", "Drain flow of the fitted model"),
        RUN_ID,
    ),
)

# Reasons of `quality`, in the order of the rules; those behind `transport_delay` are of the time
# base, where all channels have come together, or of the night's windows.
QUALITY_REASONS: Mapping[str, str] = {
    "missing": "A blank cell where the channel's own period says that a sample is due",
    "bad_quality": "The log itself does not call the sample good",
    "not_finite": "Not a number, or infinite",
    "no_interval": "A count of which the interval is not known: the first, or behind a gap",
    "counter_reset": "A running total that fell other than by rolling over",
    "out_of_range": "Outside the channel's valid range",
    "at_maximum": "The sensor at its maximum, as the drain flow's under back-flow",
    "spike": "Too far from the median of its neighbourhood (Hampel filter)",
    "frozen": "No change beyond the sensor's resolution for too long",
    "backward_time": "A time before that of the sample before; noted: put back in its place",
    "duplicate_time": "The time of the sample before once more",
    "jitter": "Never refused; noted: neither one nor several periods after the sample before",
    "gap": "Times of the time base at which the channel is silent for too long",
    "transport_delay": "No inputs are known from as long before as the oil takes to the sensor",
    "standstill": "The motor does not turn",
    "guard": "Too soon before or after a standstill or a sensor at its maximum",
    "transient": "Pressure or speed changes too fast",
    "incomplete": "A channel has no sample there, for whatever reason",
    "thin_block": "Kept, but in a block of which too few are",
    "short_stretch": "Kept, but in a stretch between two gaps that is too short to fit",
    "outside_periods": "Kept, but outside the periods that are set by hand",
    "any": "Refused by at least one rule: each sample once",
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
    "and gap_change_ with the path's name, C_f, pressure_zero or flow_zero",
)

TRENDS = Table(
    "trends",
    "a motor, a night, an indicator",
    ("motor_id", "night", "indicator"),
    (
        MOTOR_ID,
        NIGHT,
        INDICATOR,
        Column("value", pl.Float64, "see unit", "The night's figure; null where gated"),
        Column("unit", pl.String, "", "l/min, m3, %, bar or 1"),
        Column("lower", pl.Float64, "see unit", "Lower end of its 95 % interval"),
        Column("upper", pl.Float64, "see unit", "Upper end of its 95 % interval"),
        Column("n_nights", pl.Int64, "", "Nights that were fitted together for it"),
        Column("gated_reason", pl.String, "", "Why the night does not count; null where it does"),
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
            "ok (no change of external leakage), warning, alarm, common_cause, stale or "
            "insufficient",
        ),
        Column("state_reason", pl.String, "", "The state in words; null where ok"),
        Column("path", pl.String, "", "Path whose growth explains the change; null: none does"),
        Column("path_probability", pl.Float64, "", "That it does, given the fits' covariance"),
        Column("path_reason", pl.String, "", "Why paths cannot be told apart"),
        Column("limit", pl.Float64, "see unit", "The limit that the days count to"),
        Column("days_to_limit", pl.Float64, "d", "Until the limit, at the slope per year"),
        Column("days_to_limit_lower", pl.Float64, "d", "Lower end of its Fieller set"),
        Column("days_to_limit_upper", pl.Float64, "d", "Upper end; null where it has none"),
        Column(
            "days_to_limit_status",
            pl.String,
            "",
            "finite, no_trend, already_crossed, beyond_horizon, unbounded or insufficient",
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
            "Into a warning or an alarm: level, change (cumulative sum), both, jump (a sudden "
            "change that no event explains) or drift (of a sensor's zero); stale; common_cause; "
            "baseline; recovered; recomputed: what was told before is not in the figures now",
        ),
        Column("path", pl.String, "", "Path whose growth explains the change"),
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
    ),
)

INPUT_FILES = Table(
    "input_files",
    "a file read",
    ("motor_id", "path"),
    (
        MOTOR_ID,
        Column("path", pl.String, "", "Relative to the log root"),
        NIGHT,
        Column("format", pl.String, "", "csv, parquet or mcap"),
        Column("size_bytes", pl.Int64, "B", "Size"),
        Column("sha256", pl.String, "", "Hash of the content; null where it could not be read"),
        Column("rows", pl.Int64, "", "Rows or messages"),
        Column("first_time", TIMESTAMP, "UTC", "First sample"),
        Column("last_time", TIMESTAMP, "UTC", "Last sample"),
        Column("status", pl.String, "", "ok or failed"),
        Column("error_code", pl.String, "", "Stable code of the failure"),
        Column("message", pl.String, "", "The failure, or what was left out, in words"),
        RUN_ID,
    ),
)

RUNS = Table(
    "runs",
    "a run",
    ("run_id", "started_at"),
    (
        RUN_ID,
        Column("started_at", TIMESTAMP, "UTC", "Start of the run"),
        Column("finished_at", TIMESTAMP, "UTC", "End of the run"),
        Column("status", pl.String, "", "ok, motors_failed or interrupted"),
        Column("fleet", pl.String, "", "Name of the fleet"),
        Column("version", pl.String, "", "Version of motor-leakage"),
        Column("schema_version", pl.Int64, "", "Version of the tables"),
        Column("config_hash", pl.String, "", "Hash of all settings that shape figures"),
        Column("seed", pl.Int64, "", "Seed of the run"),
        Column("workers", pl.Int64, "", "Motors fitted at the same time"),
        Column("n_motors", pl.Int64, "", "Motors in the run"),
        Column("n_motors_failed", pl.Int64, "", "Motors with at least one failed night"),
        Column("n_nights", pl.Int64, "", "Nights of motors that were written"),
        Column("seconds", pl.Float64, "s", "Wall-clock time"),
    ),
)

MOTOR_OUTCOMES = Table(
    "motor_outcomes",
    "a motor in a run",
    ("run_id", "started_at", "motor_id"),
    (
        RUN_ID,
        Column("started_at", TIMESTAMP, "UTC", "Start of the run"),
        MOTOR_ID,
        Column(
            "status",
            pl.String,
            "",
            "failed if a night failed; else ok if a night was fitted; else what came of its nights",
        ),
        Column("error_code", pl.String, "", "Code of the first failure"),
        Column(
            "message",
            pl.String,
            "",
            "The first failure in words, with its file or night; without a failure, why nothing "
            "could be fitted, or null",
        ),
        Column("n_ok", pl.Int64, "", "Nights with a fit"),
        Column("n_stood_still", pl.Int64, "", "Nights in which the motor stood still"),
        Column("n_insufficient_data", pl.Int64, "", "Nights with too little to fit"),
        Column("n_no_new_data", pl.Int64, "", "Nights without a log"),
        Column("n_failed", pl.Int64, "", "Nights that failed"),
        Column("read_s", pl.Float64, "s", "Seconds for finding, hashing and reading logs"),
        Column("clean_s", pl.Float64, "s", "Seconds for cleaning and the time base"),
        Column("statistics_s", pl.Float64, "s", "Seconds for regressors and blocks"),
        Column("fit_s", pl.Float64, "s", "Seconds for certificate, search and validation"),
        Column("store_s", pl.Float64, "s", "Seconds for staging the rows"),
        Column("peak_memory_mib", pl.Float64, "MiB", "Largest memory of the worker so far"),
        Column("n_refitted", pl.Int64, "", "Nights fitted anew from statistics, without a log"),
        Column("refit_s", pl.Float64, "s", "Seconds for that"),
        Column("growing", NAMES, "", "Log files that were changed while they were read, in words"),
        Column("n_files_read", pl.Int64, "", "Log files that were read"),
        Column("n_files_unchanged", pl.Int64, "", "Log files done by a run before, and not read"),
        Column(
            "n_files_growing",
            pl.Int64,
            "",
            "Log files that were changed while they were read: left to the next run, and with them "
            "their nights",
        ),
        Column("n_files_failed", pl.Int64, "", "Log files that cannot be read"),
        Column(
            "n_files_left",
            pl.Int64,
            "",
            "New log files of nights that were not asked for, or that wait for a growing file",
        ),
    ),
)

DATA_DICTIONARY = Table(
    "data_dictionary",
    "a column of a table",
    ("table", "column"),
    (
        Column("table", pl.String, "", "The table"),
        Column("column", pl.String, "", "The column"),
        Column("type", pl.String, "", "Type, as Polars names it"),
        Column("unit", pl.String, "", "Unit; empty for none"),
        Column("description", pl.String, "", "Meaning"),
        Column("in_key", pl.Boolean, "", "Whether the column is part of the table's key"),
        Column("schema_version", pl.Int64, "", "Version of the tables"),
    ),
)

# One file a night; a redone night of a motor replaces that motor's rows in each of them.
NIGHT_TABLES = (
    FITS,
    PARAMETERS,
    SENSITIVITIES,
    STARTS,
    RESIDUAL_TESTS,
    RESIDUAL_VERDICTS,
    PREDICTIONS,
    QUALITY,
    OPERATION,
    BLOCK_STATISTICS,
    INPUT_FILES,
)
# The same, made from the tables above after all motors are done.
TREND_TABLES = (TRENDS, ALARMS, BASELINES, CHANGE_POINTS)
TABLES = (*NIGHT_TABLES, *TREND_TABLES, DECISIONS, RUNS, MOTOR_OUTCOMES, DATA_DICTIONARY)


def frame(table: Table, rows: Iterable[Mapping[str, Any]], *, without: str = "") -> pl.DataFrame:
    """Rows as a frame with exactly the table's columns and types; absent values are null.

    Parameters
    ----------
    table
        The table.
    rows
        Column names to values.
    without
        A column that is added later.

    Raises
    ------
    ValueError
        If a row has a column that the table has not: a figure would be lost silently.
    """
    schema = {name: kind for name, kind in table.schema.items() if name != without}
    rows = list(rows)
    strangers = {name for row in rows for name in row} - schema.keys()
    if strangers:
        raise ValueError(f"{table.name} has no column {', '.join(sorted(strangers))}")
    return pl.DataFrame(rows, schema=schema, orient="row", strict=True)


def data_dictionary() -> pl.DataFrame:
    """The table `data_dictionary`: every column of every table."""
    return frame(
        DATA_DICTIONARY,
        [
            {
                "table": table.name,
                "column": column.name,
                "type": str(column.type if isinstance(column.type, pl.DataType) else column.type()),
                "unit": column.unit,
                "description": column.description,
                "in_key": column.name in table.key,
                "schema_version": SCHEMA_VERSION,
            }
            for table in TABLES
            for column in table.columns
        ],
    )
