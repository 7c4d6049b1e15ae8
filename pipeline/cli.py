"""The command `motor-leakage`. Heavy imports wait until a command needs them."""

from __future__ import annotations

import datetime as dt
import json
import logging
import os
import signal
import sys
from collections.abc import Mapping
from dataclasses import asdict, replace
from enum import StrEnum
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from pipeline.errors import LockedError, MotorLeakageError, UsageError

if TYPE_CHECKING:
    from pipeline.channel_check import ChannelCheck
    from pipeline.check import MotorCheck
    from pipeline.config import Fleet
    from pipeline.fleet import RunRequest, RunResult
    from pipeline.motor_task import MotorOutcome
    from pipeline.report import KnownMotor

EXIT_OK, EXIT_MOTORS_FAILED, EXIT_USAGE, EXIT_LOCKED, EXIT_NOTHING_PUBLISHED = 0, 1, 2, 3, 4
EXIT_INTERRUPTED, EXIT_TERMINATED = 130, 143
# Reasons of a plan that are told one by one.
PLAN_REASONS = 8

app = typer.Typer(
    name="motor-leakage",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)


class ImageFormat(StrEnum):
    """Kinds of figures."""

    PNG = "png"
    SVG = "svg"


baseline_app = typer.Typer(no_args_is_help=True, help="Baselines of a motor.")
app.add_typer(baseline_app, name="baseline")

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
    fail_on_alarm: Annotated[
        bool, typer.Option("--fail-on-alarm", help="End with 1 if the run raised an alarm.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Say what would be done, and why; do nothing.")
    ] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Make nights anew from their logs though unchanged.")
    ] = False,
) -> None:
    """Fit every new night of the fleet's motors and write the tables.

    Example: motor-leakage fit-fleet demo/configs/fleet.toml --jobs 2 --since 2026-01-02

    Exit code 0: no motor failed; 1: at least one did, the others are done; 2: wrong usage or
    config; 3: another run holds the output; 4: nothing could be published.
    """
    from pipeline.fleet import RunRequest

    fleet = _load(config, output, jobs)
    request = RunRequest(
        fleet=fleet,
        motors=_known_motors(motors.split(), fleet),
        since=_night(since, "--since"),
        until=_night(until, "--until"),
        force=force,
    )
    _in_order(request.since, request.until)
    if dry_run:
        _print_plan(request, as_json)
        return
    _run(request, as_json, fail_on_alarm=fail_on_alarm)


@app.command()
def retry(
    config: ConfigFile,
    output: Annotated[
        Path | None, typer.Option(help="Output folder, instead of the config's.")
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Motors fitted at the same time.")] = None,
    motors: Annotated[
        str, typer.Option(help="Ids of the motors to do, with blanks between; all if empty.")
    ] = "",
    as_json: AsJson = False,
) -> None:
    """Try the nights and logs again that failed, and do what is new.

    A log that cannot be read is not tried again while it is unchanged; this does.

    Example: motor-leakage retry demo/configs/fleet.toml

    Exit codes as those of fit-fleet.
    """
    from pipeline.fleet import RunRequest

    fleet = _load(config, output, jobs)
    request = RunRequest(fleet, _known_motors(motors.split(), fleet), retry=True)
    _run(request, as_json)


def _run(request: RunRequest, as_json: bool, *, fail_on_alarm: bool = False) -> NoReturn:
    """Run a fleet, say how it goes, and end with the exit code."""
    from pipeline.fleet import run_fleet

    fleet = request.fleet
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
    alarmed = fail_on_alarm and any(row["to_state"] == "alarm" for row in result.alarms)
    raise typer.Exit(EXIT_MOTORS_FAILED if result.failed or alarmed else EXIT_OK)


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
    tables: Annotated[
        bool, typer.Option("--tables", help="Compare every table file with its manifest instead.")
    ] = False,
    output: Annotated[
        Path | None, typer.Option(help="Output folder of the tables, instead of the config's.")
    ] = None,
) -> None:
    """Check the config of a fleet and look at the ends of each log; nothing is fitted.

    Example: motor-leakage check demo/configs/fleet.toml

    Example: motor-leakage check --suggest demo/logs/CB400-01/CB400-01_2026-01-03.csv

    Exit code 0: no fault; 1: a log cannot be read; 2: a fault in the config.
    """
    from pipeline.check import check_fleet

    if tables:
        raise typer.Exit(_check_tables(config, output))
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
        fleet = replace(_load(config, Path(folder), None), object_store="")
        request = RunRequest(fleet, _known_motors([motor], fleet), since=label, until=label)
        result = run_fleet(request)
        growing = [one for outcome in result.outcomes for one in outcome.growing]
        if growing and not result.n_nights:
            raise MotorLeakageError("log_growing", f"the night waits: {'; '.join(growing)}")
        (outcome,) = result.outcomes
        if label not in outcome.nights:
            _refuse_night(fleet, outcome, label)
        for line in explained(fleet.output, motor, label):
            typer.echo(line)
    raise typer.Exit(EXIT_MOTORS_FAILED if result.failed else EXIT_OK)


def _print_plan(request: RunRequest, as_json: bool) -> None:
    """What a run would do: nights by motor, and why."""
    from collections import Counter

    from pipeline.fleet import plan_fleet

    total = 0
    for motor_id, plan in plan_fleet(request):
        total += len(plan)
        if as_json:
            nights = {
                str(label): {"work": step.work.value, "reason": step.reason}
                for label, step in plan.items()
            }
            _say(json.dumps({"event": "plan", "motor_id": motor_id, "nights": nights}))
            continue
        _say(f"{motor_id}: {len(plan)} nights" + (f", {min(plan)} to {max(plan)}" if plan else ""))
        reasons = Counter((step.work.value, step.reason) for step in plan.values())
        for (work, reason), count in reasons.most_common(PLAN_REASONS):
            _say(f"  {count} to {work}: {reason}")
        if len(reasons) > PLAN_REASONS:
            _say(f"  and {len(reasons) - PLAN_REASONS} other reasons; all of them with --json")
    if not as_json:
        _say(f"{total} nights would be done")


def _check_tables(config: Path | None, output: Path | None) -> int:
    """Compare the table files with their manifests; returns the exit code."""
    from pipeline.verification import verify_tables

    if config is None:
        raise UsageError("config", "name the fleet file whose tables are to be checked")
    folder = output.resolve() if output is not None else _loaded(config).output
    faults = 0
    for fault in verify_tables(folder):
        faults += 1
        _say(f"motor-leakage: {fault.code}: {fault.path}: {fault.message}", err=True)
    n_files = sum(1 for _ in (folder / "tables").glob("**/*.parquet"))
    _say(f"{n_files} table files, {faults} faults")
    return EXIT_MOTORS_FAILED if faults else EXIT_OK


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
def report(
    config: Annotated[
        Path | None,
        typer.Argument(metavar="CONFIG", help="The fleet file; the tables alone will do."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option(help="Output folder with the tables, instead of the config's.")
    ] = None,
    to: Annotated[
        Path | None, typer.Option(help="Folder of the report, instead of report/ in the output.")
    ] = None,
    motors: Annotated[
        str, typer.Option(help="Ids of the motors to show, with blanks between; needs --to.")
    ] = "",
    nights: Annotated[
        int | None, typer.Option(min=1, help="Newest nights to show one by one; all if left out.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Nights made at the same time.")] = 2,
) -> None:
    """Write the report: pages for the fleet and each motor that open without a server.

    Example: motor-leakage report demo/configs/fleet.toml

    Then open demo/out/report/index.html. A further run makes only what has changed. Exit code 1: a
    table file could not be read; the rest is there.
    """
    from pipeline.report import ReportRequest, build_report

    fleet = None if config is None else _loaded(config)
    if motors and to is None:
        raise UsageError(
            "report_motors", "--motors needs --to: the fleet's own report shows all motors"
        )
    tables = (output or (fleet.output if fleet else Path("out"))).resolve()
    result = build_report(
        ReportRequest(
            output=tables,
            folder=to.resolve() if to else tables / "report",
            fleet=fleet.name if fleet else "",
            known=_known_to_report(fleet) if fleet else {},
            motors=tuple(motors.split()),
            nights=nights,
            workers=jobs,
        )
    )
    typer.echo(
        f"{result.n_motors} motors, {result.n_nights} nights made anew, {result.n_written} files "
        f"written, {result.n_removed} removed; open {result.index}"
    )
    for fault in result.faults:
        typer.echo(f"motor-leakage: store_read: {fault}", err=True)
    raise typer.Exit(EXIT_MOTORS_FAILED if result.faults else EXIT_OK)


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


@app.command()
def export(
    config: ConfigFile,
    csv: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Write CSV, one file a table, there.")
    ] = None,
    delta: Annotated[
        str | None,
        typer.Option(metavar="PLACE", help="Write Delta Lake tables below a folder or URL."),
    ] = None,
    tables: Annotated[str, typer.Option(help="Tables, with commas between; all if empty.")] = "",
    motors: Annotated[
        str, typer.Option(help="Ids of the motors, with blanks between; all if empty.")
    ] = "",
    since: Annotated[str | None, typer.Option(help="First night, YYYY-MM-DD.")] = None,
    until: Annotated[str | None, typer.Option(help="Last night, YYYY-MM-DD.")] = None,
    bom: Annotated[
        bool, typer.Option("--bom", help="Begin each file with a byte order mark, for Excel.")
    ] = False,
    output: Annotated[
        Path | None, typer.Option(help="Output folder, instead of the config's.")
    ] = None,
) -> None:
    """Write published tables in another format; what is there of the same name is replaced.

    Example: motor-leakage export demo/configs/fleet.toml --csv csv --tables fits,parameters --bom

    Text that a spreadsheet would take for a formula gets an apostrophe in front.

    Example: motor-leakage export demo/configs/fleet.toml --delta lake

    Delta Lake tables are written whole, each in one transaction.
    """
    from pipeline.config import load_fleet
    from pipeline.csv_export import Selection, export_csv, tables_named
    from pipeline.delta_export import export_delta

    if (csv is None) == (delta is None):
        raise UsageError("export_format", "name what to write: --csv FOLDER or --delta PLACE")
    fleet = load_fleet(config)
    root = fleet.output if output is None else output.resolve()
    if delta is not None:
        if motors or since or until or bom:
            raise UsageError("export_format", "--delta writes whole tables: expected only --tables")
        for one in export_delta(root, delta, tables_named(tables.replace(",", " ").split())):
            typer.echo(f"{one.place}: version {one.version}, {one.n_rows} rows")
        return
    assert csv is not None
    selection = Selection(
        tables=tables_named(tables.replace(",", " ").split()),
        motors=_known_motors(motors.split(), fleet),
        since=_night(since, "--since"),
        until=_night(until, "--until"),
    )
    _in_order(selection.since, selection.until)
    for file in export_csv(root, csv, selection, byte_order_mark=bom):
        typer.echo(f"{file.path}: {file.n_rows} rows")


@app.command()
def model(
    motor_type: Annotated[str, typer.Option("--type", help="Motor type, such as CB560.")],
    config: Annotated[
        Path | None, typer.Option(metavar="FLEET", help="The fleet file; else the shipped config.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option(help="Folder of the figures; else figures/ in the output.")
    ] = None,
    image_format: Annotated[
        ImageFormat, typer.Option("--format", help="Kind of the files.")
    ] = ImageFormat.PNG,
    oil: Annotated[
        str | None, typer.Option(help="The oil; else that of the fleet's first motor of the type.")
    ] = None,
) -> None:
    """Draw the model of a motor type as its config states it: each path, oil, shares, films.

    Nothing is fitted: gap heights and eccentricities are the configured ones, and the settings
    are the fleet's, without what a motor overrides. Prints the files that were written.

    Example: motor-leakage model --type CB560 --config demo/configs/fleet.toml --format svg
    """
    from pipeline.config import load_fleet
    from pipeline.demo import shipped_configs
    from pipeline.model_figures import choose, write_model_figures

    fleet = load_fleet(config or shipped_configs() / "fleet.toml")
    subject = choose(fleet, motor_type, oil)
    # The shipped config lies within the program: its output is nobody's.
    folder = output or (fleet.output if config else Path("out").resolve()) / "figures"
    for path in write_model_figures(subject, folder, image_format.value):
        typer.echo(path)


@app.command()
def pull(
    config: ConfigFile,
    output: Annotated[
        Path | None, typer.Option(help="Working copy, instead of the config's output.")
    ] = None,
) -> None:
    """Bring the output folder up to date with the object store that it is published to.

    Example: motor-leakage pull demo/configs/fleet.toml
    """
    from pipeline.fleet import refresh

    fleet = _load(config, output, None, logs=False)
    if not fleet.object_store:
        typer.echo(f"{fleet.output} is published nowhere else: folders.object_store is not set")
        return
    typer.echo(f"{refresh(fleet)} files of {fleet.object_store} in {fleet.output}")


@app.command()
def status(
    config: ConfigFile,
    output: Annotated[
        Path | None, typer.Option(help="Output folder, instead of the config's.")
    ] = None,
    max_age: Annotated[
        str, typer.Option(help="End with 1 if the last good run is older, such as 26h.")
    ] = "",
    as_json: AsJson = False,
) -> None:
    """Print the fleet's state: the motors that need attention first, and since when.

    Example: motor-leakage status demo/configs/fleet.toml --max-age 26h

    Exit code 0; with --max-age 1 where the last good run is too old, or there was none.
    """
    from pipeline.status import age_in_hours, fleet_status
    from pipeline.status_lines import print_status

    limit_h = age_in_hours(max_age) if max_age else None
    fleet = _load(config, output, None, logs=False)
    found = fleet_status(fleet.output, [spec.motor_id for spec in fleet.motors])
    too_old = False
    if limit_h is not None:
        ended = found.last_good_run
        too_old = ended is None or dt.datetime.now(dt.UTC) - ended > dt.timedelta(hours=limit_h)
    print_status(fleet.name, found, too_old=too_old, as_json=as_json)
    raise typer.Exit(EXIT_MOTORS_FAILED if too_old else EXIT_OK)


@app.command()
def ack(
    config: ConfigFile,
    motor: Annotated[str, typer.Argument(help="The motor's id.")],
    indicator: Annotated[str, typer.Argument(help="The indicator, as `status` names it.")],
    note: Annotated[str, typer.Option(help="In words.")],
    finding: Annotated[
        str, typer.Option(help="confirmed or not_confirmed, once somebody has looked.")
    ] = "",
    output: Annotated[
        Path | None, typer.Option(help="Output folder, instead of the config's.")
    ] = None,
) -> None:
    """Acknowledge an alarm, or say what an inspection found; kept across runs and shown.

    Example: motor-leakage ack demo/configs/fleet.toml CB400-02 K_piston_ring --note "rings ordered"

    Once somebody has looked, add --finding confirmed, or --finding not_confirmed.
    """
    from pipeline.decisions import FINDINGS, Decision, record_decision
    from pipeline.status import alarmed_night

    if finding not in ("", *FINDINGS):
        raise UsageError("finding", f"got {finding!r}; expected {' or '.join(FINDINGS)}")
    fleet = _load(config, output, None, logs=False)
    _known_motors([motor], fleet)
    night = alarmed_night(fleet.output, motor, indicator)
    decision = Decision(
        motor_id=motor,
        indicator=indicator,
        time=dt.datetime.now(dt.UTC),
        kind="finding" if finding else "acknowledged",
        night=night,
        finding="confirmed" if finding == "confirmed" else "not_confirmed" if finding else None,
        note=note,
    )
    record_decision(fleet.output, decision)
    typer.echo(f"{motor}: {indicator}, raised last on {night}: {decision.kind}")


@baseline_app.command("reset")
def baseline_reset(
    config: ConfigFile,
    motor: Annotated[str, typer.Argument(help="The motor's id.")],
    night: Annotated[str, typer.Argument(help="First night of the new baseline, YYYY-MM-DD.")],
    note: Annotated[str, typer.Option(help="Why, in words.")],
    indicator: Annotated[str, typer.Option(help="Of this indicator alone; all if empty.")] = "",
    output: Annotated[
        Path | None, typer.Option(help="Output folder, instead of the config's.")
    ] = None,
) -> None:
    """Let a motor's baseline begin anew with a night; the next run makes its trends anew.

    An overhaul, an oil change or a change of flushing belongs into the motor's file, dated, in
    `events`: that starts a new baseline as well.

    Example: motor-leakage baseline reset demo/configs/fleet.toml CB560-01 2026-02-15 --note "new"
    """
    from pipeline.decisions import Decision, record_decision

    label = _night(night, "NIGHT")
    assert label is not None
    fleet = _load(config, output, None, logs=False)
    _known_motors([motor], fleet)
    record_decision(
        fleet.output,
        Decision(motor, indicator, dt.datetime.now(dt.UTC), "baseline_reset", label, None, note),
    )
    typer.echo(f"{motor}: {indicator or 'every'} baseline begins anew with the night {label}")


def _loaded(config: Path) -> Fleet:
    from pipeline.config import load_fleet

    return load_fleet(config)


def _known_to_report(fleet: Fleet) -> Mapping[str, KnownMotor]:
    """What the report is told of the config's motors: type and dated events."""
    from pipeline.report import KnownMotor

    return {
        spec.motor_id: KnownMotor(
            spec.file.motor_type,
            tuple(event.model_dump(exclude={"oil"}) for event in spec.file.events),
        )
        for spec in fleet.motors
    }


def _load(config: Path, output: Path | None, jobs: int | None, *, logs: bool = True) -> Fleet:
    from pipeline.config import ConfigError, Fault

    fleet = _loaded(config)
    if logs and not fleet.log_url and not fleet.log_root.is_dir():
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


def _in_order(since: dt.date | None, until: dt.date | None) -> None:
    if since and until and since > until:
        raise UsageError("date", f"--since {since} is after --until {until}; no night lies between")


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
                "files": _by_fate(outcome.files),
                "growing": outcome.growing,
            }
            _say(json.dumps(line))
            return
        why = f": {outcome.message}" if outcome.message and not outcome.error_code else ""
        _say(f"{outcome.motor_id}: {outcome.status} ({counts or 'nothing to do'}){why}")
        if outcome.error_code:
            _say(f"{outcome.motor_id}: {outcome.error_code}: {outcome.message}", err=True)
        for message in outcome.growing:
            _say(f"{outcome.motor_id}: log_growing: {message}", err=True)

    def summary(self, result: RunResult, output: Path) -> None:
        """The run has finished."""
        if self.as_json:
            line = {
                "event": "run",
                "run_id": result.run_id,
                "n_motors": len(result.outcomes),
                "n_failed": len(result.failed),
                "n_nights": result.n_nights,
                "files": _by_fate(result.files),
                "interrupted": result.interrupted,
                "seconds": round(result.seconds, 3),
            }
            _say(json.dumps(line))
            return
        state = "interrupted; " if result.interrupted else ""
        files = ", ".join(f"{n} {fate}" for fate, n in _by_fate(result.files).items())
        _say(
            f"{state}{result.n_nights} nights of {len(result.outcomes)} motors in "
            f"{result.seconds:.1f} s, {len(result.failed)} motors failed; logs: {files}; "
            f"tables in {output / 'tables'}"
        )


def _by_fate(files: Mapping[str, int]) -> dict[str, int]:
    """Log files by what came of them, all of which there can be, in a fixed order."""
    from pipeline.log_shelf import FATES

    return {fate: files.get(fate, 0) for fate in FATES}


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
