"""Make the demo: a folder with the shipped configs, the logs of six motors, and the truth."""

from __future__ import annotations

import datetime as dt
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from joblib import Parallel, delayed

from pipeline.config import MotorSpec, load_fleet
from pipeline.demo.fleet import DEMO_FLEET, DemoNight, Plan, truth_document
from pipeline.demo.log_writers import replacing, write_log
from pipeline.demo.recording import record_night
from pipeline.errors import UsageError

MARKER: Final = ".motor-leakage-demo.json"
TRUTH: Final = "truth.json"
NIGHTS_A_TASK: Final = 8
YEARS: Final = (1971, 2200)

Progress = Callable[[int, int], None]


def write_demo(
    folder: Path,
    *,
    nights: int = 75,
    minutes: float = 90,
    rate_hz: float = 5.0,
    seed: int = 1,
    workers: int = 2,
    first_night: dt.date = dt.date(2026, 1, 2),
    progress: Progress | None = None,
) -> None:
    """Write the demo fleet: ``configs/``, ``logs/<motor_id>/`` and, last of all, ``truth.json``.

    Parameters
    ----------
    folder
        Where to: absent, empty, or an earlier demo, whose logs are replaced. Refused is an earlier
        demo whose configs were changed or added to since; other files beside them are left alone.
    nights
        Number of nights, one log file each and motor.
    minutes
        Length of each log, 1 to 1440, [min].
    rate_hz
        Rate of all channels but the temperature, 0.1 to 100, [Hz]; that is logged once a second.
    seed
        The same seed makes the same files, whatever the number of workers.
    workers
        Processes that write at the same time.
    first_night
        Label of the first night: the date on which it ends.
    progress
        Called after each task with the number of files written and to be written.

    Raises
    ------
    UsageError
        ``demo_arguments``, ``demo_configs``, or ``demo_folder``: refused, or it cannot be written.
    """
    _check_arguments(nights, minutes, rate_hz, seed, workers, first_night)
    plan = Plan(nights, float(minutes), float(rate_hz), seed, first_night)
    try:
        _prepare(folder, shipped_configs())
        demo_nights = _demo_nights(folder, plan)
        _write_logs(folder / "logs", demo_nights, workers, progress)
        document = truth_document(plan, demo_nights)
        _write_text(folder / TRUTH, json.dumps(document, indent=1, ensure_ascii=False) + "\n")
    except OSError as error:
        raise UsageError(
            "demo_folder",
            f"{error.filename or folder} cannot be written: {error.strerror}; name another folder,"
            " or repeat when that is solved",
        ) from error


def shipped_configs() -> Path:
    """Folder of the configs that the demo runs on: the package's, or the repository's.

    Raises
    ------
    UsageError
        ``demo_configs``: there is none, the installation is not whole.
    """
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "shipped_configs", package.parent / "configs"):
        if (folder / "fleet.toml").is_file():
            return folder
    raise UsageError(
        "demo_configs", f"no configs beside {package}: the installation is not whole; repeat it"
    )


def _check_arguments(
    nights: int, minutes: float, rate_hz: float, seed: int, workers: int, first_night: dt.date
) -> None:
    limits: Mapping[str, tuple[float, float, float]] = {
        "nights": (nights, 1, 3650),
        "minutes": (minutes, 1, 1440),
        "rate_hz": (rate_hz, 0.1, 100),
        "seed": (seed, 0, 2**63),
        "workers": (workers, 1, 256),
        "the first night's year": (first_night.year, *YEARS),
    }
    for name, (value, lowest, highest) in limits.items():
        if not lowest <= value <= highest:
            raise UsageError("demo_arguments", f"{name} is {value}; expected {lowest} to {highest}")


def _prepare(folder: Path, configs: Path) -> None:
    """Make the folder ready: shipped configs in it, no logs and no truth of an earlier demo."""
    contents = {
        path.relative_to(configs).as_posix(): path.read_bytes()
        for path in sorted(configs.rglob("*.toml"))
    }
    _check_folder(folder)
    (folder / TRUTH).unlink(missing_ok=True)
    for demo in DEMO_FLEET:
        logs = folder / "logs" / demo.motor_id
        logs.mkdir(parents=True, exist_ok=True)
        for path in (*logs.glob(f"{demo.motor_id}_*"), *logs.glob(".*.partial")):
            path.unlink()
    # The marker comes first: a demo that was interrupted can be made again.
    digests = {name: hashlib.sha256(content).hexdigest() for name, content in contents.items()}
    _write_text(folder / MARKER, json.dumps({"configs": digests}, indent=1) + "\n")
    for name, content in contents.items():
        path = folder / "configs" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as partial:
            partial.write_bytes(content)


def _check_folder(folder: Path) -> None:
    """Refuse any folder in which something of someone's could be lost."""
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return
    if not (folder / MARKER).is_file():
        raise UsageError(
            "demo_folder", f"{folder} is neither empty nor a demo; name a folder that is not there"
        )
    digests = _recorded_digests(folder / MARKER)
    for path in sorted((folder / "configs").rglob("*.toml")):
        name = path.relative_to(folder / "configs").as_posix()
        if digests.get(name) != hashlib.sha256(path.read_bytes()).hexdigest():
            raise UsageError(
                "demo_folder",
                f"{path} is not as the demo wrote it and would be lost; name another folder,"
                " or move it away",
            )


def _recorded_digests(marker: Path) -> Mapping[str, str]:
    try:
        return dict(json.loads(marker.read_text(encoding="utf-8"))["configs"])
    except (ValueError, KeyError, TypeError) as error:
        raise UsageError(
            "demo_folder", f"{marker} cannot be read; name another folder, or delete this one"
        ) from error


def _demo_nights(folder: Path, plan: Plan) -> list[DemoNight]:
    """All nights of all motors of the demo."""
    specs = {spec.motor_id: spec for spec in load_fleet(folder / "configs" / "fleet.toml").motors}
    return [
        DemoNight(demo, _spec(specs, demo.motor_id), plan, number)
        for demo in DEMO_FLEET
        for number in range(1, plan.nights + 1)
    ]


def _spec(specs: Mapping[str, MotorSpec], motor_id: str) -> MotorSpec:
    if motor_id not in specs:
        raise UsageError(
            "demo_configs", f"the shipped configs have no motor {motor_id}; restore motors/"
        )
    return specs[motor_id]


def _write_logs(
    logs: Path, nights: Sequence[DemoNight], workers: int, progress: Progress | None
) -> None:
    """Write all logs, some nights a task."""
    parallel = Parallel(
        n_jobs=workers,
        backend="sequential" if workers == 1 else "loky",
        return_as="generator_unordered",
    )
    tasks = (
        delayed(_write_nights)(logs, nights[first : first + NIGHTS_A_TASK])
        for first in range(0, len(nights), NIGHTS_A_TASK)
    )
    written = 0
    for files in parallel(tasks):
        written += files
        if progress is not None:
            progress(written, len(nights))


def _write_nights(logs: Path, nights: Sequence[DemoNight]) -> int:
    """Write the logs of some nights; a task of one worker."""
    for night in nights:
        motor = night.spec.file
        name = f"{motor.motor_id}_{night.label}.{motor.logs.format}"
        write_log(logs / motor.motor_id / name, record_night(night), motor)
    return len(nights)


def _write_text(path: Path, text: str) -> None:
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")
