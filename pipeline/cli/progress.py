"""Progress of a command: on a terminal a bar with the time left, elsewhere nothing."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from threading import Event, Thread
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pipeline.workers.process import Mark

# So often a bar is drawn anew [s].
DRAWN_EVERY_S = 0.5


@contextmanager
def progress_bar(what: str, *, is_shown: bool = True) -> Iterator[Callable[[int, int], None]]:
    """Yield what is to be called with how many of `what` are done, and how many there are."""
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
def repeated(call: Callable[[], None]) -> Iterator[None]:
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


def nights_done(
    n_finished: int, nights_finished: int, n_motors: int, marks: Sequence[Mark]
) -> tuple[int, int]:
    """Return the nights that are done, and how many there are: of motors to come the mean.

    Examples
    --------
    >>> from pipeline.workers.process import Mark
    >>> nights_done(1, 75, 6, [Mark(1, n_done=30, n_left=45)])
    (105, 450)
    """
    done = nights_finished + sum(mark.n_done for mark in marks)
    known = done + sum(mark.n_left for mark in marks)
    begun = min(n_finished + len(marks), n_motors)
    return done, round(known * n_motors / begun) if begun else n_motors
