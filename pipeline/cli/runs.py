"""Commands that fit: a fleet, what failed of it, a motor's night."""

from __future__ import annotations

import datetime as dt
import signal
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from pipeline.cli.arguments import (
    EXIT_INTERRUPTED,
    EXIT_MOTORS_FAILED,
    EXIT_OK,
    EXIT_TERMINATED,
    AsJson,
    ConfigFile,
    Jobs,
    Motor,
    Motors,
    Output,
    Since,
    Until,
    day,
    load,
    nights,
    progress_bar,
    repeat,
    require_order,
    say,
    tell,
)
from pipeline.errors import MotorLeakageError, UsageError
from pipeline.messages import counted

if TYPE_CHECKING:
    from pipeline.config import Fleet
    from pipeline.run.fleet import RunRequest, RunResult
    from pipeline.run.tasks import MotorOutcome
    from pipeline.store.published import TableFault
    from pipeline.workers.process import Mark

# Reasons of a plan that are listed.
PLAN_REASONS = 8
# Logs of a motor whose left-out rows are named.
LEFT_OUT = 3


def fit_fleet(
    config: ConfigFile,
    output: Output = None,
    jobs: Jobs = None,
    motors: Motors = "",
    since: Since = None,
    until: Until = None,
    as_json: AsJson = False,
    fail_on_alarm: Annotated[
        bool, typer.Option("--fail-on-alarm", help="End with 1 if the run raised an alarm.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say what would be done, and why; do nothing.")
    ] = False,
    redo: Annotated[
        str | None,
        typer.Option(
            help="Make a night, or A..B, anew from the logs there are, whatever they lack."
        ),
    ] = None,
    retry: Annotated[
        bool, typer.Option("--retry", help="Try nights and logs again that failed.")
    ] = False,
    repair: Annotated[
        bool,
        typer.Option("--repair", help="Compare all table files before; make anew what is bad."),
    ] = False,
) -> None:
    """Fit every new night of the fleet's motors and write the tables.

    Example: motor-leakage fit-fleet configs/fleet.toml --jobs 2 --since 2026-01-02

    What is published stays: a night is made anew only from logs that cover at least what it was
    made from. With --redo it is made from whatever there is.

    A night or log that failed stands as failed, and is not tried again while it is unchanged, but
    with --retry. A failed night whose log was removed fails no more.

    Exit code 0: no failure stands; 1: a failure stands, or no motor has any log, or
    published rows are lost, or they were not copied to folders.copy_to; 2: wrong usage or config;
    3: another run holds the output; 4: nothing could be published.
    """
    with stoppable():
        from pipeline.run.fleet import RunRequest

        fleet = load(config, output, jobs)
        require_order(since, until)
        request = RunRequest(
            fleet=fleet,
            motors=fleet.known_motors(motors.split()),
            since=since,
            until=until,
            redo=None if redo is None else nights(redo),
            retry=retry,
            repair=repair,
            first_look=_first_findings,
        )
        if dry_run:
            print_plan(request, as_json=as_json)
            return
        _run(request, as_json=as_json, fail_on_alarm=fail_on_alarm)


def _first_findings(*look: Any) -> Iterator[str]:
    """Look at the first run of a motor as `columns.first_findings`, loaded only then."""
    from pipeline.setup.columns import first_findings

    return first_findings(*look)


def _run(request: RunRequest, *, as_json: bool, fail_on_alarm: bool) -> NoReturn:
    """Run a fleet, say how it goes, and end with the exit code."""
    from pipeline.logs.finding import strays_text, unclaimed_logs
    from pipeline.logs.processed import same_logs
    from pipeline.run.fleet import run_fleet
    from pipeline.store.state import read_state_file

    progress = RunProgress(len(request.specs), as_json=as_json)
    with (
        progress_bar("nights", is_shown=not as_json) as draw,
        repeat(lambda: draw(*progress.nights)),
    ):
        result = run_fleet(request, progress.finished, progress.watched)
    print_summary(request, result, as_json=as_json)
    if not as_json and (strays := strays_text(unclaimed_logs(request.fleet))):
        say(strays, err=True)
    with read_state_file(request.fleet.output) as state:
        for words in same_logs(state):
            tell({"event": "same_logs", "words": words}, words, as_json=as_json, err=True)
    if result.interrupted:
        raise KeyboardInterrupt
    alarmed = fail_on_alarm and any(row["to_state"] == "alarm" for row in result.alarms)
    faults = result.damage_left or result.copy_fault
    is_sound = result.is_good and not faults
    raise typer.Exit(EXIT_OK if is_sound and not alarmed else EXIT_MOTORS_FAILED)


def fit(
    config: ConfigFile,
    motor: Motor,
    night: Annotated[
        dt.date | None,
        typer.Argument(parser=day, help="The night's label, YYYY-MM-DD; without --train."),
    ] = None,
    train: Annotated[str | None, typer.Option(help="Nights to fit to, A..B.")] = None,
    validate: Annotated[
        str | None, typer.Option(help="Nights to judge the fit on, C..D; with --train.")
    ] = None,
) -> None:
    """Fit a motor's night from its logs and say what came of it; nothing is published.

    An audit follows: the search of the thesis from several starts, and information criteria.

    With --train the motor is fitted to several nights of its logs, and judged on others with
    --validate.

    Example: motor-leakage fit configs/fleet.toml CB560-01 2026-01-03

    Example: motor-leakage fit configs/fleet.toml CB560-01 --train 2026-01-02..2026-01-04
    --validate 2026-01-06..2026-01-07
    """
    if train is not None and night is None:
        _fit_periods(config, motor, train, validate)
        return
    if train or validate or night is None:
        raise UsageError("period", "expected a NIGHT, or --train and perhaps --validate")
    from tempfile import TemporaryDirectory

    from pipeline.logs.processed import paired_as_published
    from pipeline.report.explain import audit
    from pipeline.report.explain import explain as explained
    from pipeline.run.fleet import RunRequest, run_fleet

    with TemporaryDirectory() as folder:
        published = load(config, None, None).output
        fleet = paired_as_published(load(config, Path(folder), None), published)
        request = RunRequest(fleet, fleet.known_motors([motor]), since=night, until=night)
        result = run_fleet(request)
        growing = [log for outcome in result.outcomes for log in outcome.growing]
        if growing and not result.n_nights:
            raise MotorLeakageError("log_growing", f"the night waits: {'; '.join(growing)}")
        (outcome,) = result.outcomes
        if night not in outcome.nights:
            _refuse_night(fleet, outcome, night)
        for line in (*explained(fleet.output, motor, night), *audit(fleet, motor, night)):
            typer.echo(line)
    raise typer.Exit(EXIT_MOTORS_FAILED if result.failed else EXIT_OK)


def _fit_periods(config: Path, motor: str, train: str, validate: str | None) -> None:
    """Fit a motor to a period, and say what came of it."""
    from leakage.errors import LeakageError
    from pipeline.logs.processed import paired_as_published
    from pipeline.notebook import fit_periods

    try:
        fleet = load(config, None, None)
        fleet = paired_as_published(fleet, fleet.output)
        result, prepared = fit_periods(fleet, motor, train, validate)
    except LeakageError as error:
        say(f"{motor}: {error.code}: {error}", err=True)
        raise typer.Exit(EXIT_MOTORS_FAILED) from None
    for note in prepared.notes:
        typer.echo(note)
    typer.echo(str(result.summary()))


def _refuse_night(fleet: Fleet, outcome: MotorOutcome, label: dt.date) -> NoReturn:
    """Say why there is nothing to fit in a night."""
    from pipeline.setup.check import check_motor

    motor = outcome.motor_id
    if outcome.error_code:
        say(f"{motor}: {outcome.error_code}: {outcome.message}", err=True)
        raise typer.Exit(EXIT_MOTORS_FAILED)
    seen = check_motor(fleet.motor(motor))
    there = f"they cover {seen.first} to {seen.last}" if seen.first else "; ".join(seen.notes)
    raise UsageError("unknown_night", f"no log of {motor} covers the night of {label}: {there}")


def print_plan(request: RunRequest, *, as_json: bool) -> None:
    """Print the nights that a run would do by motor, with the reasons."""
    from pipeline.run.night_plan import plan_fleet, plan_states, plan_trends
    from pipeline.run.tasks import Work
    from pipeline.store.published import faults_of

    total, stays = 0, set[str]()
    for motor_id, plan in plan_fleet(request):
        n_stays = sum(step.work is Work.STAY for step in plan.values())
        total += len(plan) - n_stays
        stays |= {motor_id} if n_stays else set()
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
    changed = dict(plan_trends(request))
    for motor_id, why in changed.items():
        event = {"event": "plan_trends", "motor_id": motor_id, "reason": why}
        tell(event, f"{motor_id}: all trends redone: {why}", as_json=as_json)
    for motor_id, words in plan_states(request, changed, stays):
        event = {"event": "plan_state", "motor_id": motor_id, "state": words}
        tell(event, f"{motor_id}: {words}", as_json=as_json)
    tell_faults(faults_of(request.fleet.output), as_json=as_json)
    if not as_json:
        say(f"to be done: {counted(total, 'night')}")


def tell_faults(faults: Iterable[TableFault], *, as_json: bool) -> None:
    """Print damaged files of the output."""
    for fault in faults:
        event = {"event": "table_fault", **asdict(fault)}
        tell(event, f"motor-leakage: {fault}", as_json=as_json, err=True)


class RunProgress:
    """Prints each motor as it finishes, and knows how many nights are done."""

    def __init__(self, n_motors: int, *, as_json: bool) -> None:
        self.n_motors, self.as_json = n_motors, as_json
        self.n_finished, self.nights_finished = 0, 0
        self.marks: Callable[[], Sequence[Mark]] = tuple

    def finished(self, outcome: MotorOutcome) -> None:
        """Take the outcome of a motor."""
        self.n_finished += 1
        self.nights_finished += sum(outcome.counts.values())
        _print_motor(outcome, as_json=self.as_json)

    def watched(self, marks: Callable[[], Sequence[Mark]]) -> None:
        """Take what gives the marks of the motors under way."""
        self.marks = marks

    @property
    def nights(self) -> tuple[int, int]:
        """Nights that are done, and how many there are: of motors to come the mean."""
        marks = [mark for mark in self.marks() if mark.n_left]
        done = self.nights_finished + sum(mark.n_done for mark in marks)
        known = done + sum(mark.n_left for mark in marks)
        begun = min(self.n_finished + len(marks), self.n_motors)
        return done, round(known * self.n_motors / begun) if begun else self.n_motors


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
        "anew": outcome.anew,
        "files": _by_fate(outcome.files),
        "growing": outcome.growing,
        "left_out": outcome.left_out,
        "findings": outcome.findings,
        "stays": {str(label): stay for label, stay in outcome.stays.items()},
    }
    anew = f"; {outcome.anew}" if outcome.anew else ""
    words = f"{motor_id}: {outcome.status} ({counts or 'nothing to do'}){why}{anew}"
    tell(event, words, as_json=as_json)
    if as_json:
        return
    if code:
        say(f"{motor_id}: {code}: {message}", err=True)
    for growing in outcome.growing:
        say(f"{motor_id}: log_growing: {growing}", err=True)
    from pipeline.logs.processed import stay_lines

    for line in stay_lines(outcome.stays):
        say(f"{motor_id}: {line}", err=True)
    for left in outcome.left_out[:LEFT_OUT]:
        say(f"{motor_id}: left out of {left}", err=True)
    if len(outcome.left_out) > LEFT_OUT:
        others = counted(len(outcome.left_out) - LEFT_OUT, "other log")
        say(f"{motor_id}: and of {others}; `explain` says it of a night", err=True)


def print_summary(request: RunRequest, result: RunResult, *, as_json: bool) -> None:
    """Print what a run has done."""
    files = _by_fate(result.files)
    errors = dict(sorted(Counter(outcome.error_code or "" for outcome in result.failed).items()))
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
            "copy_fault": result.copy_fault,
            "alarms": [
                {name: row[name] for name in ("motor_id", "cause", "to_state", "sentence")}
                for row in result.alarms
            ],
        }
        tell(event, "", as_json=True)
        return
    for outcome in result.outcomes:
        for finding in outcome.findings:
            say(f"{outcome.motor_id}: {finding}", err=True)
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
        say(f"{n} {stand}: mend the logs or the config, then fit-fleet --retry")
    tell_faults(result.damage_left, as_json=False)
    if result.damage:
        n_files, left = counted(len(result.damage), "file"), len(result.damage_left)
        say(f"damaged or missing: {n_files}, of which not repaired: {left}")
    if result.copy_fault:
        place = request.fleet.copy_to
        say(f"not copied to {place}: {result.copy_fault}; the next run copies it", err=True)
    from pipeline.notification.outbox import is_notified

    for row in result.alarms:
        # A new baseline needs no attention; `alarms` has it.
        if is_notified(row):
            say(f"{row['motor_id']}: {row['to_state']}: {row['sentence']}")


def _by_stage(result: RunResult) -> dict[str, float]:
    """Return seconds by stage: those of the motors' tasks added up, then those of the run."""
    from pipeline.run.publishing import MOTOR_STAGES

    spent = Counter[str]()
    for outcome in result.outcomes:
        spent.update(outcome.seconds)
    stages = {name: spent[name] for name in MOTOR_STAGES} | dict(result.seconds_by_stage)
    return {name: round(seconds, 3) for name, seconds in stages.items()}


def _by_fate(files: Mapping[str, int]) -> dict[str, int]:
    """Return log files by outcome: every possible outcome, in a fixed order."""
    from pipeline.logs.motor_logs import FATES

    return {fate: files.get(fate, 0) for fate in FATES}


class _Stopped(KeyboardInterrupt):
    """A signal came. Of a bare KeyboardInterrupt that came while it loaded, Python itself dies."""


@contextmanager
def stoppable() -> Iterator[None]:
    """Let SIGTERM end a command as SIGINT does, each with its exit code.

    What a run is not done with is done by the next run.
    """
    received: list[int] = []

    def stop(number: int, _: FrameType | None) -> None:
        received.append(number)
        raise _Stopped

    signal.signal(signal.SIGTERM, stop)
    # Python leaves it ignored where the run was started in the background.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, stop)
    try:
        yield
    except KeyboardInterrupt:
        is_terminated = signal.SIGTERM in received
        raise typer.Exit(EXIT_TERMINATED if is_terminated else EXIT_INTERRUPTED) from None
