"""Options, config, lines and progress shared by the commands."""

from __future__ import annotations

import datetime as dt
import json
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pipeline.clock import now
from pipeline.errors import UsageError, one_line

if TYPE_CHECKING:
    from pipeline.config import Fleet

UNITS = {"s": "seconds", "m": "minutes", "min": "minutes", "h": "hours", "d": "days"}
EXIT_OK, EXIT_MOTORS_FAILED, EXIT_USAGE, EXIT_LOCKED, EXIT_NOTHING_PUBLISHED = 0, 1, 2, 3, 4
EXIT_INTERRUPTED, EXIT_TERMINATED = 130, 143
# So often a bar is drawn anew [s].
DRAWN_EVERY_S = 0.5


def absolute_folder(given: Path | None) -> Path | None:
    """Return the absolute path of a folder that an option names; wrong usage where it cannot be."""
    from pipeline.config import absolute

    try:
        return given and absolute(given)
    except ValueError as error:
        raise typer.BadParameter(f"expected a folder: {error}") from error


def day(text: str) -> dt.date:
    """Return a day, or the label of a night."""
    try:
        return dt.date.fromisoformat(text)
    except ValueError:
        raise typer.BadParameter(f"got {text!r}; expected YYYY-MM-DD") from None


def nights(text: str) -> tuple[dt.date, dt.date]:
    """Return first and last of some nights: YYYY-MM-DD, or YYYY-MM-DD..YYYY-MM-DD."""
    first, _, last = text.partition("..")
    span = day(first), day(last or first)
    if span[0] > span[1]:
        raise typer.BadParameter(f"got {text!r}; expected the earlier night first")
    return span


def past_day(text: str) -> dt.date:
    """Return a day that has come, in whatever zone."""
    if day(text) > now().date() + dt.timedelta(days=1):
        raise typer.BadParameter(f"got {text}, which has not come")
    return day(text)


def duration(text: str) -> dt.timedelta:
    """Return a time span such as 30s, 10min, 26h or 2d."""
    match = re.fullmatch(rf"(\d{{1,6}}(?:\.\d+)?)({'|'.join(UNITS)})", text)
    if match is None or not float(match[1]):
        raise typer.BadParameter(f"got {text!r}; expected such as 30s, 10min, 26h or 2d")
    return dt.timedelta(**{UNITS[match[2]]: float(match[1])})


ConfigFile = Annotated[
    Path, typer.Argument(metavar="CONFIG", help="The fleet file, such as configs/fleet.toml.")
]
AsJson = Annotated[bool, typer.Option("--json", help="One JSON object a line, for programs.")]
Output = Annotated[
    Path | None,
    typer.Option(
        callback=absolute_folder,
        help="Output folder instead of the config's; it is copied nowhere.",
    ),
]
Motor = Annotated[str, typer.Argument(help="The motor's id.")]
Since = Annotated[dt.date | None, typer.Option(parser=day, help="First night, YYYY-MM-DD.")]
Until = Annotated[dt.date | None, typer.Option(parser=day, help="Last night, YYYY-MM-DD.")]
Motors = Annotated[str, typer.Option(help="Ids of the motors, with blanks between; all if empty.")]
Jobs = Annotated[int | None, typer.Option(min=1, help="Motors fitted at the same time.")]


def load(config: Path, output: Path | None, jobs: int | None, *, logs: bool = True) -> Fleet:
    """Return the fleet of a config, with the options of the command line.

    A run into another output folder is private: it is copied nowhere.
    """
    from pipeline.config import ConfigError, Fault, load_fleet, overlap

    fleet = load_fleet(config)
    if logs and not fleet.log_url and not fleet.log_root.is_dir():
        fault = Fault(config.name, "folders.logs", f"expected a folder at {fleet.log_root}")
        raise ConfigError([fault])
    if output is not None and output != fleet.output:
        fleet = fleet.at_output(output)
        if (expected := overlap(fleet)) is not None:
            raise UsageError("folder", f"--output: got {output}; {expected}")
    if jobs is not None:
        fleet = replace(fleet, execution=fleet.execution.model_copy(update={"workers": jobs}))
    return fleet


def require_order(since: dt.date | None, until: dt.date | None) -> None:
    """Raise UsageError if no night lies between --since and --until."""
    if since and until and since > until:
        raise UsageError("date", f"--since {since} is after --until {until}; no night lies between")


def say(line: str, *, err: bool = False) -> None:
    """Print a line; a closed pipe, or a log of the run on a full disk, must not end a run."""
    try:
        typer.echo(line, err=err)
    except OSError as error:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, (sys.stderr if err else sys.stdout).fileno())
        os.close(nowhere)
        if not (err or isinstance(error, BrokenPipeError)):
            say(f"standard output cannot be written: {error.strerror}", err=True)


def tell(event: Mapping[str, Any], words: str, *, as_json: bool, err: bool = False) -> None:
    """Print an event: for programs as a JSON object, else in words, if there are any."""
    if as_json:
        say(json.dumps(event, default=str), err=err)
    elif words:
        say(words, err=err)


def print_table(
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    title: str = "",
    styles: Sequence[str] = (),
    *,
    is_dense: bool = False,
) -> None:
    """Print rows below their columns, as wide as the terminal is; `styles` are the rows', or none.

    Dense, a row is a line, which is cut where the terminal ends, and there is no title. Piped,
    cells are separated by tabs and the title is left out; a cell that would break a line or a
    column is escaped.
    """
    if not sys.stdout.isatty():
        for cells in (columns, *rows):
            say("\t".join(map(one_line, cells)))
        return
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table
    from rich.text import Text

    if is_dense:
        lines = [list(map(one_line, cells)) for cells in (columns, *rows)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        for row, look in zip(lines, ["bold", *styles], strict=True):
            padded = map(str.ljust, row, widths)
            Console().print(
                Text("  ".join(padded).rstrip(), look), no_wrap=True, overflow="ellipsis"
            )
        return
    table = Table(title=escape(one_line(title)) or None, title_justify="left", box=box.SIMPLE_HEAD)
    for name in columns:
        table.add_column(name, overflow="fold")
    for place, cells in enumerate(rows):
        style = styles[place] if styles else None
        table.add_row(*(escape(one_line(cell)) for cell in cells), style=style)
    Console().print(table)


@contextmanager
def progress_bar(what: str, *, is_shown: bool = True) -> Iterator[Callable[[int, int], None]]:
    """Yield what is to be called with how many of `what` are done, and how many there are.

    On a terminal that draws a bar with the time left, elsewhere nothing.
    """
    # A caller may have closed it.
    if not is_shown or sys.stderr is None or not sys.stderr.isatty():
        yield lambda _done, _total: None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    words = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*words, TextColumn("left"), console=Console(stderr=True)) as bar:
        task = bar.add_task("", total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def repeat(call: Callable[[], None]) -> Iterator[None]:
    """Repeat a call in a thread until the block ends, and once then."""
    over = Event()

    def repeat() -> None:
        while not over.wait(DRAWN_EVERY_S):
            call()

    thread = Thread(target=repeat, name="progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        call()
