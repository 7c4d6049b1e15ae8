"""Progress of a run and its plan: a bar on a terminal, plain lines elsewhere, or JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.cli.arguments import say
from pipeline.messages import counted

if TYPE_CHECKING:
    from rich.progress import Progress

    from pipeline.run.fleet import RunRequest, RunResult
    from pipeline.run.tasks import MotorOutcome

# Reasons of a plan that are listed.
PLAN_REASONS = 8


def print_plan(request: RunRequest, as_json: bool) -> None:
    """Print the nights that a run would do by motor, with the reasons."""
    from collections import Counter

    from pipeline.run.plans import plan_fleet, plan_trends
    from pipeline.store.published import faults_of

    total = 0
    for motor_id, plan in plan_fleet(request):
        total += len(plan)
        if as_json:
            nights = {
                str(label): {"work": step.work.value, "reason": step.reason}
                for label, step in plan.items()
            }
            say(json.dumps({"event": "plan", "motor_id": motor_id, "nights": nights}))
            continue
        span = f", {min(plan)} to {max(plan)}" if plan else ""
        say(f"{motor_id}: {counted(len(plan), 'night')}{span}")
        reasons = Counter((step.work.value, step.reason) for step in plan.values())
        for (work, reason), count in reasons.most_common(PLAN_REASONS):
            say(f"  {count} to {work}: {reason}")
        if len(reasons) > PLAN_REASONS:
            others = counted(len(reasons) - PLAN_REASONS, "other reason")
            say(f"  and {others}; all of them with --json")
    for motor_id, reason in plan_trends(request):
        if as_json:
            say(json.dumps({"event": "plan_trends", "motor_id": motor_id, "reason": reason}))
        else:
            say(f"{motor_id}: all trends redone: {reason}")
    output = request.fleet.output
    for fault in faults_of(output):
        line = {"event": "table_fault", **asdict(fault)}
        words = f"motor-leakage: {fault}"
        say(json.dumps(line) if as_json else words, err=True)
    if not as_json:
        say(f"to be done: {counted(total, 'night')}")


class Reporter:
    """Progress of a run: a bar on a terminal, plain lines elsewhere, JSON if asked for."""

    def __init__(self, as_json: bool, n_motors: int) -> None:
        self.as_json = as_json
        # A caller may have closed it.
        on_terminal = sys.stderr is not None and sys.stderr.isatty()
        self.bar = _bar(n_motors) if on_terminal and not as_json else None

    def __enter__(self) -> Reporter:
        if self.bar:
            self.bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.bar:
            self.bar.stop()

    def motor(self, outcome: MotorOutcome) -> None:
        """A motor has finished."""
        if self.bar:
            self.bar.update(self.bar.task_ids[0], advance=1, description=outcome.motor_id)
        counts = ", ".join(f"{n} {status}" for status, n in sorted(outcome.counts.items()))
        if self.as_json:
            line = {
                "event": "motor",
                "motor_id": outcome.motor_id,
                "status": outcome.status,
                "error_code": outcome.error_code,
                "message": outcome.message,
                "nights": dict(outcome.counts),
                "files": _by_fate(outcome.files),
                "growing": outcome.growing,
            }
            say(json.dumps(line))
            return
        why = f": {outcome.message}" if outcome.message and not outcome.error_code else ""
        say(f"{outcome.motor_id}: {outcome.status} ({counts or 'nothing to do'}){why}")
        if outcome.error_code:
            say(f"{outcome.motor_id}: {outcome.error_code}: {outcome.message}", err=True)
        for message in outcome.growing:
            say(f"{outcome.motor_id}: log_growing: {message}", err=True)

    def summary(self, result: RunResult, output: Path) -> None:
        """The run has finished."""
        if self.as_json:
            line = {
                "event": "run",
                "run_id": result.run_id,
                "n_motors": len(result.outcomes),
                "n_failed": len(result.failed),
                "n_standing": result.n_standing,
                "n_nights": result.n_nights,
                "files": _by_fate(result.files),
                "interrupted": result.interrupted,
                "seconds": round(result.seconds, 3),
                "seconds_by_stage": {
                    name: round(seconds, 3) for name, seconds in _by_stage(result).items()
                },
                "errors": _by_code(result),
                "damage": [asdict(fault) for fault in result.damage],
                "damage_left": [asdict(fault) for fault in result.damage_left],
                "alarms": [
                    {name: row[name] for name in ("motor_id", "indicator", "to_state", "reason")}
                    for row in result.alarms
                ],
            }
            say(json.dumps(line))
            return
        state = "interrupted; " if result.interrupted else ""
        files = ", ".join(f"{n} {fate}" for fate, n in _by_fate(result.files).items())
        say(
            f"{state}{counted(result.n_nights, 'night')} of "
            f"{counted(len(result.outcomes), 'motor')} in {result.seconds:.1f} s, "
            f"{counted(len(result.failed), 'motor')} failed; logs: {files}; "
            f"tables in {output / 'tables'}"
        )
        taken = [(name, seconds) for name, seconds in _by_stage(result).items() if seconds >= 0.05]
        if taken:
            stages = ", ".join(f"{_words(name)} {seconds:.1f}" for name, seconds in taken)
            say(f"seconds by stage, summed over motors: {stages}")
        for code, count in _by_code(result).items():
            say(f"{code}: {counted(count, 'motor')}")
        if result.n_standing:
            stand = "failure stands" if result.n_standing == 1 else "failures stand"
            say(f"{result.n_standing} {stand}: mend or remove the logs, then fit-fleet --retry")
        for fault in result.damage_left:
            say(f"motor-leakage: {fault}", err=True)
        if result.damage:
            n, left = counted(len(result.damage), "file"), len(result.damage_left)
            say(f"damaged or missing: {n}, of which not repaired: {left}")
        for row in result.alarms:
            # A new baseline needs no attention; `alarms` has it.
            if row["way"] != "baseline":
                rules = f" (change of rules: {row['rules']})" if row["rules"] else ""
                say(
                    f"{row['motor_id']}: {row['indicator']}: {row['to_state']}: {row['reason']}"
                    f"{rules}"
                )


def _bar(n_motors: int) -> Progress:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    words = (
        TextColumn("motors"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.description}"),
    )
    bar = Progress(*words, console=Console(stderr=True))
    bar.add_task("", total=n_motors)
    return bar


def _by_stage(result: RunResult) -> dict[str, float]:
    """Seconds by stage: those of the motors' tasks added up, then those of the run."""
    from collections import Counter

    from pipeline.run.run_rows import MOTOR_STAGES

    spent = Counter[str]()
    for outcome in result.outcomes:
        spent.update(outcome.seconds)
    return {name: spent[name] for name in MOTOR_STAGES} | dict(result.seconds_by_stage)


def _words(stage: str) -> str:
    """Name of a stage for people."""
    names = {"motors_s": "all motors", "publish_s": "publishing", "store_s": "staging"}
    return names.get(stage, stage.removesuffix("_s"))


def _by_code(result: RunResult) -> dict[str, int]:
    """Motors that failed by the code of their first failure."""
    from collections import Counter

    return dict(sorted(Counter(one.error_code or "" for one in result.failed).items()))


def _by_fate(files: Mapping[str, int]) -> dict[str, int]:
    """Log files by outcome: every possible outcome, in a fixed order."""
    from pipeline.logs.motor_logs import FATES

    return {fate: files.get(fate, 0) for fate in FATES}
