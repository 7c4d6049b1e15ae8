"""Deliveries and their receivers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

# Longest time for one delivery to one receiver [s].
DEADLINE_S = 30.0


@dataclass(frozen=True, slots=True)
class Delivery:
    """Content of one delivery to a receiver.

    Attributes
    ----------
    id
        The same at each try.
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
        The reason, without secrets and words of the receiver.
    hung
        True if the deadline passed.
    """

    def __init__(self, why: str, *, hung: bool = False) -> None:
        super().__init__(why)
        self.why = why
        self.hung = hung


class Receiver(Protocol):
    """A receiver of deliveries.

    Attributes
    ----------
    name
        Its name in the outbox, which stays when its address changes.
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
            If it was not taken, or that is not known.
        """
