"""A motor fitted to a frame of samples, and everything that one asks of such a fit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import narwhals as nw
import numpy as np
from numpy.typing import NDArray

from leakage.block_fit import BlockEstimate, SampleBlocks, fit_blocks
from leakage.block_statistics import factor, factors, merge
from leakage.conditions import OperatingConditions
from leakage.correlation import memory_s
from leakage.errors import LeakageError, ShapeError
from leakage.frame_samples import FrameSamples, Period, read_samples
from leakage.frame_words import Summary, Words, explanation, short_form, summary
from leakage.identifiability import (
    Excitation,
    Identification,
    Judgement,
    LeakageJudgement,
    judge_by_total,
    judge_leakage,
)
from leakage.law import Parameter
from leakage.model_verdict import (
    COEFFICIENT_FACTOR,
    LEAKAGE_FACTOR,
    StructuredMisfit,
    model_errors,
    structured_misfit,
)
from leakage.motor import Motor, regressors
from leakage.multi_start import Parametrisation, SearchSettings
from leakage.paths import FLUSHING_PARAMETER, FLUSHING_PATH, Constant, LeakagePath
from leakage.residual_analysis import ResidualAnalysis, analyse_residuals
from leakage.sample_blocks import (
    NONE_CHOSEN,
    SECOND_US,
    TRAINING,
    VALIDATION,
    Block,
    ChosenPeriods,
    DefaultWindows,
    Windows,
    merge_neighbours,
    short_blocks_of,
    split_into_blocks,
)
from leakage.sensitivities import ErrorBudget, Tolerances, error_budget
from leakage.slow_errors import ShortBlocks
from leakage.validation import Agreement, agreement

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]
Part = Literal["training", "validation"]

HIGHEST_FLUSHING_L_PER_MIN = 20.0
PARTS: tuple[Part, Part] = ("training", "validation")
# Samples that carry the stated tolerances.
THINNED = 1500
# Errors below this share of the flow are rounding.
ROUNDING = 1e-9
DAY_US = 86_400 * SECOND_US


def fit_frame(
    frame: Any,
    motor: Motor,
    *,
    flushing: float | Literal["none", "estimated"] | None = None,
    train: Period | Sequence[Period] | None = None,
    validate: Period | Sequence[Period] | None = None,
    columns: Mapping[str, str] | None = None,
    tolerances: Tolerances | None = None,
    windows: Windows | None = None,
    starting_points: int = 0,
    seed: int = 1,
) -> FrameFit:
    """Fit a motor to a frame of samples.

    The samples are taken as they are: ``pipeline.notebook.prepare`` cleans and resamples raw ones
    as the nightly run does, whose fit this is.

    Parameters
    ----------
    frame
        A frame of pandas, Polars, PyArrow or any other that narwhals knows, or arrays by name:
        ``time`` (dates, naive ones in UTC, or seconds), ``pressure_bar``, ``oil_temperature_c``,
        ``speed_rpm``, ``leakage_l_per_min`` (the measured drain flow), and ``charge_over_case_bar``
        where leakage is two-sided. Rows in which a value is missing are left out.
    motor
        The motor with its oil.
    flushing
        Flow that is added before the sensor: ``"none"``, a known flow [l/min], or ``"estimated"``.
        None: as the motor declares it.
    train, validate
        Periods that the motor is fitted to and judged on: begin and end, or several such pairs, in
        the frame's times. Only blocks that lie within one as a whole count. None: estimates are
        from all samples; a fit to the first 80 % of them is judged on the others.
    columns
        Names of the columns in the frame, where they differ.
    tolerances
        Stated tolerances of sensors; they widen the total ± and may change verdicts.
    windows
        Length of a block, and the split; None: 120 s, and 80 % train.
    starting_points, seed
        Starting points of the thesis's search, and the seed of their draws. The estimate is the
        proven minimum and does not depend on them.

    Returns
    -------
    FrameFit

    Raises
    ------
    ShapeError
        If a column is missing, or in another unit by its name.
    StatisticsError
        If times fall or repeat, or no row is complete.
    EstimationError
        If there are fewer training samples than free coefficients.
    ValidityError
        If a temperature is outside of the range of the oil's viscosity.

    Examples
    --------
    >>> from leakage import AnnularGap, Motor, Oil, Parameter
    >>> oil = Oil.from_reference_viscosities(
    ...     "VG 46", temperature_1_c=40.0, viscosity_1_mm2_per_s=46.0, temperature_2_c=100.0,
    ...     viscosity_2_mm2_per_s=6.8, density_15_c_kg_per_m3=880.0,
    ...     thermal_expansion_per_k=7e-4, pressure_viscosity_per_pa=2e-8)
    >>> gap = AnnularGap("gap", 9, 0.01, 0.03, Parameter("h_gap", "um", 15.0, 1.0, 60.0), None)
    >>> motor, rng = Motor("pump", (gap,), oil), np.random.default_rng(1)
    >>> samples = {"time": np.arange(7200.0), "pressure_bar": rng.uniform(50, 250, 7200),
    ...            "oil_temperature_c": rng.uniform(40, 55, 7200),
    ...            "speed_rpm": np.full(7200, 900.0)}
    >>> from leakage import OperatingConditions, total_flow_l_per_min
    >>> at = OperatingConditions.from_bar(*(samples[one] for one in list(samples)[1:]))
    >>> samples["leakage_l_per_min"] = total_flow_l_per_min(motor, at) + rng.normal(0, 0.002, 7200)
    >>> found = fit_frame(samples, motor)
    >>> found.judgements["K_gap"].verdict, bool(found.validation.fit_percent > 90)
    ('identified', True)
    """
    motor = _with_flushing(motor, flushing)
    samples = read_samples(frame, columns)
    chosen = ChosenPeriods(samples.stretches(train), samples.stretches(validate))
    if chosen and not chosen.training:
        raise LeakageError("period", "validate= is given without train=: say both, or neither")
    windows = windows or DefaultWindows()
    stored, short, made = _blocks(samples, motor, windows, chosen)
    parts = [block.part for block in stored]
    used = np.array([not chosen or part == TRAINING for part in parts])
    if not used.any():
        raise LeakageError(
            "period",
            f"no block of {windows.block_s:g} s lies within the training period as a whole: the"
            " samples are of another time, or the period is too short",
        )
    blocks = _used(samples, stored, short, made, used)
    estimate = fit_blocks(
        blocks, motor, SearchSettings(starting_points), np.random.default_rng(seed)
    )
    sizes = [block.n for block in stored]
    structured = None if estimate.misfit is None else structured_misfit([estimate.misfit])
    found = FrameFit(
        motor=motor,
        samples=samples,
        parts=np.repeat(np.array(parts), sizes),
        used=np.repeat(used, sizes),
        blocks=blocks,
        estimate=estimate,
        structured=structured,
        block_s=windows.block_s,
        training=agreement(_merged(made, parts, TRAINING), estimate.training.coefficients),
        validation=agreement(_merged(made, parts, VALIDATION), estimate.training.coefficients),
        tolerances=tolerances,
        identification=estimate.identification,
    )
    totals = {
        place: None
        if (told := estimate.identification.coefficients[place].information) is None
        else math.hypot(told.half_width, *found.beside_samples(place))
        for place in found.free_places
    }
    judged = judge_by_total(estimate.fit, estimate.identification, totals)
    return replace(found, identification=judged)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FrameFit:
    """A motor fitted to a frame.

    Attributes
    ----------
    motor, samples
        The motor as fitted, and the complete samples of the frame.
    parts
        Part of each sample, training, validation or guard, shape (n,).
    used
        Mask of the samples behind the estimates, shape (n,).
    blocks, estimate
        The blocks of these, and what was estimated from them.
    identification
        Verdicts on the coefficients, with what sensors and the model can do to them.
    structured
        Structured misfit; None where the blocks are too few to tell.
    training, validation
        Agreement of the fit to the training samples with these, and with the validation samples.
    """

    motor: Motor
    samples: FrameSamples
    parts: NDArray[np.str_]
    used: NDArray[np.bool_]
    blocks: SampleBlocks
    estimate: BlockEstimate
    structured: StructuredMisfit | None
    block_s: float
    training: Agreement
    validation: Agreement
    tolerances: Tolerances | None
    identification: Identification
    _tests: dict[str, ResidualAnalysis] = field(default_factory=dict)

    @property
    def paths(self) -> tuple[LeakagePath | None, ...]:
        """Path of each coefficient of θ; None for a flushing that the motor does not have."""
        return Parametrisation.of(self.motor).paths

    @property
    def free_places(self) -> list[int]:
        """Places in θ of the coefficients that are estimated."""
        fixed = self.estimate.fit.certificate.fixed
        return [at for at, path in enumerate(self.paths) if path is not None and not fixed[at]]

    @property
    def params(self) -> dict[str, float]:
        """Estimates by name: loss factors K [m³], scales [-], and the flushing C_f [l/min]."""
        theta = self.estimate.fit.coefficients
        return {
            path.coefficient_name: float(theta[at])
            for at, path in enumerate(self.paths)
            if path is not None
        }

    @property
    def judgements(self) -> dict[str, Judgement]:
        """Verdict, reason and interval of each coefficient by name."""
        judged = self.identification.coefficients
        return {
            path.coefficient_name: judged[at]
            for at, path in enumerate(self.paths)
            if path is not None
        }

    def conf_int(self, level: float = 0.95) -> dict[str, tuple[float, float] | None]:
        """Intervals from the samples by name; None for a coefficient that has none.

        Parameters
        ----------
        level
            Coverage.
        """
        distribution, found = self.identification.distribution, {}
        for at, path in enumerate(self.paths):
            if path is None:
                continue
            interval = None
            if distribution is not None and self.identification.coefficients[at].interval:
                interval = distribution.interval(np.eye(len(self.paths))[at], level)
            value = self.params[path.coefficient_name]
            found[path.coefficient_name] = (
                None
                if interval is None
                else (value - interval.half_width, value + interval.half_width)
            )
        return found

    def predict(self, frame: Any = None, columns: Mapping[str, str] | None = None) -> Array:
        """Predicted drain flow of the rows of a frame, nan where a row is incomplete.

        Parameters
        ----------
        frame, columns
            As of :func:`fit_frame`, without the measured flow; None: the samples of the fit.

        Returns
        -------
        ndarray
            Shape (rows,), [l/min].
        """
        samples = self.samples if frame is None else read_samples(frame, columns, with_flow=False)
        return _on_rows(self._predicted(samples), samples, frame)

    def residuals(self, frame: Any = None, columns: Mapping[str, str] | None = None) -> Array:
        """Measured less predicted drain flow of the rows of a frame, nan where one is incomplete.

        Returns
        -------
        ndarray
            Shape (rows,), [l/min].
        """
        samples = self.samples if frame is None else read_samples(frame, columns)
        assert samples.flow_l_per_min is not None
        return _on_rows(samples.flow_l_per_min - self._predicted(samples), samples, frame)

    def _predicted(self, samples: FrameSamples) -> Array:
        theta = np.append(self.estimate.fit.coefficients, 1.0)
        flow: Array = regressors(self.motor, samples.conditions) @ theta
        return flow

    def leakage(
        self,
        pressure_bar: float,
        temperature_c: float,
        speed_rpm: float,
        charge_over_case_bar: float | None = None,
    ) -> LeakageJudgement:
        """Leakage at one condition, flushing excluded, with verdict and interval.

        Parameters
        ----------
        pressure_bar, temperature_c, speed_rpm, charge_over_case_bar
            The condition.

        Returns
        -------
        LeakageJudgement
            Its interval is from the samples; the verdict counts model and sensors, too.
        """
        if self.samples.charge_over_case_bar is not None and charge_over_case_bar is None:
            charge_over_case_bar = float(np.mean(self.samples.charge_over_case_bar))
        at = OperatingConditions.from_bar(
            pressure_bar, temperature_c, speed_rpm, charge_over_case_bar
        )
        row = regressors(self.motor, at)[0]
        beside = self._model_error(np.append(row[:-2], 0.0), LEAKAGE_FACTOR)
        sensors = self._sensors([at]).leakages_l_per_min() if self.tolerances else None
        systematic = math.hypot(beside, 0.0 if sensors is None else float(sensors[0]))
        return judge_leakage(
            self.estimate.fit, self.identification, self.blocks.excitation, at, systematic
        )

    def beside_samples(self, place: int) -> tuple[float, float]:
        """± of a coefficient by the model, and by the sensors, in its unit."""
        model = self._model_error(np.eye(len(self.paths))[place], COEFFICIENT_FACTOR)
        sensors = self._sensors().coefficients() if self.tolerances else None
        return model, 0.0 if sensors is None else float(sensors[place])

    def _model_error(self, contrast: Array, times: float) -> float:
        if self.structured is None:
            return 0.0
        fixed = self.estimate.fit.certificate.fixed
        reach = model_errors(self.blocks.factors, fixed, contrast[None], 1.0)
        return float(times * reach[0] * self.structured.l_per_min)

    def _sensors(self, at: Sequence[OperatingConditions] = ()) -> ErrorBudget:
        assert self.tolerances is not None
        n = int(self.used.sum())
        rows = np.flatnonzero(self.used)
        thinned = np.zeros(len(self.used), dtype=np.bool_)
        thinned[rows[np.linspace(0, n - 1, min(THINNED, n)).round().astype(np.int64)]] = True
        few = self.samples.only(thinned)
        assert few.flow_l_per_min is not None
        budget = error_budget(self.motor, few.conditions, few.flow_l_per_min, self.tolerances, at)
        return budget.of_sensors()

    def compare(
        self, other: FrameFit, frame: Any, columns: Mapping[str, str] | None = None
    ) -> tuple[Agreement, Agreement]:
        """Agreement of this fit and of another with the samples of a frame.

        Parameters
        ----------
        other
            Another fit, of this motor or of another model of it.
        frame, columns
            As of :func:`fit_frame`.
        """
        samples = read_samples(frame, columns)
        first, second = (
            agreement(factor(_columns(one.motor, samples)), one.estimate.fit.coefficients)
            for one in (self, other)
        )
        return first, second

    def residual_tests(self, part: Part = "validation") -> ResidualAnalysis:
        """Whiteness and independence of what the fit to the training samples leaves in a part."""
        if part not in self._tests:
            samples = self.samples.only(self.parts == part)
            training = self.parts == TRAINING
            theta = self.estimate.training.coefficients
            error = _error(self.motor, samples, theta)
            flow = self.samples.flow_l_per_min
            assert flow is not None
            rounding = ROUNDING * float(np.abs(flow).max())
            of_training = self.samples.only(training)
            memory = memory_s(
                _error(self.motor, of_training, theta),
                of_training.index,
                self.samples.period_us / SECOND_US,
                rounding,
            )
            index = samples.index if len(samples.time_us) else np.empty(0, dtype=np.int64)
            self._tests[part] = analyse_residuals(
                error,
                samples.inputs,
                index,
                memory * SECOND_US / self.samples.period_us,
                rounding,
            )
        return self._tests[part]

    def _words(self) -> Words:
        return Words(
            self.motor.motor_type,
            self.columns(),
            self.structured,
            {TRAINING: self.training, VALIDATION: self.validation},
            {part: self.residual_tests(part) for part in PARTS if (self.parts == part).any()},
            int(self.used.sum()),
            len(self.samples.kept) - int(self.samples.kept.sum()),
            self.samples.time_us[self.used][[0, -1]],
            self.samples.on_clock,
            self.identification.slow.memory_s(self.block_s),
            self.blocks.excitation,
        )

    def summary(self) -> Summary:
        """Summary: warnings first, then estimates with intervals and verdicts, then the fit."""
        return summary(self._words())

    def explain(self) -> str:
        """Explanation of the fit in sentences."""
        return explanation(self._words())

    def _repr_html_(self) -> str:
        return self.summary()._repr_html_()

    def __repr__(self) -> str:
        return short_form(self.motor.motor_type, self.columns(), self.training, self.validation)

    def columns(self) -> dict[str, list[Any]]:
        """Estimates as columns, one row a coefficient."""
        intervals, rows = self.conf_int(), []
        for at, path in enumerate(self.paths):
            if path is None:
                continue
            name, judged = path.coefficient_name, self.identification.coefficients[at]
            is_free, interval = at in self.free_places, intervals[name]
            model, sensors = self.beside_samples(at) if is_free else (0.0, 0.0)
            half = judged.information.half_width if judged.interval and judged.information else None
            rows.append(
                {
                    "parameter": name,
                    "path": path.name,
                    "unit": path.coefficient_unit,
                    "value": self.params[name],
                    "lower": None if interval is None else interval[0],
                    "upper": None if interval is None else interval[1],
                    "total_half_width": None if half is None else math.hypot(half, model, sensors),
                    "configured": path.configured_coefficient,
                    "verdict": judged.verdict,
                    "reason": judged.reason,
                }
            )
        return {name: [row[name] for row in rows] for name in rows[0]}

    def to_polars(self) -> Any:
        """The estimates as a frame of Polars."""
        return nw.from_dict(self.columns(), backend="polars").to_native()

    def to_pandas(self) -> Any:
        """The estimates as a frame of pandas."""
        return nw.from_dict(self.columns(), backend="pandas").to_native()

    def plot(self, ax: Axes | None = None) -> Axes:
        """Measured and predicted flow over time, with the parts."""
        from leakage import frame_plots

        return frame_plots.plot(self, ax)

    def plot_residuals(self, part: Part = "validation", axes: Any = None) -> Any:
        """Autocorrelation of the errors, and their correlation with each input, with 99 % bands."""
        from leakage import frame_plots

        return frame_plots.plot_residuals(self, part, axes)

    def plot_leakage(
        self,
        temperature_c: float | None = None,
        speed_rpm: float | None = None,
        ax: Axes | None = None,
    ) -> Axes:
        """Leakage by path over pressure, with the 95 % band of the sum; at the means by default."""
        from leakage import frame_plots

        return frame_plots.plot_leakage(self, temperature_c, speed_rpm, ax)

    def plot_profile(self, axes: Any = None) -> Any:
        """Profile of the criterion over each coefficient that is estimated."""
        from leakage import frame_plots

        return frame_plots.plot_profile(self, axes)


def _with_flushing(motor: Motor, flushing: float | str | None) -> Motor:
    if flushing is None:
        return motor
    others = tuple(path for path in motor.paths if not isinstance(path, Constant))
    if flushing == "none":
        return replace(motor, paths=others)
    if flushing == "estimated":
        limits = (0.0, 0.0, HIGHEST_FLUSHING_L_PER_MIN)
    elif isinstance(flushing, str):
        raise LeakageError("flushing", f'flushing {flushing!r}: say "none", "estimated" or a flow')
    else:
        limits = (float(flushing),) * 3
    flow = Parameter(FLUSHING_PARAMETER, "l_per_min", *limits, fixed=flushing != "estimated")
    return replace(motor, paths=(*others, Constant(FLUSHING_PATH, flow)))


def _columns(motor: Motor, samples: FrameSamples) -> Array:
    """Columns of the samples as ``motor.columns``, shape (n, c)."""
    z = np.empty((len(samples.time_us), len(motor.columns)))
    regressors(motor, samples.conditions, out=z[:, :-1])
    z[:, -1] = samples.flow_l_per_min
    return z


def _error(motor: Motor, samples: FrameSamples, theta: Array) -> Array:
    error: Array = _columns(motor, samples) @ -np.concatenate([theta, (1.0, -1.0)])
    return error


def _on_rows(values: Array, samples: FrameSamples, frame: Any) -> Array:
    """Values of samples on the rows of their frame; on the samples themselves without one."""
    if frame is None:
        return values
    rows = np.full(len(samples.kept), np.nan)
    rows[samples.kept] = values
    return rows


def _blocks(
    samples: FrameSamples, motor: Motor, windows: Windows, chosen: ChosenPeriods
) -> tuple[tuple[Block, ...], ShortBlocks, Array]:
    """Stored and short blocks of the samples, and the factors of the stored."""
    if not motor.column_paths:
        raise ShapeError("motor_paths", f"{motor.motor_type} has no path that is free to estimate")
    z, time_us = _columns(motor, samples), samples.time_us
    short = split_into_blocks(time_us, 0, windows, chosen or NONE_CHOSEN)
    days = 1 + int(time_us[-1] - time_us[0]) // DAY_US
    stored = merge_neighbours(short, windows.maximum_blocks * days)
    made = factors(z, np.array([*(block.first_row for block in stored), len(z)]))
    return stored, short_blocks_of(z, made, short, stored), made


def _used(
    samples: FrameSamples,
    stored: Sequence[Block],
    short: ShortBlocks,
    made: Array,
    used: NDArray[np.bool_],
) -> SampleBlocks:
    """The blocks behind the estimates."""
    rows = [slice(block.first_row, block.end_row) for block in np.array(stored)[used]]
    channels = (samples.oil_temperature_c, samples.pressure_bar, samples.speed_rpm)
    inside = used[short.stored]
    seen = np.repeat(used, [block.n for block in stored])
    celsius, bar, rpm = (
        (float(values[seen].min()), float(values[seen].max())) for values in channels
    )
    return SampleBlocks(
        made[used],
        ShortBlocks(
            short.n[inside],
            short.means[inside],
            short.number[inside],
            (np.cumsum(used) - 1)[short.stored[inside]],
        ),
        np.array([block.part == TRAINING for block in stored])[used],
        np.array([[float(values[part].mean()) for values in channels] for part in rows]),
        Excitation(bar, celsius, rpm),
    )


def _merged(made: Array, parts: Sequence[str], part: str) -> Array:
    """Factor of all blocks of a part."""
    return merge(made[np.array([one == part for one in parts])])
