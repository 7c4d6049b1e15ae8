"""Statistical choices behind the estimates, verdicts and intervals of one night.

What a night's own data can tell is estimated: noise, its memory and size, whether it adds or
scales, misfit, degrees of freedom. What is left is chosen here, each with its reason; simulated
means the nights of model.md, sections 5 and 8, and of `benchmarks/results/coverage.md`.
"""

from __future__ import annotations

# Slow errors (`slow_errors`).
# Grid of the restricted likelihood: memory from block to block, and variance over that of a mean.
MEMORIES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.995)
RATIOS = tuple(10.0 ** (half / 2) for half in range(-2, 10))
# −2 Δ log REML from which on slow errors are taken for real: what AIC asks for two parameters.
EVIDENCE = 4.0
# Factor on half-widths that makes up for ρ and λ being estimates: simulated coverage.
WIDENING = 1.25
# Largest variance of a slow error, over that of the means' errors under least squares: a larger one
# would throw away what the means say of the level, and doubled the error of the leakage.
LARGEST_SLOW = 4.0
# Neighbouring samples act at most as one in three, or nothing within a block could tell.
LEAST_WITHIN = 3.0
# Fewer blocks tell nothing of a memory.
LEAST_BLOCKS = 5

# Misfit (`misfit`).
# Half-widths that a misfit adds, over what it can do, of a leakage and of a coefficient: so large
# that intervals held under wrong films, oils and rollers.
LEAKAGE_FACTOR = 2.0
COEFFICIENT_FACTOR = 2.5
# A misfit is clear where it is this much larger than what noise explains.
CLEAR = 2.0
# Blocks for each coefficient that a covariance takes.
BLOCKS_A_COEFFICIENT = 2.0

# Verdicts (`identifiability`).
# Half-width over K, and √VIF: beyond, a figure would be read for more than it says.
WIDEST_COEFFICIENT = 0.5
LARGEST_ROOT_VIF = 100.0
# Half-width over the leakage, statistical and systematic together, of each verdict.
WIDEST_IDENTIFIED = 0.10
WIDEST_UNCERTAIN = 0.25
WIDEST_EXTRAPOLATED = 0.12
# Distance from what the samples saw over which a leakage is extrapolated [bar, K], with simulated
# coverage of 91 to 98 %; not over speed, which only a known curve follows.
FARTHEST = {"pressure": 20.0, "temperature": 10.0, "speed": 0.0}
# Least span of pressure for telling gaps apart that differ in their deformation.
LEAST_PRESSURE_SPAN_BAR = 20.0
# A combination of which one block tells more than this, or that has fewer degrees of freedom, has
# no credible interval: with 3 degrees of freedom 92 % of the simulated ones of a loss factor held
# the truth, as the limit of their width selects lucky nights. A leakage is far below its limit:
# with 2, 94 to 97 % held.
LARGEST_BLOCK_SHARE = 0.5
LEAST_FREEDOM = 4.0
LEAST_FREEDOM_LEAKAGE = 2.0

# Residual analysis (`residual_analysis`).
# Lags that are looked at: −25 to 25 of cross-correlations, 1 to 25 of the autocorrelation, as the
# thesis draws them; half-width of a normal 99 % band, and the probability beyond it.
LONGEST_LAG = 25
BAND, LEVEL = 2.576, 0.01
# Variances are summed over the first of these numbers of lags within which the correlations of the
# errors come to an end, or over the last.
SUMS = (300, 1200, 4800)
# Of more samples than these, evenly spread stretches are tested: so many tell all that matters.
STRETCHES, STRETCH = 8, 8192
# A lag with fewer pairs than this share of the samples goes into no sum and no statistic.
LEAST_PAIR_SHARE = 0.2
# P is not below this share of its first term: a sum of noisy correlations may be negative.
LEAST_VARIANCE = 0.1
# The independence statistic needs this share of samples with 25 others on either side.
LEAST_INNER_SHARE = 0.5
# Eigenvalues below this share of the largest are not known well enough to divide by.
LEAST_EIGENVALUE = 1e-3
# With fewer samples the statistics are not distributed as they should be, as simulated.
FEWEST_SAMPLES = 40 * LONGEST_LAG
# Samples that tell whether errors are larger where an input moves; evenly thinned, for time.
THINNED_SAMPLES = 2_000

# Errors below this share of the flow are rounding, in every analysis of them.
ROUNDING = 1e-9
