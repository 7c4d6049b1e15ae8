"""Progress of a run and its plan: a bar on a terminal, plain lines elsewhere, or JSON."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING

from pipeline.cli.arguments import say, tell
from pipeline.messages import counted

if TYPE_CHECKING:
    from pipeline.run.fleet import RunRequest, RunResult
    from pipeline.run.tasks import MotorOutcome
    from pipeline.store.published import TableFault

# Reasons of a plan that are listed.
PLAN_REASONS = 8
# Logs of a motor of which it is said what was left out.
LEFT_OUT = 3


def print_plan(request: RunRequest, *, as_json: bool) -> None:
    """Print the nights that a run would do by motor, with the reasons."""
    from pipeline.run.plans import plan_fleet, plan_trends
    from pipeline.store.published import faults_of

    total = 0
    for motor_id, plan in plan_fleet(request):
        total += len(plan)
        steps = {str(label): (step.work.value, step.reason) for label, step in plan.items()}
        nights = {label: {"work": work, "reason": why} for label, (work, why) in steps.items()}
        span = f", {min(plan)} to {max(plan)}" if plan else ""
        reasons = Counter(steps.values()).most_common()
        lines = [f"{motor_id}: {counted(len(plan), 'night')}{span}"]
        lines += [f"  {n} to {work}: {why}" for (work, why), n in reasons[:PLAN_REASONS]]
        if left := len(reasons[PLAN_REASONS:]):
            lines.append(f"  and {counted(left, 'other reason')}; all of them with --json")
        event = {"event": "plan", "motor_id": motor_id, "nights": nights}
        tell(event, "\n".join(lines), as_json=as_json)
    for motor_id, why in plan_trends(request):
        event = {"event": "plan_trends", "motor_id": motor_id, "reason": why}
        tell(event, f"{motor_id}: all trends redone: {why}", as_json=as_json)
    tell_faults(faults_of(request.fleet.output), as_json=as_json)
    if not as_json:
        say(f"to be done: {counted(total, 'night')}")


def tell_faults(
    faults: Iterable[TableFault], event: str = "table_fault", mark: str = "", *, as_json: bool
) -> None:
    """Print damaged files of the output."""
    for one in faults:
        words = f"motor-leakage: {mark}{one}"
        tell({"event": event, **asdict(one)}, words, as_json=as_json, err=True)


@contextmanager
def progress(n_motors: int, *, as_json: bool) -> Iterator[Callable[[MotorOutcome], None]]:
    """Print each motor as it finishes; on a terminal below a bar."""
    # A caller may have closed it.
    if as_json or sys.stderr is None or not sys.stderr.isatty():
        yield lambda outcome: _print_motor(outcome, as_json=as_json)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    words = (TextColumn("motors"), BarColumn(), MofNCompleteColumn())
    with Progress(*words, TextColumn("{task.description}"), console=Console(stderr=True)) as bar:
        task = bar.add_task("", total=n_motors)

        def finished(outcome: MotorOutcome) -> None:
            bar.update(task, advance=1, description=outcome.motor_id)
            _print_motor(outcome, as_json=False)

        yield finished


def _print_motor(outcome: MotorOutcome, *, as_json: bool) -> None:
    motor_id, code, message = outcome.motor_id, outcome.error_code, outcome.message
    counts = ", ".join(f"{n} {status}" for status, n in sorted(outcome.counts.items()))
    why = f": {message}" if message and not code else ""
    event = {
        "event": "motor",
        "motor_id": motor_id,
        "status": outcome.status,
        "error_code": code,
        "message": message,
        "nights": dict(outcome.counts),
        "files": _by_fate(outcome.files),
        "growing": outcome.growing,
        "left_out": outcome.left_out,
    }
    words = f"{motor_id}: {outcome.status} ({counts or 'nothing to do'}){why}"
    tell(event, words, as_json=as_json)
    if as_json:
        return
    if code:
        say(f"{motor_id}: {code}: {message}", err=True)
    for growing in outcome.growing:
        say(f"{motor_id}: log_growing: {growing}", err=True)
    for left in outcome.left_out[:LEFT_OUT]:
        say(f"{motor_id}: left out of {left}", err=True)
    if len(outcome.left_out) > LEFT_OUT:
        others = counted(len(outcome.left_out) - LEFT_OUT, "other log")
        say(f"{motor_id}: and of {others}; `explain` says it of a night", err=True)


def print_summary(request: RunRequest, result: RunResult, *, as_json: bool) -> None:
    """Print what a run has done."""
    files = _by_fate(result.files)
    errors = dict(sorted(Counter(one.error_code or "" for one in result.failed).items()))
    if as_json:
        event = {
            "event": "run",
            "run_id": result.run_id,
            "n_motors": len(result.outcomes),
            "n_failed": len(result.failed),
            "n_standing": result.n_standing,
            "n_nights": result.n_nights,
            "files": files,
            "interrupted": result.interrupted,
            "seconds": round(result.seconds, 3),
            "seconds_by_stage": _by_stage(result),
            "errors": errors,
            "damage": [asdict(fault) for fault in result.damage],
            "damage_left": [asdict(fault) for fault in result.damage_left],
            "alarms": [
                {name: row[name] for name in ("motor_id", "indicator", "to_state", "reason")}
                for row in result.alarms
            ],
        }
        tell(event, "", as_json=True)
        return
    say(
        f"{'interrupted; ' * result.interrupted}{counted(result.n_nights, 'night')} of "
        f"{counted(len(result.outcomes), 'motor')} in {result.seconds:.1f} s, "
        f"{counted(len(result.failed), 'motor')} failed; "
        f"logs: {', '.join(f'{n} {fate}' for fate, n in files.items())}; "
        f"tables in {request.fleet.output / 'tables'}"
    )
    for code, count in errors.items():
        say(f"{code}: {counted(count, 'motor')}")
    if n := result.n_standing:
        stand = "failure stands" if n == 1 else "failures stand"
        say(f"{n} {stand}: mend or remove the logs, then fit-fleet --retry")
    tell_faults(result.damage_left, as_json=False)
    if result.damage:
        n_files, left = counted(len(result.damage), "file"), len(result.damage_left)
        say(f"damaged or missing: {n_files}, of which not repaired: {left}")
    for row in result.alarms:
        # A new baseline needs no attention; `alarms` has it.
        if row["way"] != "baseline":
            rules = f" (change of rules: {row['rules']})" if row["rules"] else ""
            what = f"{row['motor_id']}: {row['indicator']}: {row['to_state']}: {row['reason']}"
            say(f"{what}{rules}")


def _by_stage(result: RunResult) -> dict[str, float]:
    """Seconds by stage: those of the motors' tasks added up, then those of the run."""
    from pipeline.run.publishing import MOTOR_STAGES

    spent = Counter[str]()
    for outcome in result.outcomes:
        spent.update(outcome.seconds)
    stages = {name: spent[name] for name in MOTOR_STAGES} | dict(result.seconds_by_stage)
    return {name: round(seconds, 3) for name, seconds in stages.items()}


def _by_fate(files: Mapping[str, int]) -> dict[str, int]:
    """Log files by outcome: every possible outcome, in a fixed order."""
    from pipeline.logs.motor_logs import FATES

    return {fate: files.get(fate, 0) for fate in FATES}
