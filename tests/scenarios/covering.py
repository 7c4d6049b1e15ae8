"""Which commands and options there are, and which of them a scenario runs and judges."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

from tests.scenarios.command import Result, run_command

Item = tuple[str, str]  # a command and an option; "" is the command itself
# By scenario, what it declares.
DECLARED: dict[Any, set[Item]] = {}
OPTION = re.compile(r"^ +(?:-\w, )?(--[a-z][a-z-]*)", re.MULTILINE)
HELP = "--help"


def covers(*texts: str) -> Callable[[Any], Any]:
    """Declare what a scenario runs and judges, such as ``"status --json --max-age"``.

    The scenario then fails unless it has run each and has read its result: what is only
    mentioned covers nothing.
    """

    def declare(scenario: Any) -> Any:
        DECLARED[scenario] = {item for text in texts for item in _items(text.split())}
        return scenario

    return declare


def declared_by(scenario: Any) -> set[Item]:
    """What a scenario declares."""
    return DECLARED.get(scenario, set())


def items_of(call: Result) -> set[Item]:
    """The command of a call, and its options."""
    return set(_items(call.arguments))


@cache
def all_items() -> set[Item]:
    """Every command and option that `--help` names, from the top down."""
    return set(_of_help(()))


def _of_help(words: tuple[str, ...]) -> Iterator[Item]:
    text = run_command(*words, HELP, COLUMNS="200").out
    head, _, commands = text.partition("\nCommands:\n")
    subcommands = re.findall(r"^  ([a-z][a-z-]*)", commands, re.MULTILINE)
    if words and not subcommands:
        yield " ".join(words), ""
    for option in OPTION.findall(head.partition("\nOptions:\n")[2]):
        if option != HELP:
            yield " ".join(words), option
    for word in subcommands:
        yield from _of_help((*words, word))


def _items(words: Any) -> Iterator[Item]:
    """Items of a command's words: those before the first argument are its name."""
    options = [word.partition("=")[0] for word in words if word.startswith("--")]
    plain = [word for word in words if not word.startswith("-")]
    name = " ".join(plain[:2] if plain[:1] == ["baseline"] else plain[:1])
    if name and HELP not in options:
        yield name, ""
    for option in options:
        yield name, option
