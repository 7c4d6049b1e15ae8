"""Demo fleet on disk: the shipped configs, simulated logs of six motors, and the truth."""

from __future__ import annotations

import datetime as dt
import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NoReturn

from pipeline.config import Execution, MotorSpec, load_fleet
from pipeline.demo.fleet import DEMO_FLEET, DemoNight, Plan, truth_document
from pipeline.demo.log_writers import replacing, write_log
from pipeline.demo.recording import record_night
from pipeline.errors import EngineError, UsageError
from pipeline.workers.engine import open_workers
from pipeline.workers.process import Loss

# Says that a folder is ours to clear.
MARKER: Final = ".motor-leakage-demo"
TRUTH: Final = "truth.json"
NIGHTS_A_TASK: Final = 8
YEARS: Final = (1971, 2200)


def write_demo(
    folder: Path,
    *,
    nights: int = 75,
    minutes: float = 90,
    rate_hz: float = 5.0,
    seed: int = 1,
    workers: int = 2,
    first_night: dt.date = dt.date(2026, 1, 2),
    slow_errors_min: float = 0.0,
) -> None:
    """Write the logs of the fleet ``configs/fleet.toml`` of a folder to ``demo/`` beside it.

    Below ``demo/`` come ``logs/<motor_id>/``, a file a night, and, last of all, ``truth.json``; it
    must be absent, empty, or an earlier demo, whose logs are replaced. ``configs/`` is copied from
    the shipped one where there is none, and else left alone. The other arguments are as in `Plan`;
    the same seed makes the same files, whatever the number of workers.

    Raises UsageError (``demo_arguments``, ``demo_configs``, ``demo_folder``) if they are out of
    range or the folder cannot be written; ConfigError if the fleet's config has faults.
    """
    plan = Plan(nights, float(minutes), float(rate_hz), seed, first_night, float(slow_errors_min))
    _check_arguments(plan, workers)
    demo = folder / "demo"
    try:
        _require_ours(demo)
        demo_nights = _demo_nights(demo_config(folder), plan)
        _clear(demo)
        _write_logs(demo / "logs", demo_nights, workers)
        document = truth_document(plan, demo_nights)
        _write_text(demo / TRUTH, json.dumps(document, indent=1, ensure_ascii=False) + "\n")
    except OSError as error:
        raise UsageError(
            "demo_folder",
            f"{error.filename or folder} cannot be written: {error.strerror}; name another folder,"
            " or repeat when that is solved",
        ) from error


def shipped_configs() -> Path:
    """Folder of the shipped configs: the package's, or the repository's.

    Raises UsageError (``demo_configs``) if there is none: the installation is not whole.
    """
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "shipped_configs", package.parent / "configs"):
        if (folder / "fleet.toml").is_file():
            return folder
    raise UsageError(
        "demo_configs", f"no configs beside {package}: the installation is not whole; repeat it"
    )


def _check_arguments(plan: Plan, workers: int) -> None:
    limits: Mapping[str, tuple[float, float, float]] = {
        "nights": (plan.nights, 1, 3650),
        "minutes": (plan.minutes, 1, 1440),
        "rate_hz": (plan.rate_hz, 0.1, 100),
        "seed": (plan.seed, 0, 2**63),
        "workers": (workers, 1, 256),
        "the first night's year": (plan.first_night.year, *YEARS),
        "slow_errors_min": (plan.slow_errors_min, 0, 1440),
    }
    for name, (value, lowest, highest) in limits.items():
        if not lowest <= value <= highest:
            raise UsageError("demo_arguments", f"{name} is {value}; expected {lowest} to {highest}")


def demo_config(folder: Path) -> Path:
    """The fleet file of a folder; where it has no ``configs/``, the shipped ones are copied."""
    configs = folder / "configs"
    if not configs.exists():
        partial = folder / ".configs.partial"
        shutil.rmtree(partial, ignore_errors=True)
        shutil.copytree(shipped_configs(), partial)
        partial.rename(configs)
    return configs / "fleet.toml"


def _require_ours(demo: Path) -> None:
    """Refuse a folder that may hold something of somebody's."""
    is_there = demo.exists() or demo.is_symlink()
    is_free = not is_there or (demo.is_dir() and not any(demo.iterdir()))
    if not is_free and not (demo / MARKER).is_file():
        raise UsageError(
            "demo_folder",
            f"{demo} is neither empty nor a demo; move it away, or name another folder",
        )


def _clear(demo: Path) -> None:
    """Make the demo's folder ready: an earlier demo's logs go."""
    demo.mkdir(parents=True, exist_ok=True)
    # The marker comes first: a demo that was interrupted can be made again.
    _write_text(demo / MARKER, "`motor-leakage demo` made this folder and may replace its logs\n")
    (demo / TRUTH).unlink(missing_ok=True)
    for motor in DEMO_FLEET:
        logs = demo / "logs" / motor.motor_id
        logs.mkdir(parents=True, exist_ok=True)
        for path in (*logs.glob(f"{motor.motor_id}_*"), *logs.glob(".*.partial")):
            path.unlink()


def _demo_nights(config: Path, plan: Plan) -> list[DemoNight]:
    """All nights of all motors of the demo."""
    specs = {spec.motor_id: spec for spec in load_fleet(config).motors}
    return [
        DemoNight(demo, _spec(specs, demo.motor_id), plan, number)
        for demo in DEMO_FLEET
        for number in range(1, plan.nights + 1)
    ]


def _spec(specs: Mapping[str, MotorSpec], motor_id: str) -> MotorSpec:
    if motor_id not in specs:
        raise UsageError(
            "demo_configs", f"the demo needs motor {motor_id} in configs/motors/; restore its file"
        )
    return specs[motor_id]


def _write_logs(logs: Path, nights: Sequence[DemoNight], workers: int) -> None:
    """Write all logs, some nights a task."""
    limits = Execution(workers=workers, backend="sequential" if workers == 1 else "loky")
    tasks = [
        (logs, nights[first : first + NIGHTS_A_TASK])
        for first in range(0, len(nights), NIGHTS_A_TASK)
    ]
    with open_workers(limits) as processes:
        for _ in processes.run(_write_nights, tasks, _lost):
            pass


def _lost(_: object, loss: Loss) -> NoReturn:
    raise EngineError(loss.code, f"the demo's logs cannot be written: {loss.how}")


def _write_nights(task: tuple[Path, Sequence[DemoNight]]) -> None:
    """Write the logs of some nights; a task of one worker."""
    logs, nights = task
    for night in nights:
        motor = night.spec.file
        name = f"{motor.motor_id}_{night.label}.{motor.logs.format}"
        write_log(logs / motor.motor_id / name, record_night(night), motor)


def _write_text(path: Path, text: str) -> None:
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")
