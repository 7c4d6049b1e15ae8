"""`motor-leakage init`: a fleet's config from a plant's logs."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.cli.arguments import EXIT_MOTORS_FAILED, EXIT_OK
from pipeline.cli.tables import print_table
from pipeline.errors import UsageError

if TYPE_CHECKING:
    from pipeline.setup.plant import Proposal, Question

COLUMNS = ("motor", "channel", "in the log", "unit", "quality", "first values")


def init(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="SOURCE",
            help="A log, a folder of logs, or sql:NAME, the database whose address is in the "
            "environment variable NAME.",
        ),
    ],
    to: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder of the new config.")] = Path(
        "fleet"
    ),
    answer: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="Answer to a question; may come several times."),
    ] = None,
    query: Annotated[
        str,
        typer.Option(
            metavar="SQL",
            help="Of a database: the query of the samples, with {start} and {end}; else a table.",
        ),
    ] = "",
    write: Annotated[
        bool, typer.Option("--write", help="Write the files; else they are only shown.")
    ] = False,
) -> None:
    """Propose the config of a whole fleet from a plant's logs; asks what they do not say.

    Example: motor-leakage init demo/logs --to my-fleet

    Example: motor-leakage init sql:PLANT_DATABASE --to my-fleet

    Exit code 0: all is known; 1: questions are open, or a log cannot be read, and nothing is
    written; 2: wrong usage, or a file is there already; 4: a database does not answer.
    """
    from pipeline.demo import shipped_configs
    from pipeline.setup.fleet_files import fleet_files, write_fleet

    answers = dict(map(_answer, answer or ()))
    proposal = _proposed(source, query, answers)
    shipped = shipped_configs()
    while questions := [*proposal.questions, *_of_the_machine(shipped, answers)]:
        if not sys.stdin.isatty():
            break
        answers |= dict(map(_asked, questions))
        proposal = _proposed(source, query, answers)
    _print(proposal)
    for one in questions:
        choices = f" ({', '.join(one.choices)})" if one.choices else ""
        typer.echo(f"--answer '{one.key}=…': {one.text}{choices}")
    for fault in proposal.faults:
        typer.echo(fault, err=True)
    if questions or not proposal.motors:
        raise typer.Exit(EXIT_MOTORS_FAILED)
    files = fleet_files(proposal, to, answers["motor_type"], answers["oil"])
    if write:
        write_fleet(files, to, shipped, answers["motor_type"])
        typer.echo(f"written: {to / 'fleet.toml'}; next: motor-leakage check {to / 'fleet.toml'}")
    else:
        for name, text in files.items():
            typer.echo(f"\n# {to / name}\n{text}", nl=False)
        typer.echo("\nnothing is written without --write")
    raise typer.Exit(EXIT_MOTORS_FAILED if proposal.faults else EXIT_OK)


def _proposed(source: Path, query: str, answers: dict[str, str]) -> Proposal:
    from pipeline.setup.plant import propose

    kind, _, variable = str(source).partition(":")
    if kind in ("postgresql", "postgres"):
        # Not quoted: it may hold a password, and so does the shell's history by now.
        message = (
            "put the address into an environment variable, such as PLANT_DATABASE, and name it: "
            "motor-leakage init sql:PLANT_DATABASE"
        )
        raise UsageError("source", message)
    if kind == "sql":
        from pipeline.setup.database_look import propose_from_database

        return propose_from_database(f"${{{variable}}}", query, answers)
    if query:
        raise UsageError("source", "--query is of a database: name it as sql:NAME")
    return propose(source, answers)


def _answer(text: str) -> tuple[str, str]:
    key, mark, value = text.partition("=")
    if not mark or not value:
        raise UsageError("answer", f"--answer: got {text!r}; expected KEY=VALUE")
    return key.strip(), value.strip()


def _asked(question: Question) -> tuple[str, str]:
    choices = f" ({', '.join(question.choices)})" if question.choices else ""
    return question.key, str(typer.prompt(f"{question.text}{choices}"))


def _of_the_machine(configs: Path, answers: dict[str, str]) -> Iterator[Question]:
    """Questions that no log answers."""
    from pipeline.setup.plant import Question

    for key, folder in (("motor_type", "motor_types"), ("oil", "oils")):
        known = tuple(path.stem for path in sorted((configs / folder).glob("*.toml")))
        if key in answers and answers[key] not in known:
            message = f"{key}: got {answers[key]!r}; expected one of {', '.join(known)}"
            raise UsageError("answer", message)
        if key not in answers:
            yield Question(key, f"{key.replace('_', ' ')} of the motors: which is it?", known)


def _print(proposal: Proposal) -> None:
    print_table(
        COLUMNS,
        [
            (
                motor.motor_id,
                channel,
                f"{one.source} {one.named_field}".strip(),
                one.unit or "to be asked",
                motor.quality.get(channel, ""),
                "; ".join(one.samples[:3]),
            )
            for motor in proposal.motors
            for channel, one in motor.sources.items()
        ],
    )
    if proposal.unused:
        typer.echo(f"not used: {', '.join(proposal.unused[:40])}")
