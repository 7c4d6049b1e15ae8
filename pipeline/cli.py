"""The command `motor-leakage`. Heavy imports wait until a command needs them."""

from __future__ import annotations

import datetime as dt
import json
import logging
import os
import signal
import sys
from dataclasses import asdict, replace
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from pipeline.errors import LockedError, MotorLeakageError, UsageError

if TYPE_CHECKING:
    from pipeline.channel_check import ChannelCheck
    from pipeline.check import MotorCheck
    from pipeline.config import Fleet
    from pipeline.fleet import RunResult
    from pipeline.motor_task import MotorOutcome

EXIT_OK, EXIT_MOTORS_FAILED, EXIT_USAGE, EXIT_LOCKED, EXIT_NOTHING_PUBLISHED = 0, 1, 2, 3, 4
EXIT_INTERRUPTED, EXIT_TERMINATED = 130, 143

app = typer.Typer(
    name="motor-leakage",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)

ConfigFile = Annotated[
    Path, typer.Argument(metavar="CONFIG", help="The fleet file, such as demo/configs/fleet.toml.")
]
AsJson = Annotated[bool, typer.Option("--json", help="One JSON object a line, for programs.")]


def _print_version(wanted: bool) -> None:
    from importlib.metadata import version

    if wanted:
        typer.echo(f"motor-leakage {version('motor-leakage')}")
        raise typer.Exit


@app.callback()
def options(
    _version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Say the version."),
    ] = False,
) -> None:
    """Nightly grey-box leakage estimates for a fleet of radial piston hydraulic motors."""


@app.command("fit-fleet")
def fit_fleet(
    config: ConfigFile,
    output: Annotated[
        Path | None, typer.Option(help="Output folder, instead of the config's.")
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Motors fitted at the same time.")] = None,
    motors: Annotated[
        str, typer.Option(help="Ids of the motors to do, with blanks between; all if empty.")
    ] = "",
    since: Annotated[str | None, typer.Option(help="First night to do, YYYY-MM-DD.")] = None,
    until: Annotated[str | None, typer.Option(help="Last night to do, YYYY-MM-DD.")] = None,
    as_json: AsJson = False,
) -> None:
    """Fit every new night of the fleet's motors and write the tables.

    Example: motor-leakage fit-fleet demo/configs/fleet.toml --jobs 2 --since 2026-01-02

    Exit code 0: no motor failed; 1: at least one did, the others are done; 2: wrong usage or
    config; 3: another run holds the output; 4: nothing could be published.
    """
    from pipeline.fleet import RunRequest, run_fleet

    fleet = _load(config, output, jobs)
    request = RunRequest(
        fleet=fleet,
        motors=_known_motors(motors.split(), fleet),
        since=_night(since, "--since"),
        until=_night(until, "--until"),
    )
    if request.since and request.until and request.since > request.until:
        raise UsageError("date", f"--since {since} is after --until {until}; no night lies between")
    terminated = _catch_termination()
    try:
        with _Reporter(as_json, len(request.motors) or len(fleet.motors)) as reporter:
            result = run_fleet(request, reporter.motor)
            reporter.summary(result, fleet.output)
        interrupted = result.interrupted
    except KeyboardInterrupt:  # while publishing: what is not yet published is done anew
        interrupted = True
    if interrupted:
        raise typer.Exit(EXIT_TERMINATED if terminated else EXIT_INTERRUPTED)
    raise typer.Exit(EXIT_MOTORS_FAILED if result.failed else EXIT_OK)


@app.command()
def check(
    config: Annotated[
        Path | None, typer.Argument(metavar="CONFIG", help="The fleet file; not with --suggest.")
    ] = None,
    as_json: AsJson = False,
    suggest: Annotated[
        Path | None,
        typer.Option(metavar="LOG", help="Print the TOML that reads this log, to paste."),
    ] = None,
) -> None:
    """Check the config of a fleet and look at the ends of each log; nothing is fitted.

    Example: motor-leakage check demo/configs/fleet.toml

    Example: motor-leakage check --suggest demo/logs/CB400-01/CB400-01_2026-01-03.csv

    Exit code 0: no fault; 1: a log cannot be read; 2: a fault in the config.
    """
    from pipeline.check import check_fleet

    if suggest is not None:
        from pipeline.ingest.suggest import suggest as suggested

        typer.echo(suggested(suggest), nl=False)
        return
    if config is None:
        raise UsageError("config", "name the fleet file, or a log with --suggest")
    fleet = _load(config, None, None)
    checks = check_fleet(fleet)
    if as_json:
        for one in checks:
            typer.echo(json.dumps(asdict(one)))
    else:
        _print_checks(checks)
    raise typer.Exit(EXIT_MOTORS_FAILED if any(one.faults for one in checks) else EXIT_OK)


@app.command()
def explain(
    config: ConfigFile,
    motor: Annotated[str, typer.Argument(help="The motor's id.")],
    night: Annotated[str, typer.Argument(help="The night's label, YYYY-MM-DD.")],
    output: Annotated[
        Path | None, typer.Option(help="Output folder, instead of the config's.")
    ] = None,
) -> None:
    """Say in words why a motor's night has the figures it has, or none.

    Example: motor-leakage explain demo/configs/fleet.toml CB560-01 2026-01-03
    """
    from pipeline.explain import explain as explained

    fleet = _load(config, output, None)
    _known_motors([motor], fleet)
    label = _night(night, "NIGHT")
    assert label is not None
    for line in explained(fleet.output, motor, label):
        typer.echo(line)


@app.command()
def fit(
    config: ConfigFile,
    motor: Annotated[str, typer.Argument(help="The motor's id.")],
    night: Annotated[str, typer.Argument(help="The night's label, YYYY-MM-DD.")],
) -> None:
    """Fit one motor's night from its logs and say what came of it; nothing is published.

    Example: motor-leakage fit demo/configs/fleet.toml CB560-01 2026-01-03
    """
    from tempfile import TemporaryDirectory

    from pipeline.explain import explain as explained
    from pipeline.fleet import RunRequest, run_fleet

    label = _night(night, "NIGHT")
    assert label is not None
    with TemporaryDirectory() as folder:
        fleet = _load(config, Path(folder), None)
        request = RunRequest(fleet, _known_motors([motor], fleet), since=label, until=label)
        result = run_fleet(request)
        (outcome,) = result.outcomes
        if label not in outcome.nights:
            _refuse_night(fleet, outcome, label)
        for line in explained(fleet.output, motor, label):
            typer.echo(line)
    raise typer.Exit(EXIT_MOTORS_FAILED if result.failed else EXIT_OK)


def _refuse_night(fleet: Fleet, outcome: MotorOutcome, label: dt.date) -> NoReturn:
    """Say why there is nothing to fit in a night."""
    from pipeline.check import check_motor

    motor = outcome.motor_id
    if outcome.error_code:
        _say(f"{motor}: {outcome.error_code}: {outcome.message}", err=True)
        raise typer.Exit(EXIT_MOTORS_FAILED)
    (spec,) = (one for one in fleet.motors if one.motor_id == motor)
    seen = check_motor(spec)
    there = f"they cover {seen.first} to {seen.last}" if seen.first else "; ".join(seen.notes)
    raise UsageError("unknown_night", f"no log of {motor} covers the night of {label}: {there}")


@app.command()
def demo(
    folder: Annotated[Path, typer.Argument(help="Folder to write; it is made.")],
    nights: Annotated[int, typer.Option(min=1, help="Nights of logs.")] = 75,
    minutes: Annotated[float, typer.Option(min=1.0, help="Minutes of log a night.")] = 90.0,
    rate: Annotated[float, typer.Option(min=0.1, help="Samples a second.")] = 5.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the simulation.")] = 1,
    jobs: Annotated[int, typer.Option(min=1, help="Worker processes.")] = 2,
) -> None:
    """Write a simulated fleet: config, logs in three formats, and the truth beside them.

    Example: motor-leakage demo demo --nights 3

    The examples of the other commands are of this fleet. Its tables go to demo/out/.
    """
    from pipeline.demo import write_demo

    write_demo(folder, nights=nights, minutes=minutes, rate_hz=rate, seed=seed, workers=jobs)
    typer.echo(f"demo fleet written to {folder}; its config is {folder / 'configs' / 'fleet.toml'}")


def _load(config: Path, output: Path | None, jobs: int | None) -> Fleet:
    from pipeline.config import ConfigError, Fault, load_fleet

    fleet = load_fleet(config)
    if not fleet.log_root.is_dir():
        fault = Fault(config.name, "folders.logs", f"expected a folder at {fleet.log_root}")
        raise ConfigError([fault])
    if output is not None:
        fleet = replace(fleet, output=output.resolve())
    if jobs is not None:
        fleet = replace(fleet, execution=fleet.execution.model_copy(update={"workers": jobs}))
    return fleet


def _known_motors(wanted: list[str], fleet: Fleet) -> tuple[str, ...]:
    known = {spec.motor_id for spec in fleet.motors}
    strangers = sorted(set(wanted) - known)
    if strangers:
        raise UsageError(
            "unknown_motor",
            f"--motors: no motor {', '.join(strangers)}; there are {', '.join(sorted(known))}",
        )
    return tuple(wanted)


def _night(text: str | None, option: str) -> dt.date | None:
    try:
        return None if text is None else dt.date.fromisoformat(text)
    except ValueError:
        raise UsageError("date", f"{option}: got {text!r}; expected YYYY-MM-DD") from None


def _catch_termination() -> list[int]:
    """Let SIGTERM end a run as SIGINT does; the list tells afterwards that it came."""
    came: list[int] = []

    def stop(number: int, _: FrameType | None) -> None:
        came.append(number)
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, stop)
    return came


def _say(line: str, *, err: bool = False) -> None:
    """Print a line; that nobody reads on must not end a run."""
    try:
        typer.echo(line, err=err)
    except BrokenPipeError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, (sys.stderr if err else sys.stdout).fileno())
        os.close(nowhere)


class _Reporter:
    """Says how a run goes: a bar on a terminal, plain lines elsewhere, JSON if asked for."""

    def __init__(self, as_json: bool, n_motors: int) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

        self.as_json = as_json
        self.console = Console(stderr=True)
        self.bar = Progress(
            TextColumn("motors"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.description}"),
            console=self.console,
            disable=as_json or not self.console.is_terminal,
        )
        self.task = self.bar.add_task("", total=n_motors)

    def __enter__(self) -> _Reporter:
        self.bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.stop()

    def motor(self, outcome: MotorOutcome) -> None:
        """A motor has finished."""
        self.bar.update(self.task, advance=1, description=outcome.motor_id)
        counts = ", ".join(f"{n} {status}" for status, n in sorted(outcome.counts.items()))
        if self.as_json:
            line = {
                "event": "motor",
                "motor_id": outcome.motor_id,
                "status": outcome.status,
                "error_code": outcome.error_code,
                "message": outcome.message,
                "nights": dict(outcome.counts),
            }
            _say(json.dumps(line))
            return
        why = f": {outcome.message}" if outcome.message and not outcome.error_code else ""
        _say(f"{outcome.motor_id}: {outcome.status} ({counts or 'nothing to do'}){why}")
        if outcome.error_code:
            _say(f"{outcome.motor_id}: {outcome.error_code}: {outcome.message}", err=True)

    def summary(self, result: RunResult, output: Path) -> None:
        """The run has finished."""
        if self.as_json:
            line = {
                "event": "run",
                "run_id": result.run_id,
                "n_motors": len(result.outcomes),
                "n_failed": len(result.failed),
                "n_nights": result.n_nights,
                "interrupted": result.interrupted,
                "seconds": round(result.seconds, 3),
            }
            _say(json.dumps(line))
            return
        state = "interrupted; " if result.interrupted else ""
        _say(
            f"{state}{result.n_nights} nights of {len(result.outcomes)} motors in "
            f"{result.seconds:.1f} s, {len(result.failed)} motors failed; "
            f"tables in {output / 'tables'}"
        )


def _print_checks(checks: tuple[MotorCheck, ...]) -> None:
    for one in checks:
        span = f", {one.first} to {one.last}" if one.first else ""
        typer.echo(
            f"{one.motor_id}: {one.motor_type}, {one.log_format}, {one.n_files} files, "
            f"{one.n_nights} nights{span}, {len(one.faults)} faults"
        )
        for channel in one.channels:
            typer.echo(f"  {_channel_line(channel)}")
        for note in one.notes:
            typer.echo(f"  {note}")
        for fault in one.faults:
            typer.echo(f"{one.motor_id}: {fault}", err=True)
    placeholders = sorted({name for one in checks for name in one.placeholders})
    if placeholders:
        typer.echo(
            "placeholders, to be replaced with the manufacturer's values: "
            f"{', '.join(placeholders)}"
        )


def _channel_line(channel: ChannelCheck) -> str:
    """A channel in a line: rate, typical value, what is missing or refused, what it looks like."""
    from pipeline.units import canonical_unit

    parts = [f"{channel.channel}:"]
    parts.append(f"{channel.rate_hz:.3g} Hz," if channel.rate_hz else "no rate,")
    unit = canonical_unit(channel.channel).replace("degC", "°C")
    median = f"median {channel.median:.4g} {unit},"
    parts.append("no value," if channel.median is None else median)
    parts.append(f"{100 * channel.share_missing:.2g} % missing,")
    parts.append(f"{100 * channel.share_refused:.2g} % refused")
    rules = ", ".join(f"{name} {100 * share:.2g} %" for name, share in channel.refused_by.items())
    parts.append(f"({rules})" if rules else "")
    line = " ".join(part for part in parts if part)
    looks = f", looks {channel.looks}" if channel.looks else ""
    line += f"; configured as {channel.configured}{looks}"
    return line + "".join(f"; LOOK: {remark}" for remark in channel.remarks)


def _exit_code(error: MotorLeakageError) -> int:
    from pipeline.config import ConfigError

    if isinstance(error, UsageError | ConfigError):
        return EXIT_USAGE
    return EXIT_LOCKED if isinstance(error, LockedError) else EXIT_NOTHING_PUBLISHED


def main() -> NoReturn:
    """Run the command; every expected error is one message on stderr and a stated exit code."""
    logging.basicConfig(format="%(levelname)s %(name)s: %(message)s", stream=sys.stderr)
    try:
        app()
    except MotorLeakageError as error:
        typer.echo(f"motor-leakage: {error.code}: {error}", err=True)
        sys.exit(_exit_code(error))
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)
    sys.exit(EXIT_OK)
