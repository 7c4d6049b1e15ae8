"""The command `motor-leakage`. Heavy imports wait until a command needs them."""

from __future__ import annotations

import gc
import os
import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from pipeline.cli import checking, publishing, runs, starting, state
from pipeline.cli.arguments import (
    EXIT_INTERRUPTED,
    EXIT_LOCKED,
    EXIT_MOTORS_FAILED,
    EXIT_NOTHING_PUBLISHED,
    EXIT_OK,
    EXIT_TERMINATED,
    EXIT_USAGE,
)
from pipeline.errors import LockedError, LogError, MotorLeakageError, StoreError, UsageError
from pipeline.messages import error_line, speak

SIGNALS = {EXIT_INTERRUPTED: "SIGINT (Ctrl-C)", EXIT_TERMINATED: "SIGTERM"}

app = typer.Typer(
    name="motor-leakage",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    # Plain help and errors: boxes cost as much time as all the rest of `--help`.
    rich_markup_mode=None,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
)
baseline = typer.Typer(no_args_is_help=True, help="Baselines of a motor.", rich_markup_mode=None)
# In the order in which the help lists them.
app.command("fit-fleet")(runs.fit_fleet)
app.command()(checking.look)
app.command()(starting.init)
app.command()(checking.check)
app.command()(publishing.explain)
app.command()(runs.fit)
app.command()(publishing.report)
app.command()(starting.demo)
app.command()(publishing.export)
app.command()(state.status)
app.command()(state.compare)
app.command()(state.ack)
app.command()(publishing.prune)
baseline.command("reset")(state.baseline_reset)
app.add_typer(baseline, name="baseline")


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


def _exit_code(error: MotorLeakageError) -> int:
    from pipeline.config import ConfigError

    if isinstance(error, UsageError | ConfigError):
        return EXIT_USAGE
    if isinstance(error, LogError):
        return EXIT_MOTORS_FAILED
    return EXIT_LOCKED if isinstance(error, LockedError) else EXIT_NOTHING_PUBLISHED


def _call(*, as_json: bool) -> int:
    """Call the command; its exit code. For programs wrong usage is an error of ours, not a box."""
    try:
        return int(app(standalone_mode=not as_json) or EXIT_OK)
    except SystemExit as ended:
        return int(ended.code or EXIT_OK)
    except Exception as error:
        # Typer's own class of errors has no public name in all versions.
        if not hasattr(error, "format_message"):
            raise
        raise UsageError("usage", error.format_message()) from error


def main() -> NoReturn:
    """Run the command; every expected error is a message on stderr and a stated exit code."""
    # Pydantic looks for plugins in all packages that are installed; no model here has any.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")
    # A command is short: few collections of garbage.
    gc.set_threshold(10_000)
    for name in ("stdout", "stderr"):  # which a caller may have closed
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open("w"))  # noqa: SIM115
    # Before anything is parsed: a fault in the arguments is a message, too.
    as_json = "--json" in sys.argv[1:]
    speak(as_json=as_json)
    error: MotorLeakageError | None = None
    try:
        code = _call(as_json=as_json)
    except MotorLeakageError as raised:
        code, error = _exit_code(raised), raised
    except PermissionError as refused:  # of a folder that may not be entered
        what = f"{refused.filename} cannot be read: {refused.strerror}"
        code, error = EXIT_NOTHING_PUBLISHED, StoreError("store_read", what)
    except KeyboardInterrupt:
        code = EXIT_INTERRUPTED
    if code in SIGNALS:
        words = f"stopped by {SIGNALS[code]}; what is written is whole, and the next call continues"
        error = MotorLeakageError("interrupted", words)
    if error is not None:
        typer.echo(error_line(error.code, str(error), code, as_json=as_json), err=True)
    sys.exit(code)
