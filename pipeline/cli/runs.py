"""Commands that fit: a fleet, what failed of it, one motor's night."""

from __future__ import annotations

import datetime as dt
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, NoReturn

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
    require_order,
    say,
)
from pipeline.cli.reporter import print_plan, print_summary, progress
from pipeline.errors import MotorLeakageError, UsageError

if TYPE_CHECKING:
    from pipeline.config import Fleet
    from pipeline.run.fleet import RunRequest
    from pipeline.run.tasks import MotorOutcome


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
    force: Annotated[
        bool, typer.Option("--force", help="Make nights anew from their logs though unchanged.")
    ] = False,
    retry: Annotated[
        bool, typer.Option("--retry", help="Try nights and logs again that failed.")
    ] = False,
) -> None:
    """Fit every new night of the fleet's motors and write the tables.

    Example: motor-leakage fit-fleet configs/fleet.toml --jobs 2 --since 2026-01-02

    A night or log that failed stands as failed, and is not tried again while it is unchanged, but
    with --retry. A failed night whose log was removed fails no more.

    Exit code 0: no failure stands; 1: one does, the others are done, or published rows are lost;
    2: wrong usage or config; 3: another run holds the output; 4: nothing could be published.
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
            force=force,
            retry=retry,
        )
        if dry_run:
            print_plan(request, as_json=as_json)
        else:
            _repeat_check(fleet, as_json=as_json)
            _run(request, as_json=as_json, fail_on_alarm=fail_on_alarm)


def _repeat_check(fleet: Fleet, *, as_json: bool) -> None:
    """Say what `check` says of the logs: those without a motor, and before the first run, which
    opens them all, what may be wrong with units and columns. What cannot be read the run says."""
    from pipeline.logs.finding import strays_told, unclaimed

    if as_json:
        return
    if strays := strays_told(unclaimed(fleet)):
        say(strays, err=True)
    if (fleet.output / "tables").is_dir() or fleet.log_url:
        return
    from pipeline.setup.check import check_motor
    from pipeline.setup.operation import SWAPPED

    for spec in (one for one in fleet.motors if one.file.logs.database is None):
        seen = check_motor(spec)
        for told in (*seen.faults, *seen.notes):
            if told.startswith(("unit_", "column")) or told.endswith(SWAPPED):
                say(f"{spec.motor_id}: {told}", err=True)


def _run(request: RunRequest, *, as_json: bool, fail_on_alarm: bool) -> NoReturn:
    """Run a fleet, say how it goes, and end with the exit code."""
    from pipeline.run.fleet import run_fleet

    with progress(len(request.specs), as_json=as_json) as finished:
        result = run_fleet(request, finished)
    print_summary(request, result, as_json=as_json)
    if result.interrupted:
        raise KeyboardInterrupt
    alarmed = fail_on_alarm and any(row["to_state"] == "alarm" for row in result.alarms)
    failed = result.failed or result.n_standing or result.damage_left or alarmed
    raise typer.Exit(EXIT_MOTORS_FAILED if failed else EXIT_OK)


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
    """Fit one motor's night from its logs and say what came of it; nothing is published.

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

    from pipeline.report.audit import audit
    from pipeline.report.explain import explain as explained
    from pipeline.run.fleet import RunRequest, run_fleet

    with TemporaryDirectory() as folder:
        fleet = replace(load(config, Path(folder), None), object_store="")
        request = RunRequest(fleet, fleet.known_motors([motor]), since=night, until=night)
        result = run_fleet(request)
        growing = [one for outcome in result.outcomes for one in outcome.growing]
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
    from pipeline.notebook.preparing import fit_periods

    try:
        found, prepared = fit_periods(load(config, None, None), motor, train, validate)
    except LeakageError as error:
        say(f"{motor}: {error.code}: {error}", err=True)
        raise typer.Exit(EXIT_MOTORS_FAILED) from None
    for note in prepared.notes:
        typer.echo(note)
    typer.echo(str(found.summary()))


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


class _Terminated(KeyboardInterrupt):
    """SIGTERM came. Python itself dies of a bare KeyboardInterrupt that came while it loaded."""


@contextmanager
def stoppable() -> Iterator[None]:
    """Let SIGTERM end a command as SIGINT does, each with its exit code.

    What a run is not done with is done by the next one.
    """
    came: list[int] = []

    def stop(number: int, _: FrameType | None) -> None:
        came.append(number)
        raise _Terminated

    signal.signal(signal.SIGTERM, stop)
    try:
        yield
    except KeyboardInterrupt:
        raise typer.Exit(EXIT_TERMINATED if came else EXIT_INTERRUPTED) from None
