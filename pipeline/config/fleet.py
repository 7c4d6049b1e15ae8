"""A fleet and its motors with all that their files say, resolved."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path, PurePosixPath

from leakage import FilmPressure, Motor
from pipeline.config.motor_types import (
    MotorTypeFile,
    OilFile,
    OilSample,
    Walther,
    measured_curve,
)
from pipeline.config.motors import MotorFile
from pipeline.config.settings import Execution, Settings
from pipeline.errors import UsageError

# Object stores that logs and tables may lie in.
URL_SCHEMES = ("s3", "az", "gs")
# Folders of the output that a run writes or empties.
OWN_FOLDERS = ("tables", "staging", "report")


@dataclass(frozen=True, slots=True)
class MotorSpec:
    """A motor with everything that its nights need, resolved: fleet file, overrides, type, oil."""

    file: MotorFile
    motor_type: MotorTypeFile
    oils: Mapping[str, OilFile]
    settings: Settings
    log_root: Path
    log_url: str = ""  # in the place of `log_root`
    roller_is_free: bool = False  # scale of the rollers' curve, as the motor's own nights decide
    circuit_samples: tuple[OilSample, ...] = ()  # of its oil circuit's file
    # Delay of its drain flow as its first nights decide it; None: not decided, or not estimated.
    drain_delay_s: float | None = None

    def decided(self, drain_delay_s: float | None, *, roller_is_free: bool) -> MotorSpec:
        """Return the motor as stated, in the form that its own nights decide on."""
        stated = self.settings.transport_delay
        if not stated.is_estimated:
            drain_delay_s = None
        settings = self.settings
        if drain_delay_s:
            paired = stated.model_copy(update={"fixed_s": drain_delay_s})
            settings = settings.model_copy(update={"transport_delay": paired})
        return replace(
            self, roller_is_free=roller_is_free, drain_delay_s=drain_delay_s, settings=settings
        )

    @property
    def stated(self) -> MotorSpec:
        """The motor as its files state it, the scale of the rollers' curve fixed."""
        return replace(self, roller_is_free=False) if self.roller_is_free else self

    @property
    def motor_id(self) -> str:
        """The motor's id."""
        return self.file.motor_id

    def oil_on(self, night: dt.date) -> OilFile:
        """Return the oil of a night."""
        return self.oils[self.file.oil_on(night)]

    def samples_of(self, night: dt.date) -> tuple[OilSample, ...]:
        """Return analyses of the filling of a night, later ones too."""
        filled = self.file.filled_on(night)
        samples = self.file.oil_samples or self.circuit_samples
        return tuple(sample for sample in samples if self.file.filled_on(sample.date) == filled)

    def measured_curve(self, night: dt.date) -> Walther | None:
        """Return Walther constants of a night's oil by its analyses; None: by the data sheet."""
        if not self.file.oil_samples and not self.circuit_samples:
            return None
        filled = self.file.filled_on(night)
        return measured_curve(self.samples_of(night), self.oil_on(night), filled, night)

    def motor(self, night: dt.date, flushing_mode: str) -> Motor:
        """Return the motor on a night and under a mode of flushing, with the data sheet's oil."""
        return self.motor_with(self.oil_on(night), flushing_mode)

    def motor_with(self, oil: OilFile, flushing_mode: str) -> Motor:
        """Return the motor with an oil and under a mode of flushing."""
        model = self.settings.model
        motor = Motor(
            motor_type=self.motor_type.motor_type,
            paths=(*self.motor_type.paths(), self.file.flushing.path(flushing_mode)),
            oil=oil.oil(),
            film_pressure=FilmPressure(model.film_pressure),
        )
        return motor.with_free_standard() if self.roller_is_free else motor


@dataclass(frozen=True, slots=True)
class Fleet:
    """A fleet's whole config; `settings` are those that no motor overrides."""

    name: str
    motors: tuple[MotorSpec, ...]
    execution: Execution
    log_root: Path
    output: Path
    settings: Settings
    copy_to: str = ""  # URL that a run copies the tables to; empty: none
    metrics_file: Path | None = None
    log_url: str = ""  # empty where the logs lie in a folder
    formerly: str = ""  # its name before; empty: it has always been the same
    is_live: bool = True  # whether this machine's clock says how old the newest night is

    def known_motors(self, wanted: Iterable[str]) -> tuple[str, ...]:
        """Return the ids that are asked for.

        Raises UsageError (``unknown_motor``) if the fleet has no such motor.
        """
        ids = tuple(wanted)
        known = sorted(spec.motor_id for spec in self.motors)
        if strangers := sorted({*ids}.difference(known)):
            message = f"no motor {', '.join(strangers)}; there are {', '.join(known)}"
            raise UsageError("unknown_motor", message)
        return ids

    def motor(self, motor_id: str) -> MotorSpec:
        """Return the motor of an id; raises as `known_motors`."""
        self.known_motors([motor_id])
        return next(spec for spec in self.motors if spec.motor_id == motor_id)

    @property
    def stale_after(self) -> dt.timedelta:
        """Age of the newest night from which the fleet is silent as a whole."""
        nights = min(spec.settings.alarms.stale_after_nights for spec in self.motors)
        return dt.timedelta(days=nights)

    @property
    def log_place(self) -> str:
        """Where the logs lie, for messages."""
        return self.log_url or str(self.log_root)

    def at_output(self, output: Path) -> Fleet:
        """Return the fleet with another output folder, which is copied nowhere."""
        return replace(self, output=output, copy_to="")


def overlap(fleet: Fleet) -> str | None:
    """Return the folder that was expected, where a run would read its output or harm the logs."""
    logs, output = fleet.log_root, fleet.output
    if fleet.log_url:
        return None
    if output == logs:
        return f"expected another folder than that of the logs, {logs}"
    if output in logs.parents and logs.relative_to(output).parts[0] in OWN_FOLDERS:
        return f"expected a folder without the logs, {logs}, among those that a run writes"
    inside = output.relative_to(logs).parts if logs in output.parents else None
    reaching = (
        f"expected a folder in which no log is looked for: {pattern} of {spec.motor_id} reaches "
        "into it"
        for spec in fleet.motors
        for pattern in spec.file.logs.files
        if inside and _reaches(pattern, inside)
    )
    return next(reaching, None)


def _reaches(pattern: str, folder: tuple[str, ...]) -> bool:
    """Return whether a path or glob may match files of another below a folder of the log root."""
    parts = PurePosixPath(pattern).parts[:-1]
    for part, name in zip(parts, folder, strict=False):
        if part == "**":
            return True
        if not fnmatchcase(name, part):
            return False
    return len(parts) >= len(folder)


def absolute(folder: Path) -> Path:
    """Return the absolute path of a folder, which need not be there.

    Raises ValueError if no folder can be there: its name is too long, say, or holds a null.
    """
    try:
        folder = folder.resolve()
        with suppress(FileNotFoundError, NotADirectoryError):
            folder.stat()
    except (OSError, RuntimeError) as error:  # the latter of links in a circle
        raise ValueError(getattr(error, "strerror", error)) from error
    return folder


def is_url(text: str) -> bool:
    """Tell the URL of an object store, such as s3://bucket/logs, from a folder."""
    return text.startswith(tuple(f"{scheme}://" for scheme in URL_SCHEMES))
