"""A delivery, and what a receiver of one is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

# Longest time for one delivery to one receiver [s].
DEADLINE_S = 30.0


@dataclass(frozen=True, slots=True)
class Delivery:
    """What a receiver gets at a time.

    Attributes
    ----------
    id
        The same each time that it is tried.
    content
        JSON.
    """

    id: str
    content: bytes


class UndeliveredError(Exception):
    """A receiver has not taken a delivery.

    Parameters
    ----------
    why
        In words; they quote neither a secret nor what the receiver answered.
    hung
        Whether the deadline passed.
    """

    def __init__(self, why: str, *, hung: bool = False) -> None:
        super().__init__(why)
        self.why = why
        self.hung = hung


class Receiver(Protocol):
    """One who is told.

    Attributes
    ----------
    name
        By which the outbox knows it, whatever becomes of its address.
    label
        For people; without secrets.
    """

    @property
    def name(self) -> str: ...

    @property
    def label(self) -> str: ...

    def take(self, delivery: Delivery) -> None:
        """Take a delivery, within a deadline.

        Raises
        ------
        UndeliveredError
            If it has not, or nobody knows whether it has.
        """
