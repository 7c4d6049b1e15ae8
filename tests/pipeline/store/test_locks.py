"""A second signal does not wait, as the first does (`test_cli.py`)."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator

import pytest

from pipeline.store.atomic_files import INTERRUPTS, interrupts_held


@pytest.fixture
def received() -> Iterator[list[int]]:
    """Signals that the program's own handler received; it ends what is under way."""
    numbers: list[int] = []

    def stop(number: int, _: object) -> None:
        numbers.append(number)
        raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in INTERRUPTS}
    yield numbers
    for number, handler in before.items():
        signal.signal(number, handler)


def test_a_second_signal_does_not(received: list[int]) -> None:
    reached = []

    def twice() -> None:
        with interrupts_held():
            os.kill(os.getpid(), signal.SIGINT)
            reached.append(1)
            os.kill(os.getpid(), signal.SIGTERM)
            reached.append(2)

    with pytest.raises(KeyboardInterrupt):
        twice()
    assert (reached, received) == ([1], [signal.SIGTERM])


def test_another_thread_has_no_signals_to_hold() -> None:
    seen: list[list[int]] = []

    def work() -> None:
        with interrupts_held() as came:
            seen.append(came)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [[]]
