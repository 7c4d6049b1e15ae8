"""Tables of what a fit leaves unexplained: residual tests, and predictions beside the flow."""

from __future__ import annotations

import polars as pl

from pipeline.schema.columns import (
    FIT_KEY,
    FIT_KEY_NAMES,
    RUN_ID,
    TIMESTAMP,
    Column,
    Table,
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
