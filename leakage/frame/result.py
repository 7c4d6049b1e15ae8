"""A motor fitted to a frame: everything that is asked of such a fit, and its summary in words."""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import narwhals as nw
import numpy as np
from numpy.typing import NDArray

from leakage.arrays import Array, Mask
from leakage.errors import LeakageError
from leakage.estimation.block_fit import BlockEstimate, SampleBlocks
from leakage.estimation.blocks import SECOND_US
from leakage.estimation.identifiability import (
    Excitation,
    Identification,
    Judgement,
    LeakageJudgement,
    judge_by_total,
    judge_leakage,
)
from leakage.estimation.misfit import (
    COEFFICIENT_FACTOR,
    LEAKAGE_FACTOR,
    Misfit,
    model_errors,
)
from leakage.estimation.residual_analysis import ResidualAnalysis, analyse_residuals
from leakage.estimation.sensitivities import ErrorBudget, Tolerances, error_budget
from leakage.estimation.validation import Agreement, is_poor
from leakage.frame.samples import FrameSamples, read_samples
from leakage.physics.conditions import OperatingConditions
from leakage.physics.motor import Motor, regressors
from leakage.physics.paths import Law

if TYPE_CHECKING:
    import polars as pl
    from plotly.graph_objects import Figure

# Samples that carry the stated tolerances.
THINNED = 1500
# Structured misfit over the leakage from which on a model does not describe a motor.
LARGEST_MISFIT = 0.02
IN_WORDS = {"m3": "m³", "l_per_min": "l/min", "1": ""}
HEADINGS = ("coefficient", "value", "unit", "95 % interval", "total ±", "verdict")


@dataclass(frozen=True, slots=True)
class Summary:
    """A summary, which prints as text."""

    title: str  # motor, samples, times and operating conditions
    warnings: tuple[str, ...]  # what to know before a figure is used
    table: tuple[tuple[str, ...], ...]  # headings, then a row a coefficient
    notes: tuple[str, ...]  # fit, residuals and model, a line each

    def __str__(self) -> str:
        widths = [max(map(len, column)) for column in zip(*self.table, strict=True)]
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
            for row in self.table
        ]
        lines[1:1] = ["-" * max(map(len, lines))]
        warnings = [f"warning: {warning}" for warning in self.warnings]
        return "\n".join([self.title, *warnings, "", *lines, "", *self.notes])

    __repr__ = __str__


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FrameFit:
    """A motor fitted to a frame."""

    # motor, samples: The motor as fitted, and the complete samples of the frame.
    motor: Motor
    samples: FrameSamples
    parts: NDArray[np.str_]  # Part of each sample, training, validation or guard, shape (n,).
    used: Mask  # Mask of the samples behind the estimates, shape (n,).
    # blocks, estimate: The blocks of these, and what was estimated from them.
    blocks: SampleBlocks
    estimate: BlockEstimate
    # training, validation: Agreement of the fit to the training samples with these, and with the
    # validation samples.
    training: Agreement
    validation: Agreement
    tolerances: Tolerances | None
    # Verdicts on the coefficients, with what sensors and the model can do to them.
    identification: Identification
    # ± of each coefficient of θ by the model and the sensors, shape (p + 1,).
    beside_samples: Array

    @property
    def paths(self) -> dict[int, Law]:
        """Path of each coefficient by its place in θ."""
        paths = self.motor.coefficient_paths
        return {at: path for at, path in enumerate(paths) if path is not None}

    @property
    def params(self) -> dict[str, float]:
        """Estimates by name: loss factors K [m³], scales [-], and the flushing C_f [l/min]."""
        theta = self.estimate.fit.coefficients
        return {path.coefficient_name: float(theta[at]) for at, path in self.paths.items()}

    @property
    def judgements(self) -> dict[str, Judgement]:
        """Verdict, reason and interval of each coefficient by name."""
        coefficients = self.identification.coefficients
        return {path.coefficient_name: coefficients[at] for at, path in self.paths.items()}

    def conf_int(self, level: float = 0.95) -> dict[str, tuple[float, float] | None]:
        """Return intervals from the samples by name; None for a coefficient that has none."""
        return {path.coefficient_name: self._interval(at, level) for at, path in self.paths.items()}

    def _interval(self, at: int, level: float) -> tuple[float, float] | None:
        distribution = self.identification.distribution
        if distribution is None or self.identification.coefficients[at].interval is None:
            return None
        theta = self.estimate.fit.coefficients
        interval = distribution.interval(np.eye(len(theta))[at], level)
        if interval is None:
            return None
        return float(theta[at] - interval.half_width), float(theta[at] + interval.half_width)

    def predict(self, frame: Any = None, columns: Mapping[str, str] | None = None) -> Array:
        """Return predicted drain flow of the rows of a frame [l/min], nan in incomplete rows.

        Frame and columns as of :func:`fit_frame`, without the measured flow; None: the fit's
        samples.
        """
        samples = self.samples if frame is None else read_samples(frame, columns, with_flow=False)
        return _on_rows(self._predicted(samples), samples, frame)

    def residuals(self, frame: Any = None, columns: Mapping[str, str] | None = None) -> Array:
        """Return measured less predicted drain flow of a frame's rows [l/min]; nan: incomplete."""
        samples = self.samples if frame is None else read_samples(frame, columns)
        return _on_rows(samples.measured_l_per_min - self._predicted(samples), samples, frame)

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
        """Return leakage at a condition, flushing excluded, with verdict and interval.

        The interval is from the samples; the verdict counts model and sensors, too.
        """
        if self.samples.charge_over_case_bar is not None and charge_over_case_bar is None:
            charge_over_case_bar = float(np.mean(self.samples.charge_over_case_bar))
        at = OperatingConditions.from_bar(
            pressure_bar, temperature_c, speed_rpm, charge_over_case_bar
        )
        row = regressors(self.motor, at)[0]
        model = self._model_errors(np.append(row[:-2], 0.0)[None], LEAKAGE_FACTOR)[0]
        sensors = self._sensors([at]).leakages_l_per_min()
        systematic = math.hypot(model, 0.0 if sensors is None else float(sensors[0]))
        return judge_leakage(
            self.estimate.fit, self.identification, self.blocks.excitation, at, systematic
        )

    def _total_half_widths(self, rows: Array, at: OperatingConditions) -> Array:
        """Return total ± of the leakage by the regressors of conditions [l/min]; nan: unknown."""
        contrasts = np.column_stack([rows[:, :-2], np.zeros(len(rows))])
        known = self.identification.distribution
        intervals = [None if known is None else known.interval(contrast) for contrast in contrasts]
        samples = np.array(
            [np.nan if interval is None else interval.half_width for interval in intervals]
        )
        model = self._model_errors(contrasts, LEAKAGE_FACTOR)
        each = [at.part(slice(place, place + 1)) for place in range(len(rows))]
        sensors = self._sensors(each).leakages_l_per_min()
        total: Array = np.hypot(np.hypot(samples, model), 0.0 if sensors is None else sensors)
        return total

    def with_errors_beside(self) -> FrameFit:
        """Return the fit with what the model and the sensors can do to its coefficients."""
        free = np.flatnonzero(~self.estimate.fit.proven_minimum.fixed).tolist()
        beside = np.zeros_like(self.beside_samples)
        beside[free] = self._model_errors(np.eye(len(beside))[free], COEFFICIENT_FACTOR)
        sensors = self._sensors().coefficients()
        if sensors is not None:
            beside[free] = [math.hypot(sensors[at], beside[at]) for at in free]
        totals = {
            at: None if known is None else math.hypot(known.half_width, beside[at])
            for at in free
            for known in (self.identification.coefficients[at].information,)
        }
        identification = judge_by_total(self.estimate.fit, self.identification, totals)
        return replace(self, identification=identification, beside_samples=beside)

    def _model_errors(self, contrasts: Array, factor: float) -> Array:
        """Return ± of some contrasts of θ by the structured misfit."""
        estimate = self.estimate
        if estimate.misfit is None:
            return np.zeros(len(contrasts))
        # In the order of the nightly run: another order differs in the last bits.
        reach = model_errors(estimate.whole, estimate.fit.proven_minimum.fixed, contrasts, 1.0)
        return factor * reach * estimate.misfit.l_per_min

    def _sensors(self, at: Sequence[OperatingConditions] = ()) -> ErrorBudget:
        """Return tolerances of sensors carried through the fit; empty without, or beyond it."""
        if self.tolerances is None:
            return ErrorBudget(())
        rows = np.flatnonzero(self.used)
        thinned = np.zeros(len(self.used), dtype=np.bool_)
        few = np.linspace(0, len(rows) - 1, min(THINNED, len(rows))).round().astype(np.int64)
        thinned[rows[few]] = True
        samples = self.samples.only(thinned)
        try:
            flow, seen = samples.measured_l_per_min, samples.conditions
            return error_budget(self.motor, seen, flow, self.tolerances, at).of_sensors()
        except LeakageError:
            return ErrorBudget(())

    def residual_tests(self, part: str = "validation") -> ResidualAnalysis:
        """Return whiteness and independence of what the training fit leaves in a part."""
        chosen, index = self.samples.only(self.parts == part), self.samples.index
        theta = np.append(self.estimate.training.coefficients, 1.0)
        return analyse_residuals(
            chosen.measured_l_per_min - regressors(self.motor, chosen.conditions) @ theta,
            chosen.inputs,
            index[self.parts == part],
            self.samples.rounding_l_per_min,
        )

    def summary(self) -> Summary:
        """Return warnings first, then estimates with intervals and verdicts, then the fit."""
        columns, misfit = self.columns(), self.estimate.misfit
        rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
        parts = {"training": self.training, "validation": self.validation}
        left_out = int(np.count_nonzero(~self.samples.complete))
        used, seen = self.samples.only(self.used), self.blocks.excitation
        tested = [part for part in parts if (self.parts == part).any()]
        return Summary(
            _title(self.motor.motor_type, used, seen),
            tuple(_warnings(left_out, rows, parts, misfit)),
            (HEADINGS, *map(_cells, rows)),
            (
                *(_fits(part, of_part) for part, of_part in parts.items() if of_part.n),
                *(_errors(part, self.residual_tests(part)) for part in tested),
                _model(misfit),
            ),
        )

    def __repr__(self) -> str:
        return str(self.summary())

    def columns(self) -> dict[str, list[Any]]:
        """Return estimates as columns, a row for each coefficient."""
        paths, intervals = self.paths.values(), self.conf_int().values()
        judgements = self.judgements.values()
        totals = [
            math.hypot(judgement.information.half_width, self.beside_samples[at])
            if judgement.interval and judgement.information
            else None
            for at, judgement in zip(self.paths, judgements, strict=True)
        ]
        return {
            "parameter": [path.coefficient_name for path in paths],
            "path": [path.name for path in paths],
            "unit": [path.coefficient_unit for path in paths],
            "value": list(self.params.values()),
            "lower": [None if interval is None else interval[0] for interval in intervals],
            "upper": [None if interval is None else interval[1] for interval in intervals],
            "total_half_width": totals,
            "configured": [path.configured_coefficient for path in paths],
            "verdict": [judgement.verdict for judgement in judgements],
            "reason": [judgement.reason for judgement in judgements],
        }

    def to_polars(self) -> pl.DataFrame:
        """Return the estimates as a frame of Polars."""
        return nw.from_dict(self.columns(), backend="polars").to_polars()

    def plot(self) -> Figure:
        """Return measured and predicted flow over time, with the parts."""
        from leakage.frame import plots

        return plots.plot(self.samples, self.parts, self.predict())

    def plot_residuals(self, part: str = "validation") -> Figure:
        """Plot autocorrelation of the errors, and correlation with each input, with 99 % bands."""
        from leakage.frame import plots

        period_s = self.samples.period_us / SECOND_US
        return plots.plot_residuals(self.residual_tests(part), period_s)

    def plot_leakage(
        self, temperature_c: float | None = None, speed_rpm: float | None = None
    ) -> Figure:
        """Plot leakage by path over pressure, with the total ±; at the means by default."""
        from leakage.frame import plots

        samples, charge = self.samples, self.samples.charge_over_case_bar
        at = OperatingConditions.from_bar(
            np.linspace(*self.blocks.excitation.pressure_bar, plots.CURVE_POINTS),
            samples.oil_temperature_c.mean() if temperature_c is None else temperature_c,
            samples.speed_rpm.mean() if speed_rpm is None else speed_rpm,
            None if charge is None else charge.mean(),
        )
        return plots.plot_leakage(self.estimate.fit, at, self._total_half_widths)


def _on_rows(values: Array, samples: FrameSamples, frame: Any) -> Array:
    """Return values of samples on the rows of their frame; on the samples without a frame."""
    if frame is None:
        return values
    rows = np.full(len(samples.complete), np.nan)
    rows[samples.complete] = values
    return rows


def _title(motor_type: str, used: FrameSamples, seen: Excitation) -> str:
    """Return motor, number and times of the samples behind the estimates, and what they span."""
    ends = {"bar": seen.pressure_bar, "°C": seen.temperature_c, "rpm": seen.speed_rpm}
    spans = ", ".join(f"{low:.0f} to {high:.0f} {unit}" for unit, (low, high) in ends.items())
    first, last = used.time_us[[0, -1]].tolist()
    times = f"{first / 1e6:.0f} to {last / 1e6:.0f} s"
    if used.on_clock:
        epoch = dt.datetime(1970, 1, 1, tzinfo=dt.UTC)
        begin, end = (epoch + dt.timedelta(microseconds=at) for at in (first, last))
        times = f"{begin:%Y-%m-%d %H:%M} to {end:%Y-%m-%d %H:%M} UTC"
    return f"{motor_type}: {len(used.time_us)} samples, {times}, {spans}"


def _warnings(
    n_left_out: int,
    rows: Sequence[Mapping[str, Any]],
    agreements: Mapping[str, Agreement],
    misfit: Misfit | None,
) -> Iterator[str]:
    """Yield what to know before a figure is used: rows are those of `FrameFit.columns`."""
    if n_left_out:
        yield f"{n_left_out} rows lack a value and are left out"
    for row in rows:
        if row["verdict"] not in ("identified", "fixed"):
            yield f"{row['parameter']}: {row['verdict'].replace('_', ' ')}: {row['reason']}"
    for part, of_part in agreements.items():
        if is_poor(of_part.fit_percent):
            yield f"{part}: the model is worse than a constant flow"
    if not agreements["validation"].n:
        yield "no samples validate this fit"
    if misfit is not None and misfit.is_clear and misfit.share > LARGEST_MISFIT:
        yield f"the model does not describe these samples: {_misfit(misfit)}"


def _cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the cells of a coefficient."""
    has_interval = row["lower"] is not None
    return (
        row["parameter"],
        f"{row['value']:.4g}" if has_interval or row["verdict"] == "fixed" else "-",
        IN_WORDS.get(row["unit"], row["unit"]),
        f"[{row['lower']:.4g}, {row['upper']:.4g}]" if has_interval else "-",
        f"{row['total_half_width']:.2g}" if has_interval else "-",
        row["verdict"].replace("_", " "),
    )


def _fits(part: str, of_part: Agreement) -> str:
    """Return how the fit to the training samples agrees with a part."""
    fit = "-" if of_part.fit_percent is None else f"{of_part.fit_percent:.1f} %"
    return (
        f"{part}: fit {fit}, rmse {of_part.rmse_l_per_min:.3g} l/min, mean "
        f"error {of_part.mean_error_l_per_min:+.2g} l/min, {of_part.n} samples"
    )


def _errors(part: str, analysis: ResidualAnalysis) -> str:
    """Return what is left of a part after the fit."""
    if analysis.whiteness.verdict == "not_tested":
        return f"errors of {part}: not tested, {analysis.whiteness.reason}"
    white = "not autocorrelated" if analysis.whiteness.verdict == "passed" else "autocorrelated"
    verdicts = {
        name.replace("_", " "): test.verdict for name, test in analysis.independence.items()
    }
    if set(verdicts.values()) == {"passed"}:
        return f"errors of {part}: {white}, independent of every input"
    related = (
        f"{words} {', '.join(name for name, verdict in verdicts.items() if verdict == of)}"
        for of, words in (("failed", "go with"), ("not_tested", "not tested against"))
        if of in verdicts.values()
    )
    return f"errors of {part}: {white}, {', '.join(related)}"


def _model(misfit: Misfit | None) -> str:
    """Return whether the model describes the samples."""
    if misfit is None:
        return "model: too few blocks to judge it"
    if not misfit.is_clear and misfit.noise_share > LARGEST_MISFIT:
        noise = 100 * misfit.noise_share
        return f"model: noise hides it: alone it looks like a misfit of {noise:.1f} %"
    return f"model: {_misfit(misfit)}"


def _misfit(misfit: Misfit) -> str:
    return f"{100 * misfit.share:.1f} % of the leakage goes with what the model does not describe"
