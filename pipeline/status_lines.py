"""`motor-leakage status` on a terminal, in a file, or for programs."""

from __future__ import annotations

import datetime as dt
import json
from dataclasses import asdict

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from pipeline.errors import one_line
from pipeline.heartbeat import FINISHED, RUNNING
from pipeline.status import FleetStatus, MotorState

# Words beside colours: a state is never told by colour alone.
COLOURS = {"alarm": "bold red", "warning": "yellow", "common_cause": "magenta", "stale": "blue"}
COLUMNS = ("motor", "state", "leakage l/min", "baseline", "last good night", "sensors", "why")


def print_status(name: str, found: FleetStatus, *, too_old: bool, as_json: bool) -> None:
    """Print a fleet's state.

    Parameters
    ----------
    name
        The fleet.
    found
        Its state.
    too_old
        Whether the last good run is older than was asked for.
    as_json
        One JSON object a motor, then one for the fleet.
    """
    if as_json:
        for motor in found.motors:
            typer.echo(json.dumps({"event": "motor", **asdict(motor)}, default=str))
        fleet = {
            "event": "fleet",
            "last_good_run": found.last_good_run,
            "too_old": too_old,
            "findings": found.findings,
            "findings_confirmed": found.findings_confirmed,
            "run": None if found.beat is None else asdict(found.beat),
            "damage": [asdict(fault) for fault in found.damage],
        }
        typer.echo(json.dumps(fleet, default=str))
        return
    console = Console()
    if console.is_terminal:
        table = Table(*COLUMNS, title=escape(one_line(name)))
        for motor in found.motors:
            cells = (escape(one_line(cell)) for cell in _cells(motor))
            table.add_row(*cells, style=COLOURS.get(motor.state))
        console.print(table)
    else:
        for motor in found.motors:
            typer.echo(one_line("; ".join(_cells(motor))))
    ended = f"{found.last_good_run:%Y-%m-%d %H:%M} UTC" if found.last_good_run else "never"
    typer.echo(f"last good run: {ended}{', which is too old' if too_old else ''}")
    if (line := _run_line(found)) is not None:
        typer.echo(line)
    if found.damage:
        first, n = found.damage[0], len(found.damage)
        typer.echo(f"{n} published files are damaged or gone, such as {first.path}: {first.code}")
    if found.findings:
        share = 100 * found.findings_confirmed / found.findings
        typer.echo(
            f"inspections that confirmed an alarm: {found.findings_confirmed} of "
            f"{found.findings} ({share:.0f} %)"
        )


def _run_line(found: FleetStatus) -> str | None:
    """What there is to say of a run that is under way, or did not come to its end."""
    beat = found.beat
    if beat is None or beat.state == FINISHED:
        return None
    done = f"{beat.n_motors_done} of {beat.n_motors} motors done"
    since = f"{beat.started_at:%Y-%m-%d %H:%M} UTC"
    if beat.state != RUNNING:
        return f"the run of {since} {beat.state} ({beat.error_code or beat.stage}), {done}"
    if beat.is_missing(dt.datetime.now(dt.UTC)):
        return (
            f"the run of {since} (process {beat.pid} on {beat.host}) died or hangs: its last sign "
            f"of life is of {beat.beaten_at:%Y-%m-%d %H:%M} UTC, in the stage {beat.stage}, {done}"
        )
    return f"a run is under way since {since} (process {beat.pid}): {beat.stage}, {done}"


def _cells(motor: MotorState) -> tuple[str, ...]:
    leakage, deviation = motor.leakage_l_per_min, motor.deviation_percent
    why = motor.reason or "no change of external leakage"
    if motor.acknowledged:
        why += f" (acknowledged: {motor.acknowledged})"
    return (
        motor.motor_id,
        motor.state.replace("_", " "),
        "unknown" if leakage is None else f"{leakage:.3g}",
        "none yet" if deviation is None else f"{deviation:+.1f} %",
        str(motor.last_good_night or "never"),
        motor.sensor_health or "unknown",
        why,
    )
