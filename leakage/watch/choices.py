"""Constants of the watch that a motor's own nights do not tell, each with its reason.

Measured on machines that are not the fitted kind: `benchmarks/results/watch.md`. All relative
figures are shares of the flow unless they say otherwise.
"""

from __future__ import annotations

# -- a block in numbers ----------------------------------------------------------------------------
# The scale of a residual never falls below this share of the mean flow: at a low flow the meter's
# error is fixed. The floor is in the scale alone; in the expectation it raised false alarms.
LEAST_SCALE = 0.2
# A change of a path is counted in its own flow, or in this share of the mean flow if that is more.
LEAST_UNIT = 0.1
# Priors (standard deviations): a path's change; the effect of temperature in 10 K, straight and
# bent; each knot of the discrepancy surface; the meter's zero. They only have to be wide beside
# what motors do.
PATH_PRIOR, TEMPERATURE_PRIOR, SURFACE_PRIOR, ZERO_PRIOR = 1.0, (0.2, 0.05), 0.03, 0.02
# Lack of fit beyond which flows that follow no viscosity stand beside the model's: up to it they
# bring nothing, and cost names. Prior of a change of each.
LACK_TO_ADD, FURTHER_PRIOR = 0.05, 0.3
# The same of the effect of temperature on each path alone, in 10 K: without it, a season of +12 K
# was reported as wear on machines whose parts do not follow the oil alike.
PATH_TEMPERATURE_PRIOR = 0.05
# Quantiles of the baseline's pressures and speeds at which the surface has its knots, and how near
# to one another (share of the largest) they are merged.
PRESSURE_KNOTS, PRESSURE_APART = (0.02, 0.35, 0.65, 0.98), 0.10
SPEED_KNOTS, SPEED_APART = (0.03, 0.50, 0.97), 0.15

# -- errors within a night -------------------------------------------------------------------------
# Blocks of a piece of which the covariance is estimated, and the largest number of pieces.
PIECE_BLOCKS, MOST_PIECES = 40, 60
# Residuals beyond so many robust standard deviations are clipped before that.
CLIP = 4.0
# A block that the others of its night contradict by more standard deviations than this gets a
# larger error; so often the weights are made anew.
ROBUST, ROBUST_PASSES = 3.0, 4

# -- errors from night to night --------------------------------------------------------------------
# The wander of the paths has a prior worth so many nights, of this size, three quarters of it
# common to all paths: what the sensors of most motors do.
WANDER_NIGHTS, WANDER_SIZE, WANDER_COMMON = 6.0, 0.012, 0.75
# By what the mean of a long record varies more where single paths wander: a memory of 0.6.
LONG_OF_PATHS = 4.0
# Degrees of freedom of each stretch of nights that varies by itself.
STRETCHES = 1.2
# Prior of the rise of each path in ten days, beside which it wanders.
LINE_PRIOR = 0.1
# Share of the nights' variance that a line takes, for which Q is corrected at most.
MOST_OF_LINE = 0.6
# Wander and its memory are estimated anew when the nights have grown by this factor, from nights
# up to a week ago, and not while something may be about to be detected.
ANEW_FACTOR, ANEW_DELAY, ANEW_BELOW = 1.3, 7, 6.0

# -- the statistic ---------------------------------------------------------------------------------
# Size of a step, half-normal; rise of a ramp in ten days; spread of the factor of another grade.
STEP_SIZE, RAMP_SIZE, RAMP_DAYS, GRADE_SPREAD = 0.3, 0.1, 10.0, 0.15
# Size of an error of the temperature sensor, in shifts of SENSOR_SHIFT_K.
SENSOR_SIZE, SENSOR_SHIFT_K = 0.25, 5.0
# A path whose share of the flow is less cannot fall visibly.
LEAST_SHARE_TO_FALL = 0.05
# Share of nights that are odd by themselves, and once odd nights have become frequent.
ODD, OFTEN = 0.003, 0.25
# Evidence of a start at other operating conditions from which each night is left out in turn.
LEFT_OUT_FROM = 2.0
# Odd nights are counted within so many nights; at least so many; at most this share of the nights.
# They are over behind so many nights without.
ODD_WITHIN, LEAST_ODD, MOST_ODD, ODD_ARE_OVER = 60, 3, 0.5, 30
# Model error a standard deviation of other operating conditions beyond the first 1.5, at most 4 of
# them. Where the baseline's pressures and speeds vary, half of the lack of fit stands in, but for
# this least.
OPERATING_ERROR, OPERATING_FREE, OPERATING_MOST = 0.01, 1.5, 4.0
OPERATING_BY_LACK, OPERATING_LEAST_ERROR = 0.5, 0.0025
# Standard deviations beyond those from which the operating conditions are others, and no chance.
OPERATING_OTHER = 0.5
# What operating conditions vary by at least: share of a path, bar, rpm.
OPERATING_LEAST_SHARE, OPERATING_LEAST_BAR, OPERATING_LEAST_RPM = 0.002, 0.1, 0.04
# Starts of so many last nights stand singly; older starts 2, 4, 8 … nights apart.
DENSE_STARTS = 40
# Nights that are kept singly, and how many more until the oldest are summed up; no start lies
# among those.
WINDOW, WINDOW_SLACK = 300, 50
# A ramp from the first night on may have begun before it: it stands for so many starts.
STARTS_BEFORE = 30.0
# Evidence beyond ln(365 / rate): the rate holds for a known wander, and it is an estimate.
ESTIMATED = 0.3
# A change of the flow that is reported at all.
LEAST_CHANGE = 0.005

# -- since, how much, which cause ------------------------------------------------------------------
# Evidence (in twice the gain of ln likelihood) from which a size is its own, without the prior.
OWN_SIZE = 25.0
# Error of the size of what did not begin in a night, as a share of it: a ramp is never straight.
SIZE_BY_SHAPE = 0.12
# Power of the evidence of starts in the interval of the first day: a ramp is never quite straight.
DATES = 0.6
# Error of a size by the model's lack of fit, as a share of it; error of a change's shape, in lacks
# of fit. Without the latter, four foreign machines of five got a part named, wrongly.
SIZE_BY_LACK, SHAPE_BY_LACK = 0.3, 2.0
# Error of a night's level by the lack of fit, as a share of it: without it intervals near the
# baseline's operating conditions held the truth in 85 % of nights (model.md, 7c.9).
LEVEL_BY_LACK = 0.1
# Error that is common to all nights since the baseline, as a share of the model's error: without it
# intervals of a mean of ten nights with a change in force held the truth in 64 % of 353 nights of
# 22 motors by others' physics, with it in 95 %.
LEVEL_BY_MODEL = 0.1
# Error of a leakage at given conditions by the lack of fit, as a share of it. What the model misses
# is learned of means of two minutes, in which the load varies, and is asked for at a steady load:
# 5 % on an all-laminar machine whose lack of fit is 8 %.
LEAKAGE_BY_LACK = 0.3
# Relative error of a leakage beside an estimated flushing whose power of the load is not the
# model's: an orifice has half of a gap's, a gap that the pressure opens has twice as much. Of such
# machines the model misses about so much of the flow, or more.
LEAKAGE_BY_SHAPE, WRONG_SHAPE = 0.35, 0.02
# A cause is named from this probability; from the other on it has most of a name, or of a size.
NAMED, MOSTLY = 0.9, 0.5
# ln of likelihood by which the nights have to prefer a cause to another, to tell them apart:
# below it no posterior is more than its prior (model.md, 7c.4).
APART = 3.0
# How much rarer several causes in a night are than each by itself: a large change errs in its
# shape.
SEVERAL_PRIOR = 0.001
# Lack of fit up to which another grade, a sensor and a meter may be distinguished, and two gaps
# from one.
LACK_TO_IDENTIFY = 0.02
# The same over pressure and speed alone, up to which gaps may be distinguished: at most 0.015 where
# only the film law is another, at least 0.021 on machines that follow other laws.
LACK_TO_NAME = 0.018
# Pressures or speeds within ± this share count as the same pressure or speed: gaps cannot be
# distinguished.
ONE_POINT = 0.2
# Share of the flow from which a path's own change is detected.
LEAST_SHARE_TO_SHOW = 0.1
# Nights behind the present change: after a step, and during a ramp.
PRESENT_NIGHTS, PRESENT_OF_RAMP = 10, 3

# -- nights that follow their channels no more -----------------------------------------------------
# A night does not where its conditions leave more of its flow than this unexplained, and than so
# many times the most of a night of the baseline; so many nights in a row begin it, and end it.
# Wear of any kind of the benchmark's machines, other oil and other loads leave 2.6 times the most,
# 48 lives on machines by others less than 2.2 on two nights in a row. A meter or a tag of another
# motor, a clock that drifts, a meter that is damped or late leave 10 to 60 times (5 to 50 %).
LEAST_MISFIT, MISFIT_RATIO, MISFIT_NIGHTS = 0.05, 3.0, 2
# A meter is stuck whose flow varies, over its mean, by less than this share of what the expected
# does. Spread of conditions below which they are the same; blocks that a term of them needs.
LEAST_RESPONSE, LEAST_SPREAD, BLOCKS_A_TERM = 0.25, 1e-6, 1.5

# -- after a change --------------------------------------------------------------------------------
# Nights from the night on which a change is detected to its adoption.
SETTLE = 10
# What an adopted change leaves unexplained: fixed, and relative to it on paths and temperature, and
# on the surface and the effect of temperature on each path.
LEFT, LEFT_OF_PATHS, LEFT_OF_SURFACE = 0.02, 0.2, 0.1
# A larger change of the flow begins a baseline period of its own, which needs so many nights.
OWN_PERIOD, PERIOD_NIGHTS = 0.15, 8
# Spread of what counts as "back as before".
BACK_SPREAD = 0.15

# -- events behind which the motor is the same -----------------------------------------------------
# What a flow's way with viscosity misses, as a share of its logarithm, and what two data sheets do.
OIL_LAW, OIL_SHEET = 0.2, 0.02
# Spread of the step at another flow meter. Two that meet their data sheet agree within some 3 %; in
# viscous oil at a small part of its range, where a drain flow is, a turbine of 2 % was off by up to
# 30 % (calibration at 10 and 50 mm²/s, instrumentation.co.uk, "Accuracy of turbine flowmeters with
# variable viscosity fluids").
METER_SPREAD = 0.1
# The same at another sensor of temperature or pressure: 1.2 K, as ISO VG 68 thins by 4.3 % a kelvin
# at 50 °C. A Pt100 of class B may err by 0.55 K there (IEC 60751: 0.3 K + 0.005 |t|), old and new
# one together by 0.8 K, and each stands in another place of its line. Pressure says less: 1 % of
# 400 bar is 2 % of the leakage at 200 bar.
SENSOR_SPREAD = 0.05
# Spread of what a motor does by itself at such an event: what is left of a step is the event's.
OWN_STEP = 0.03

# -- the oil circuit -------------------------------------------------------------------------------
# How far motors of the same oil move apart: of the flow, and of the circuit's change.
CIRCUIT_ERROR, CIRCUIT_SPREAD = 0.01, 0.1
# Other motors that show the like, at least; by so many standard deviations, within errors or up to
# this ratio of sizes: parts follow the oil unlike.
LEAST_ALIKE, ALIKE_SD, ALIKE_RATIO = 2, 2.0, 1.6
# Days by which the first day of two motors' change may differ, beside its interval.
CIRCUIT_DAYS = 2

# -- within the day --------------------------------------------------------------------------------
# Evidence and least rise from which the night so far is reported, at most 0.1 times a healthy
# motor-year though some hundred checks a day may err: `benchmarks/results/intraday.md`. Less than
# the least rise is a step that waits for the night.
INTRADAY_LIMIT, INTRADAY_LEAST_RISE = 10.0, 0.05
# Numbers of latest blocks of two minutes that are tried as the night so far, beside all of it.
INTRADAY_BLOCKS = (2, 5, 15)
# Share of a rise below which it has ended, or is withdrawn.
INTRADAY_SHARE = 0.5
