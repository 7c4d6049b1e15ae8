"""Tables of what a fit leaves unexplained: residual tests, and predictions beside the flow."""

from __future__ import annotations

from pipeline.schema.columns import (
    FIT_KEY,
    FIT_KEY_NAMES,
    RUN_ID,
    Table,
    count,
    flag,
    moment,
    number,
    text,
)

PART_OF_RESIDUALS = (
    text("part", "training, validation or guard"),
    flag("smoothed", "On the smoothed columns, as the fit; else before smoothing"),
    text("test", "whiteness: autocorrelation (27); independence: (26)"),
    text(
        "input", "pressure_difference and speed (magnitudes), oil_temperature; none for whiteness"
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
        count("lag", "In samples; positive: past input on present error"),
        number("lag_s", "s", "The same as time"),
        number(
            "value",
            "",
            "Correlation, over pairs of samples without a gap between them; null where they are "
            "too few",
        ),
        number(
            "bound",
            "",
            "99 % of the correlations of independent errors lie within ± this; null at lag 0 of "
            "whiteness",
        ),
        flag("outside", "The correlation is larger than its bound"),
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
        text("verdict", "failed where p_value is below 0.01, else passed; not_tested"),
        text("reason", "Why it was not tested; null where it was"),
        count("n", "Samples"),
        number(
            "mean_error_l_per_min",
            "l/min",
            "Mean of measured less predicted flow, which the tests leave out",
        ),
        number(
            "statistic",
            "",
            "Of all lags together: Ljung and Box's Q, or the squares of the correlations over "
            "their covariances",
        ),
        count("degrees_of_freedom", "Of the statistic's chi-square distribution"),
        number(
            "p_value", "", "Probability that independent errors give a larger statistic by chance"
        ),
        count("n_lags", "Lags with a bound"),
        count("n_outside", "Lags whose correlation is larger than its bound"),
        number(
            "n_expected_outside",
            "",
            "How many of independent errors would be, on average: one in a hundred",
        ),
        number("largest_value", "", "The correlation that is largest in size"),
        count("largest_lag", "Its lag, in samples"),
        number("largest_lag_s", "s", "Its lag as time"),
        RUN_ID,
    ),
)

PREDICTIONS = Table(
    "predictions",
    "a fit, a point in time (thinned for plots: extremes are kept, so means are not the night's)",
    (*FIT_KEY_NAMES, "time"),
    (
        *FIT_KEY,
        moment("time", "Time of the sample"),
        text("part", "training, validation or guard"),
        number("pressure_difference_bar", "bar", "Magnitude"),
        number("oil_temperature_c", "°C", "Oil temperature"),
        number("speed_rpm", "rpm", "Magnitude"),
        number("measured_l_per_min", "l/min", "Measured drain flow"),
        number("predicted_l_per_min", "l/min", "Drain flow of the fitted model"),
        RUN_ID,
    ),
)
