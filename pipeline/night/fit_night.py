"""A motor's night: raw channels in, rows of the tables out, stage by stage as the data go.

Or fitted anew from its published rows, when settings of the fit changed: what needs samples stays.
"""

from __future__ import annotations

import datetime as dt
import time
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
import polars as pl

from leakage import EstimationError, LeakageError, OperatingConditions
from leakage.estimation.blocks import TRAINING, within
from leakage.estimation.sensitivities import effects_elsewhere
from pipeline.config import MotorFile, MotorSpec, Settings
from pipeline.config.nights import Night
from pipeline.ingest import RawChannel
from pipeline.night.cleaning import (
    NO_RESTS,
    ChannelRules,
    CleanChannel,
    Rests,
    clean_channel,
    means_too_long,
)
from pipeline.night.fit import REFERENCE, conditions, fit_modes, fit_stored_blocks, tolerances
from pipeline.night.rows import (
    Rows,
    coefficient_names,
    fit_columns,
    fit_rows,
    night_residuals,
    night_row,
    of_fit,
    parameter_rows,
    reference_columns,
    unfitted_row,
)
from pipeline.night.sample_rows import block_rows, data_columns, prediction_rows, quality_rows
from pipeline.night.statistics import (
    NightStatistics,
    StoredBlocks,
    block_frame,
    night_statistics,
    sensor_ratio,
)
from pipeline.night.time_base import Insufficient, Quality, Samples, bring_together
from pipeline.night.time_order import order_once
from pipeline.schema import FAILED, INSUFFICIENT_DATA, OK, STOOD_STILL, Row
from pipeline.units import RUNNING_HOURS

# Fewer blocks than these minutes fill tell nothing of the errors beyond a block.
MINIMUM_TRAINING_MINUTES = 5.0
# Of fewer of the running motor's samples nobody knows whether they are typical of the night.
MINIMUM_KEPT_SHARE = 0.6

# Pressure difference, and its way over the night, from which a motor at rest seems to work: a load
# that is held has the same pressure all night.
LEAST_WORK_BAR, LEAST_WORK_SHARE = 20.0, 0.25

# Tables below a night that have rows without a fit, too.
WITHOUT_A_FIT = ("quality", "blocks")


@dataclass(frozen=True, slots=True)
class NightOutcome:
    """Outcome of a motor's night."""

    night: dt.date
    # status, reason, error_code: an outcome of the five, why in words, and the code of a failure.
    status: str
    reason: str | None
    error_code: str | None
    rows: Rows  # rows by table name, without ``run_id``
    seconds: Mapping[str, float] = field(default_factory=dict)  # time by stage
    tables: tuple[str, ...] | None = None  # names of the tables that are new; None: all


def fit_night(
    spec: MotorSpec,
    night: Night,
    channels: MutableMapping[str, RawChannel],
    look: Callable[[Samples], object] = lambda _: None,
) -> NightOutcome:
    """Fit a motor's night; whatever happens short of a fault in the code is its outcome.

    Each channel is taken out when it is its turn: a day at 100 Hz is not to be in memory twice.
    `look` is called with the kept samples.
    """
    seconds: dict[str, float] = {}
    rows: Rows = {}
    data: Row = {}
    try:
        with _timed(seconds, "clean_s"):
            samples, quality = clean_channels(spec.file, spec.settings, night, channels)
            look(samples)
            rows["quality"] = quality_rows(spec.motor_id, night.date, quality)
            data = data_columns(night, samples, channels.get(RUNNING_HOURS))
            require_enough(samples, quality)
            samples, outside = choose_parts(spec.file, night, samples)
            rows["quality"] += quality_rows(spec.motor_id, night.date, outside)
            require_parts(samples, outside)
        with _timed(seconds, "statistics_s"):
            motor = spec.stated.motor(night.date, spec.file.flushing.mode)
            statistics = night_statistics(spec.stated, motor, night, samples)
            ratio = sensor_ratio(motor.oil, samples)
            rows["blocks"] = block_rows(spec, night.date, motor, statistics, ratio)
        with _timed(seconds, "fit_s"):
            _require_training(statistics)
            blocks = StoredBlocks.of(spec, block_frame(rows["blocks"]), motor.columns)
            assert blocks is not None
            statistics = statistics.with_viscosity(blocks.viscosity_ratios, motor.columns)
            modes, budget = fit_modes(spec, night.date, statistics, blocks)
        with _timed(seconds, "residuals_s"):
            coefficients = [mode.stated.training.coefficients for mode in modes]
            residuals = [night_residuals(statistics, theta) for theta in coefficients]
        with _timed(seconds, "fit_s"):
            rows |= fit_rows(spec, night.date, statistics, blocks, modes, residuals, budget)
            rows["predictions"] = prediction_rows(spec.motor_id, night.date, statistics, modes)
    except EstimationError as error:
        status, reason, code = INSUFFICIENT_DATA, str(error), None
    except (Insufficient, LeakageError) as error:
        status, reason = getattr(error, "status", FAILED), getattr(error, "reason", str(error))
        code = error.code
    else:
        own = night_row(spec, night.date, data | of_fit(rows["fits"]), OK)
        return NightOutcome(night.date, OK, None, None, {"nights": [own], **rows}, seconds)
    return unfitted_outcome(spec, night.date, status, reason, code, data, rows, seconds)


def unfitted_outcome(
    spec: MotorSpec,
    night: dt.date,
    status: str,
    reason: str,
    code: str | None = None,
    data: Row | None = None,
    rows: Rows | None = None,
    seconds: Mapping[str, float] | None = None,
) -> NightOutcome:
    """Return outcome of a night without a fit: a row that says why, and what was counted so far."""
    unfitted = {name: part for name, part in (rows or {}).items() if name in WITHOUT_A_FIT}
    unfitted["nights"] = [night_row(spec, night, data or {}, status, reason, code)]
    unfitted["fits"] = [unfitted_row(spec, night)]
    return NightOutcome(night, status, reason, code, unfitted, seconds or {})


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    begin = time.perf_counter()
    try:
        yield
    finally:
        seconds[stage] = seconds.get(stage, 0.0) + time.perf_counter() - begin


def clean_channels(
    file: MotorFile, settings: Settings, night: Night, channels: MutableMapping[str, RawChannel]
) -> tuple[Samples, tuple[Quality, ...]]:
    """Return the kept samples of a night, or of a part of it, and what each rule refused.

    Raises Insufficient if a channel has no samples, or all of them fewer than two.
    """
    too_long = means_too_long(file.channels)
    if too_long is not None:
        raise Insufficient(FAILED, too_long, code="means_too_long")
    names = [name for name in file.channels if name != RUNNING_HOURS]
    rests, order = NO_RESTS, order_once()
    cleaned: dict[str, CleanChannel] = {}
    # Each is taken out when it is its turn, the speed first: it says when the motor stood still.
    for name in sorted(names, key=lambda name: name != "speed"):
        rules = ChannelRules.of(name, file.channels[name], file.logs)
        cleaned[name] = clean_channel(channels.pop(name), rules, night.start_us, rests, order)
        if name == "speed":
            rests = Rests.of(cleaned[name])
    cleaned = {name: cleaned[name] for name in names}
    counted = tuple(
        Quality(
            name,
            reason,
            channel.n_samples,
            channel.counts.get(reason, 0),
            channel.noted.get(reason, 0),
        )
        for name, channel in cleaned.items()
        for reason in dict.fromkeys((*channel.counts, *channel.noted))
    )
    silent = [name for name, channel in cleaned.items() if not len(channel.time_us)]
    if silent:
        raise Insufficient(INSUFFICIENT_DATA, f"no samples of {', '.join(silent)} in this night")
    if all(channel.period_us is None for channel in cleaned.values()):
        raise Insufficient(
            INSUFFICIENT_DATA, f"fewer than two samples in this night{_causes(counted)}"
        )
    samples, joint = bring_together(cleaned, night, settings)
    return samples, counted + joint


def require_enough(samples: Samples, quality: tuple[Quality, ...]) -> None:
    """Raise Insufficient if the motor stood still, or too few of its samples are kept."""
    still = samples.n_logged - samples.n_turning
    # Guard times alone may cover a night of a sensor at its maximum: that is no standstill.
    if not samples.n_running and 2 * still > samples.n_logged:
        low, high = samples.bar_at_rest
        if high > LEAST_WORK_BAR and high - low > LEAST_WORK_SHARE * high:
            raise Insufficient(
                INSUFFICIENT_DATA,
                f"the speed is that of standstill all night, while the pressure difference goes "
                f"from {low:.0f} to {high:.0f} bar (a dead speed sensor?)",
            )
        raise Insufficient(STOOD_STILL, "the motor stood still all night")
    if samples.kept_share < MINIMUM_KEPT_SHARE:
        raise Insufficient(
            INSUFFICIENT_DATA,
            f"only {100 * samples.kept_share:.0f} % of the running motor's samples are kept, "
            f"{100 * MINIMUM_KEPT_SHARE:.0f} % are needed{_causes(quality)}",
        )


def _causes(quality: Sequence[Quality]) -> str:
    """Return in brackets what refused most; empty where nothing did."""
    rules = [q for q in quality if q.reason not in ("any", "incomplete", "standstill", "guard")]
    rules.sort(key=lambda q: -q.n_refused / max(q.n_samples, 1))
    causes = _shares({f"{q.channel} {q.reason}": q for q in rules[:2]})
    return f" ({causes})" if causes else ""


def _shares(quality: Mapping[str, Quality]) -> str:
    """Return refused shares of what refused any."""
    shares = {name: 100 * q.n_refused / q.n_samples for name, q in quality.items() if q.n_refused}
    return "; ".join(f"{name} {share:.0f} %" for name, share in shares.items())


def choose_parts(
    file: MotorFile, night: Night, samples: Samples
) -> tuple[Samples, tuple[Quality, ...]]:
    """Return the samples in the parts of the night that are set by hand, or all where none is."""
    chosen = file.periods.within(night)
    if not chosen:
        return samples, ()
    outside = ~within(samples.time_us, chosen.training + chosen.validation)
    counted = (Quality.of("time_base", "outside_periods", outside),)
    return (samples.only(~outside) if outside.any() else samples), counted


def require_parts(samples: Samples, outside: tuple[Quality, ...]) -> None:
    """Raise Insufficient if no sample lies in a part that is good enough."""
    if len(samples.index):
        return
    causes = _shares({q.reason.replace("_", " "): q for q in outside})
    raise Insufficient(
        INSUFFICIENT_DATA,
        f"no part of the night is good enough to fit ({causes} of the kept samples)",
    )


def _require_training(statistics: NightStatistics) -> None:
    n = sum(block.n for block in statistics.blocks if block.part == TRAINING)
    minutes = n * statistics.samples.period_us / 60e6
    if minutes < MINIMUM_TRAINING_MINUTES:
        raise Insufficient(
            INSUFFICIENT_DATA,
            f"{minutes:.1f} minutes of kept samples for training, "
            f"{MINIMUM_TRAINING_MINUTES:g} are needed",
        )


FROM_TABLES = ("nights", "fits", "parameters", "error_budget")


def refit(
    spec: MotorSpec,
    night: dt.date,
    published: Mapping[str, Sequence[Row]],
    stored: pl.DataFrame | None,
) -> NightOutcome | None:
    """Fit a night anew by its rows of `FROM_TABLES`; None where the log has to be read."""
    modes, primary = spec.file.flushing.modes, spec.file.flushing.mode
    fits = {row["flushing_mode"]: row for row in published["fits"]}
    own = next(iter(published["nights"]), {})
    if set(fits) != set(modes) or own.get("status") != OK or stored is None:
        return None
    motor = spec.stated.motor(night, primary)
    blocks = StoredBlocks.of(spec, stored, motor.columns)
    if blocks is None:
        return None
    at, reference = conditions(spec, blocks), reference_columns(spec)
    is_elsewhere = any(row | reference != row for row in fits.values())
    rows: Rows = {"fits": [], "parameters": [], "error_budget": []}
    for mode in modes:
        key = {"motor_id": spec.motor_id, "night": night, "flushing_mode": mode}
        budget = [row for row in published["error_budget"] if row["flushing_mode"] == mode]
        if is_elsewhere:
            budget = _budget(spec, night, fits[mode], budget, at[0], blocks.charge_bar)
        try:
            made = fit_stored_blocks(spec, night, mode, blocks, at, budget)
        except EstimationError:
            return None
        # What needs samples is as before.
        figures = fit_columns(spec, made, blocks) | {"is_primary": mode == primary}
        rows["fits"].append(fits[mode] | figures)
        rows["parameters"] += [key | row for row in parameter_rows(spec, made)]
        rows["error_budget"] += [key | row for row in budget]
    if not is_elsewhere:
        del rows["error_budget"]
    rows["nights"] = [own | of_fit(rows["fits"])]
    return NightOutcome(night, OK, None, None, rows, tables=tuple(rows))


def refit_read(spec: MotorSpec, outcome: NightOutcome) -> NightOutcome:
    """Fit a night that was just read for another scale of the rollers, where its rows suffice."""
    if outcome.status != OK:
        return outcome
    blocks = block_frame(outcome.rows["blocks"])
    made = refit(spec, outcome.night, outcome.rows, blocks)
    return outcome if made is None else replace(outcome, rows={**outcome.rows, **made.rows})


def _budget(
    spec: MotorSpec,
    night: dt.date,
    before: Row,
    known: Sequence[Row],
    at: OperatingConditions,
    charge_bar: float | None,
) -> list[Row]:
    """Return rows of `error_budget` at other reference conditions; coefficients' rows stay."""
    motor = spec.stated.motor(night, before["flushing_mode"])
    coefficients = dict(zip(before["coefficient_names"], before["coefficients"], strict=True))
    names = coefficient_names(motor)
    by_source: dict[str, dict[str, float]] = {}
    for row in known:
        by_source.setdefault(row["source"], {})[row["indicator"]] = row["effect"]
    effects = effects_elsewhere(
        motor,
        tolerances(spec, night),
        np.array([coefficients[name] for name in names]),
        {
            source: (np.array([some.get(name, 0.0) for name in names]), some[REFERENCE])
            for source, some in by_source.items()
        },
        OperatingConditions.from_bar(
            before["reference_pressure_bar"],
            before["reference_temperature_c"],
            before["reference_speed_rpm"],
            charge_bar,
        ),
        at,
    )
    return [
        row | {"effect": effects.get(row["source"], row["effect"])}
        if row["indicator"] == REFERENCE
        else row
        for row in known
    ]
