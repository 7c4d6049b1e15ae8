"""Table of a night's fits, and the outcomes of a motor's night."""

from __future__ import annotations

from pipeline.schema.columns import (
    FIT_KEY_NAMES,
    FLUSHING_MODE,
    MOTOR_ID,
    NAMES,
    NIGHT,
    NUMBERS,
    RUN_ID,
    Column,
    Table,
    count,
    flag,
    half_widths,
    moment,
    number,
    text,
)

# Outcomes of a motor's night.
OK, STOOD_STILL, NO_NEW_DATA = "ok", "stood_still", "no_new_data"
INSUFFICIENT_DATA, FAILED = "insufficient_data", "failed"


def _interval(name: str, unit: str, what: str) -> tuple[Column, Column]:
    stem = name.removesuffix("_l_per_min")
    return (
        number(f"{stem}_lower", unit, f"Lower end of the 95 % interval of {what}"),
        number(f"{stem}_upper", unit, f"Upper end of the 95 % interval of {what}"),
    )


FITS = Table(
    "fits",
    "a motor, a night, a flushing mode",
    FIT_KEY_NAMES,
    (
        MOTOR_ID,
        text("motor_type", "The motor's type"),
        NIGHT,
        moment("window_start", "First sample that was used; null without a fit"),
        moment("window_end", "Last sample that was used; null without a fit"),
        FLUSHING_MODE,
        flag("is_primary", "The configured mode: exactly one a night"),
        text(
            "status",
            "ok, stood_still, no_new_data (no log covers the night), insufficient_data or failed",
        ),
        text("reason", "Why there is no fit, in words; null where status is ok"),
        text("error_code", "Stable code of the failure; null unless failed"),
        count(
            "n_training",
            "Samples of the fit that is validated; estimates and intervals are those of a fit to "
            "all kept samples",
        ),
        count("n_validation", "Samples that it was validated on"),
        number("training_fit_percent", "%", "Fit (23) on the training samples"),
        number(
            "validation_fit_percent",
            "%",
            "Fit (23) on the validation samples; negative where worse than their mean; null where "
            "the flow has no shape to fit",
        ),
        number(
            "previous_model_fit_percent",
            "%",
            "Fit (23) of the motor's model before, on all of tonight's samples",
        ),
        number("training_rmse_l_per_min", "l/min", "Root mean squared error"),
        number("validation_rmse_l_per_min", "l/min", "Root mean squared error"),
        number("smoothing_s", "s", "Length of the moving average; 0: none"),
        number("fpe", "(l/min)²", "Final prediction error (25)"),
        number("aic", "", "Akaike's information criterion"),
        number("aicc", "", "The same, corrected for small samples"),
        number("bic", "", "Bayesian information criterion"),
        number(
            "n_effective",
            "",
            "Training samples that would carry as much if their errors were independent: "
            "N(1−φ)/(1+φ), φ the lag-one correlation",
        ),
        number("lag_one_autocorrelation", "", "Of the training errors, φ of n_effective"),
        number(
            "aic_effective",
            "",
            "aic with n_effective in place of n_training; null where that is not above d",
        ),
        number("aicc_effective", "", "aicc with n_effective"),
        number("bic_effective", "", "bic with n_effective"),
        count(
            "n_parameters",
            "Rank of the regressors of the coefficients off their bounds: d of fpe, aic and bic",
        ),
        flag(
            "is_best_on_validation", "The night's mode of flushing with the highest validation fit"
        ),
        number(
            "cost",
            "(l/min)²",
            "Criterion V (20) at the published estimate, of all kept samples; where errors are "
            "slow, of whitened ones",
        ),
        number(
            "certificate_gap",
            "",
            "(V of the best start − V of the certificate) / V of the certificate; null without "
            "starts",
        ),
        number(
            "dual_residual",
            "",
            "Proof of the minimum: largest relative violation of the optimality conditions",
        ),
        count("n_starts", "Starting points of the search; 0 without one"),
        count("n_starts_at_minimum", "Starts within 1e-4 of the minimum"),
        count("rank", "Rank of the free regressors, columns scaled"),
        number("condition_number", "", "Of the free regressors, columns scaled"),
        Column("singular_values", NUMBERS, "", "Of the free regressors, columns scaled to norm 1"),
        number("correlation_time_s", "s", "Time over which the training errors forget"),
        text(
            "interval_status",
            "Begins with ok, then how long slow errors remember where they do; otherwise why the "
            "night has no intervals",
        ),
        count("n_interval_blocks", "Blocks behind the intervals"),
        number(
            "reference_leakage_l_per_min",
            "l/min",
            "Leakage of the fitted model at the reference conditions, flushing excluded; null "
            "unless identified, uncertain, extrapolated or fixed",
        ),
        *_interval("reference_leakage", "l/min", "the reference leakage"),
        number("reference_leakage_systematic", "l/min", "± from stated tolerances"),
        text(
            "reference_verdict",
            "identified (± 10 % at most, tolerances included), uncertain (25 %), extrapolated (12 "
            "%, at most 20 bar or 10 K beyond the night's range) or fixed; without a value: "
            "not_identified, outside_fitted_range or too_little_data",
        ),
        text("reference_reason", "The verdict in words; null where identified"),
        number("reference_pressure_bar", "bar", "Reference conditions"),
        number("reference_temperature_c", "°C", "Reference conditions"),
        number("reference_speed_rpm", "rpm", "Reference conditions"),
        number(
            "own_conditions_leakage_l_per_min",
            "l/min",
            "Leakage of the fitted model at the night's own mean conditions, flushing excluded; "
            "null unless identified, uncertain or fixed",
        ),
        *_interval("own_conditions_leakage", "l/min", "the leakage at own conditions"),
        number("own_conditions_leakage_systematic", "l/min", "± from stated tolerances"),
        text("own_conditions_verdict", "As reference_verdict"),
        text("own_conditions_reason", "The verdict in words"),
        number("own_pressure_bar", "bar", "Mean magnitude over the fitted samples"),
        number("own_temperature_c", "°C", "Mean over the fitted samples"),
        number("own_speed_rpm", "rpm", "Mean magnitude over the fitted samples"),
        flag(
            "outside_fitted_range",
            "The reference conditions lie outside what the fitted samples saw",
        ),
        number("mean_flow_l_per_min", "l/min", "Mean measured drain flow"),
        number("kept_share", "", "Share of the running motor's samples that was kept"),
        text("film_pressure", "thesis (with its share) or slot"),
        flag("two_sided", "Paths leak from both sides to the case"),
        text("loss", "squared or huber"),
        text("oil", "The night's oil"),
        text("model_hash", "Hash of all that shapes the statistics"),
        RUN_ID,
        number(
            "transport_delay_s",
            "s",
            "Mean delay (14) that the samples were paired with; null where it is off",
        ),
        number(
            "estimated_transport_delay_s",
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
        count("n_kept", "Kept samples of the night, of all parts"),
        number("sample_period_s", "s", "Period of the time base"),
        number(
            "mean_charge_over_case_bar",
            "bar",
            "Mean charge above case pressure; null unless two_sided",
        ),
        number(
            "weight_inflation",
            "",
            "Factor on standard errors that robust weights ask for; 1 without them",
        ),
        flag(
            "is_refitted",
            "Fitted anew from its statistics after a change of settings, without its log: what "
            "needs samples (`sensitivities`, `predictions`, `residual_tests`, ± from tolerances, "
            "correlation_time_s, n_effective, delays) is of the settings before, and so are "
            "`starts` unless the run had `--with-starts`",
        ),
        number(
            "training_mean_error_l_per_min",
            "l/min",
            "Mean of measured less predicted flow on the training samples",
        ),
        number("validation_mean_error_l_per_min", "l/min", "The same on the validation samples"),
        number(
            "previous_model_rmse_l_per_min",
            "l/min",
            "Root mean squared error of the motor's model before, on all of tonight's samples",
        ),
        number(
            "previous_model_mean_error_l_per_min",
            "l/min",
            "Mean of measured flow less that of the motor's model before, on all of tonight's "
            "samples",
        ),
        number(
            "n_effective_summed",
            "",
            "As n_effective, by the sum of all correlations: N/(1 + 2Σρ(k)); smaller where white "
            "noise hides a slow error; null where the errors remember longer than can be told",
        ),
        number("validation_n_effective", "", "n_effective of the validation samples"),
        number("validation_n_effective_summed", "", "n_effective_summed of the validation samples"),
        text(
            "training_whiteness",
            "Whether the unsmoothed training errors tell of one another: passed, failed or "
            "not_tested; see residual_verdicts",
        ),
        text(
            "training_independence",
            "Whether an input tells of the unsmoothed training errors: failed if any does",
        ),
        text("validation_whiteness", "The same of the validation errors"),
        text("validation_independence", "The same of the validation errors"),
        number(
            "slow_error_memory",
            "",
            "ρ: correlation of the slow errors of neighbouring blocks of two minutes; 0: none",
        ),
        number(
            "slow_error_ratio",
            "",
            "λ: variance of the slow error over that of a block's mean without it",
        ),
        number(
            "within_block_inflation",
            "",
            "κ: variance that errors within a block act with, over their own",
        ),
        number(
            "slow_error_evidence",
            "",
            "−2 Δ log REML of no slow error; from 4 on, with ρ above 0, the fit allows for it",
        ),
        number(
            "reference_degrees_of_freedom",
            "",
            "Of the interval of the reference leakage; 2 are needed",
        ),
        number(
            "reference_block_share",
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
        *half_widths("reference_leakage_", "l/min"),
        *half_widths("own_conditions_leakage_", "l/min"),
        text(
            "model_verdict",
            "supported, doubtful (misfit above 0.68 %) or disproved (above 1.5 %); null where the "
            "night cannot tell: fewer than 20 blocks, or errors that would hide such a misfit",
        ),
        number(
            "model_misfit_percent",
            "%",
            "Structured misfit τ over the mean leakage: what goes with temperature, load and speed "
            "and the model does not describe",
        ),
        number("model_noise_percent", "%", "What noise alone would make of it"),
        text("model_reason", "Likely causes in order, and what to try"),
        Column(
            "coefficient_response",
            NUMBERS,
            "K m3, K l/min",
            "dθ/db: what a change of all loss factors by 1/K, over the temperatures of the night's "
            "blocks about their mean, would move the coefficients by",
        ),
        flag(
            "roller_is_free",
            "The fit estimates the scale of the cam rollers' curve, as speed varies in most of the "
            "baseline's first nights; starts, predictions, residual tests and the verdict on the "
            "model are then still those of the model as stated",
        ),
        number(
            "roller_scale",
            "1",
            "That scale, as the night tells it, whether or not the fit uses it; null where the "
            "known flow is not one curve",
        ),
        number(
            "roller_scale_half_width",
            "1",
            "Half-width of its 95 % interval; null unless identified",
        ),
        text("roller_verdict", "As `verdict` in `parameters`"),
        number(
            "viscosity_ratio",
            "1",
            "Viscosity as measured, by the log or by analyses, over that of the data sheet: what "
            "the fit went by; null where the data sheet holds",
        ),
        Column(
            "coefficient_covariance_root",
            NUMBERS,
            "m3, l/min",
            "Upper triangle of U, row by row, with U'U the coefficient_covariance: |U c| is the "
            "standard error of a combination c, also where paths look alike and rounding leaves "
            "nothing of it in the covariance",
        ),
    ),
)
