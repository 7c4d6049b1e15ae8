"""Commands for a first day: a simulated fleet, and a config from a plant's own logs."""

from __future__ import annotations

import datetime as dt
import shlex
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pipeline.cli.arguments import EXIT_MOTORS_FAILED, EXIT_OK, day, load, print_table, progress_bar
from pipeline.errors import UsageError
from pipeline.messages import counted

if TYPE_CHECKING:
    from pipeline.setup.fleet_files import Observed
    from pipeline.setup.propose import Proposal, ProposedMotor
    from pipeline.setup.tables import Question

COLUMNS = ("motor", "channel", "in the log", "unit", "quality", "first values")
_MOST_UNUSED = 40


def demo(
    folder: Annotated[Path, typer.Argument(help="Gets demo/, and configs/ where it has none.")],
    nights: Annotated[int, typer.Option(min=1, max=3650, help="Nights of logs.")] = 75,
    minutes: Annotated[
        float, typer.Option(min=1.0, max=1440.0, help="Minutes of log a night.")
    ] = 90.0,
    rate: Annotated[float, typer.Option(min=0.1, max=100.0, help="Samples a second.")] = 5.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the simulation.")] = 1,
    last_night: Annotated[
        dt.date | None,
        typer.Option(parser=day, metavar="DATE", help="Label of the last night; else yesterday."),
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, max=256, help="Worker processes.")] = 2,
) -> None:
    """Write logs of a simulated fleet in three formats to demo/, and the truth beside them.

    Example: motor-leakage demo . --nights 3

    They are the logs of the fleet configs/fleet.toml, which the examples of the other commands
    name. Its tables go to out/. The flows are the same whatever the last night's date is.
    """
    from pipeline.clock import now
    from pipeline.demo.writing import write_demo

    last = last_night or now().date() - dt.timedelta(days=1)
    write_demo(
        folder,
        nights=nights,
        minutes=minutes,
        rate_hz=rate,
        seed=seed,
        workers=jobs,
        first_night=last - dt.timedelta(days=nights - 1),
    )
    config = folder / "configs" / "fleet.toml"
    typer.echo(f"logs written to {folder / 'demo' / 'logs'}; the fleet's config is {config}")


def init(
    source: Annotated[
        Path,
        typer.Argument(metavar="SOURCE", help="A log, or a folder of logs."),
    ],
    to: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder of the new config.")] = Path(
        "fleet"
    ),
    answer: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="Answer to a question; may come several times."),
    ] = None,
    write: Annotated[
        bool, typer.Option("--write", help="Write the files; else they are only shown.")
    ] = False,
    add: Annotated[
        bool, typer.Option("--add", help="Only motors that the fleet in FOLDER does not have.")
    ] = False,
) -> None:
    """Propose the config of a fleet from a plant's logs, or of a log; asks what they do not say.

    Example: motor-leakage init demo/logs --to my-fleet

    Exit code 0: all is known; 1: questions are open, or a log cannot be read, and nothing is
    written; 2: wrong usage, or a file is there already.
    """
    from pipeline.demo import shipped_configs
    from pipeline.setup.fleet_files import (
        added_files,
        defaults_of,
        fleet_files,
        machine_of,
        observed_of,
        with_sampling,
        write_fleet,
    )

    fleet = load(to / "fleet.toml", None, None) if add else None
    defaults = defaults_of(to / "fleet.toml") if add else {}
    answers: dict[str, str] = {
        key: defaults[key] for key in ("motor_type", "oil") if key in defaults
    }
    answers |= dict(map(_answer, answer or ()))
    root = fleet.log_root if fleet else None
    proposal = _propose(source, answers, root)
    configs = to if add else shipped_configs()
    while questions := [*proposal.questions, *_of_the_machine(configs, answers)]:
        if not sys.stdin.isatty():
            break
        for question in questions:
            answers[question.key] = str(typer.prompt(_text(question)))
            # What is typed is not lost with the terminal.
            typer.echo(
                f"--answer {shlex.quote(f'{question.key}={answers[question.key]}')}", err=True
            )
        proposal = _propose(source, answers, root)
    observed = observed_of(proposal)
    proposal = with_sampling(proposal, observed)
    _print(proposal, observed)
    faults = (
        *proposal.faults,
        *(log.fault for log in observed.values() if log.fault),
    )
    for key in proposal.unneeded:
        typer.echo(f"not needed: the answer {key}: the logs say it, or another answer does")
    for question in questions:
        typer.echo(f"--answer '{question.key}=…': {_text(question)}")
    for fault in faults:
        typer.echo(fault, err=True)
    if questions or not proposal.motors:
        raise typer.Exit(EXIT_MOTORS_FAILED)
    machine = (answers["motor_type"], answers["oil"])
    if fleet is None:
        files = fleet_files(proposal, to, *machine, tuple(observed.values()), answers)
    else:
        files = added_files(proposal, fleet, defaults, *machine, answers)
    if write:
        types = {machine_of(motor, *machine, answers)[0] for motor in proposal.motors}
        write_fleet(files, to, shipped_configs(), *sorted(types))
    _say_files(files, to, is_written=write)
    raise typer.Exit(EXIT_MOTORS_FAILED if faults else EXIT_OK)


def _say_files(files: Mapping[str, str], to: Path, *, is_written: bool) -> None:
    if not files:
        typer.echo(f"{to / 'fleet.toml'} has all of these motors")
    for name, text in files.items():
        typer.echo(f"written: {to / name}" if is_written else f"\n# {to / name}\n{text}".rstrip())
    then = f"next: motor-leakage check {to / 'fleet.toml'}"
    typer.echo(then if is_written else "\nnothing is written without --write")


def _text(question: Question) -> str:
    choices = f" ({', '.join(question.choices)})" if question.choices else ""
    return f"{question.text}{choices}"


def _propose(source: Path, answers: dict[str, str], root: Path | None) -> Proposal:
    from pipeline.setup.propose import propose

    if root is not None and not source.resolve().is_relative_to(root):
        raise UsageError("source", f"--add takes logs below the fleet's folder of logs, {root}")
    with progress_bar("logs") as draw:
        return propose(source, answers, root, draw)


def _answer(text: str) -> tuple[str, str]:
    # A column may have the mark in its name, and a value rarely has: but a value comes last.
    key, mark, value = text.partition("=")
    if not mark or not value:
        raise UsageError("answer", f"--answer: got {text!r}; expected KEY=VALUE")
    return key.strip(), value.strip()


def _of_the_machine(configs: Path, answers: dict[str, str]) -> Iterator[Question]:
    """Yield questions that no log answers."""
    from pipeline.setup.tables import Question

    for key, folder in (("motor_type", "motor_types"), ("oil", "oils")):
        known = tuple(path.stem for path in sorted((configs / folder).glob("*.toml")))
        given = {name: answer for name, answer in answers.items() if name.rpartition(".")[2] == key}
        for name, answer in given.items():
            if answer not in known:
                message = f"{name}: got {answer!r}; expected one of {', '.join(known)}"
                raise UsageError("answer", message)
        if key not in answers:
            text = f"{key.replace('_', ' ')} of the motors (of a motor: MOTOR.{key}): which is it?"
            yield Question(key, text, known)


def _print(proposal: Proposal, observed: Mapping[str, Observed]) -> None:
    rows = []
    for motor in proposal.motors:
        for channel, column in motor.channels.items():
            unit, quality = column.unit or "to be asked", _quality(column.keys)
            values = "; ".join(column.filled[:3])
            rows.append((motor.motor_id, channel, column.name, unit, quality, values))
    print_table(COLUMNS, rows)
    for motor in proposal.motors:
        typer.echo(f"{motor.motor_id}: {_logs_of(motor, observed.get(motor.motor_id))}")
        for channel, column in motor.channels.items():
            if silence_s := column.keys.get("longest_silence_s"):
                typer.echo(
                    f"{motor.motor_id}: {channel} is sent on change or compressed: "
                    f"a silence of up to {silence_s:g} s is no gap"
                )
    if proposal.unused:
        typer.echo(f"not used: {', '.join(proposal.unused[:_MOST_UNUSED])}")


def _quality(keys: Mapping[str, Any]) -> str:
    """Return a channel's quality, and its good codes where they are not the usual ones."""
    codes = ", ".join(map(str, keys.get("quality_good", ())))
    return str(keys.get("quality_source", "")) + (f" ({codes})" if codes else "")


def _logs_of(motor: ProposedMotor, seen: Observed | None) -> str:
    """Return files and days of a motor, the column of the time, and the order of its date."""
    time = [motor.logs.get(key, "") for key in ("date_column", "time", "time_format")]
    words = [counted(len(motor.files), "file")]
    if seen and seen.spans:
        first, last = seen.spans[0][0].date(), max(end for _, end in seen.spans).date()
        words.append(f"{first} to {last} ({counted((last - first).days + 1, 'day')})")
    words.append(f"time {' '.join(filter(None, time))}")
    return ", ".join((*words, f"zone {motor.logs.get('time_zone', 'in the stamps')}"))
