"""Tables of a night's fits: figures, parameters, systematic errors, starts."""

from __future__ import annotations

import polars as pl

from pipeline.schema.columns import (
    FIT_KEY,
    FIT_KEY_NAMES,
    FLUSHING_MODE,
    MOTOR_ID,
    NAMES,
    NIGHT,
    NUMBERS,
    RUN_ID,
    TIMESTAMP,
    Column,
    Table,
)

# Outcomes of a motor's night.
OK, STOOD_STILL, NO_NEW_DATA = "ok", "stood_still", "no_new_data"
INSUFFICIENT_DATA, FAILED = "insufficient_data", "failed"


def _interval(name: str, unit: str, what: str) -> tuple[Column, Column]:
    stem = name.removesuffix("_l_per_min")
    return (
        Column(f"{stem}_lower", pl.Float64, unit, f"Lower end of the 95 % interval of {what}"),
        Column(f"{stem}_upper", pl.Float64, unit, f"Upper end of the 95 % interval of {what}"),
    )


def _parts(prefix: str, unit: str) -> tuple[Column, ...]:
    return tuple(
        Column(f"{prefix}{name}_half_width", pl.Float64, unit, what)
        for name, what in (
            ("statistical", "± from the samples: half of the 95 % interval"),
            ("sensor", "± from tolerances of sensors, stated or assumed by their kind"),
            ("model", "± from the night's structured misfit; null where it is not known"),
            ("total", "± of all parts by their squares: of the figure itself; verdicts go by it"),
        )
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
        Column(
            "n_training",
            pl.Int64,
            "",
            "Samples of the fit that is validated; estimates and intervals are those of a fit to "
            "all kept samples",
        ),
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
        Column(
            "aic_effective",
            pl.Float64,
            "",
            "aic with n_effective in place of n_training; null where that is not above d",
        ),
        Column("aicc_effective", pl.Float64, "", "aicc with n_effective"),
        Column("bic_effective", pl.Float64, "", "bic with n_effective"),
        Column(
            "n_parameters",
            pl.Int64,
            "",
            "Rank of the regressors of the coefficients off their bounds: d of fpe, aic and bic",
        ),
        Column(
            "is_best_on_validation",
            pl.Boolean,
            "",
            "The night's mode of flushing with the highest validation fit",
        ),
        Column(
            "cost",
            pl.Float64,
            "(l/min)²",
            "Criterion V (20) at the published estimate, of all kept samples; where errors are "
            "slow, of whitened ones",
        ),
        Column(
            "certificate_gap",
            pl.Float64,
            "",
            "(V of the best start − V of the certificate) / V of the certificate; null without "
            "starts",
        ),
        Column(
            "dual_residual",
            pl.Float64,
            "",
            "Proof of the minimum: largest relative violation of the optimality conditions",
        ),
        Column("n_starts", pl.Int64, "", "Starting points of the search; 0 without one"),
        Column("n_starts_at_minimum", pl.Int64, "", "Starts within 1e-4 of the minimum"),
        Column("rank", pl.Int64, "", "Rank of the free regressors, columns scaled"),
        Column("condition_number", pl.Float64, "", "Of the free regressors, columns scaled"),
        Column("singular_values", NUMBERS, "", "Of the free regressors, columns scaled to norm 1"),
        Column("correlation_time_s", pl.Float64, "s", "Time over which the training errors forget"),
        Column(
            "interval_status",
            pl.String,
            "",
            "Begins with ok, then how long slow errors remember where they do; otherwise why the "
            "night has no intervals",
        ),
        Column("n_interval_blocks", pl.Int64, "", "Blocks behind the intervals"),
        Column(
            "reference_leakage_l_per_min",
            pl.Float64,
            "l/min",
            "Leakage of the fitted model at the reference conditions, flushing excluded; null "
            "unless identified, uncertain, extrapolated or fixed",
        ),
        *_interval("reference_leakage", "l/min", "the reference leakage"),
        Column("reference_leakage_systematic", pl.Float64, "l/min", "± from stated tolerances"),
        Column(
            "reference_verdict",
            pl.String,
            "",
            "identified (± 10 % at most, tolerances included), uncertain (25 %), extrapolated "
            "(12 %, at most 20 bar or 10 K beyond the night's range) or fixed; without a value: "
            "not_identified, outside_fitted_range or too_little_data",
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
            "null unless identified, uncertain or fixed",
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
            "Mean magnitude over the fitted samples",
        ),
        Column("own_temperature_c", pl.Float64, "°C", "Mean over the fitted samples"),
        Column("own_speed_rpm", pl.Float64, "rpm", "Mean magnitude over the fitted samples"),
        Column(
            "outside_fitted_range",
            pl.Boolean,
            "",
            "The reference conditions lie outside what the fitted samples saw",
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
            "needs samples (`sensitivities`, `predictions`, `residual_tests`, ± from tolerances, "
            "correlation_time_s, n_effective, delays) is of the settings before, and so are "
            "`starts` unless the run had `--with-starts`",
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
        Column(
            "slow_error_memory",
            pl.Float64,
            "",
            "ρ: correlation of the slow errors of neighbouring blocks of two minutes; 0: none",
        ),
        Column(
            "slow_error_ratio",
            pl.Float64,
            "",
            "λ: variance of the slow error over that of a block's mean without it",
        ),
        Column(
            "within_block_inflation",
            pl.Float64,
            "",
            "κ: variance that errors within a block act with, over their own",
        ),
        Column(
            "slow_error_evidence",
            pl.Float64,
            "",
            "−2 Δ log REML of no slow error; from 4 on, with ρ above 0, the fit allows for it",
        ),
        Column(
            "reference_degrees_of_freedom",
            pl.Float64,
            "",
            "Of the interval of the reference leakage; 2 are needed",
        ),
        Column(
            "reference_block_share",
            pl.Float64,
            "",
            "Share of what is known of it that rests on one single block; at most 0.5",
        ),
        Column(
            "model_misfit_statistics",
            NUMBERS,
            "",
            "Behind the misfit of several nights together: samples, sum of their leakage, score "
            "of γ; upper triangles of S, of the information on γ and of the score's covariance",
        ),
        *_parts("reference_leakage_", "l/min"),
        *_parts("own_conditions_leakage_", "l/min"),
        Column(
            "model_verdict",
            pl.String,
            "",
            "supported, doubtful (misfit above 0.68 %) or disproved (above 1.5 %); null where the "
            "night cannot tell: fewer than 20 blocks, or errors that would hide such a misfit",
        ),
        Column(
            "model_misfit_percent",
            pl.Float64,
            "%",
            "Structured misfit τ over the mean leakage: what goes with temperature, load and speed "
            "and the model does not describe",
        ),
        Column("model_noise_percent", pl.Float64, "%", "What noise alone would make of it"),
        Column("model_reason", pl.String, "", "Likely causes in order, and what to try"),
        Column(
            "coefficient_response",
            NUMBERS,
            "K m3, K l/min",
            "dθ/db: what a change of all loss factors by 1/K, over the temperatures of the night's "
            "blocks about their mean, would move the coefficients by",
        ),
        Column(
            "roller_is_free",
            pl.Boolean,
            "",
            "The fit estimates the scale of the cam rollers' curve, as speed varies in most of the "
            "baseline's first nights; starts, predictions, residual tests and the verdict on the "
            "model are then still those of the model as stated",
        ),
        Column(
            "roller_scale",
            pl.Float64,
            "1",
            "That scale, as the night tells it, whether or not the fit uses it; null where the "
            "known flow is not one curve",
        ),
        Column(
            "roller_scale_half_width",
            pl.Float64,
            "1",
            "Half-width of its 95 % interval; null unless identified",
        ),
        Column("roller_verdict", pl.String, "", "As `verdict` in `parameters`"),
        Column(
            "viscosity_ratio",
            pl.Float64,
            "1",
            "Viscosity as measured, by the log or by analyses, over that of the data sheet: what "
            "the fit went by; null where the data sheet holds",
        ),
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
            "identified, uncertain (by its total ±), only_in_combination, not_excited, at_bound, "
            "fixed or too_little_data; of shares as reference_verdict",
        ),
        Column("reason", pl.String, "", "The verdict in words"),
        Column(
            "spread_over_starts",
            pl.Float64,
            "see unit",
            "Largest minus smallest value over the starts at the minimum; null without a search",
        ),
        RUN_ID,
        Column(
            "geometry_is_placeholder",
            pl.Boolean,
            "",
            "The value is made from a placeholder of the path's geometry and means nothing; null "
            "where no geometry is in it, and in rows of before version 3",
        ),
        Column(
            "interval_degrees_of_freedom",
            pl.Float64,
            "",
            "Of a coefficient's interval; 4 are needed; null of other parameters",
        ),
        Column(
            "largest_block_share",
            pl.Float64,
            "",
            "Share of what is known of a coefficient that rests on one block; at most 0.5",
        ),
        *_parts("", "see unit"),
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
        Column(
            "assumed_sensor",
            pl.String,
            "",
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
