"""Errors of the science: a stable code, and a message that says what, where and what to do."""

from __future__ import annotations


class LeakageError(ValueError):
    """Base of every error that this package raises on purpose.

    Parameters
    ----------
    code
        Stable, machine-readable name of the kind of error.
    message
        What is wrong, where, and what to do about it, in a line.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(code, message)
        self.code = code
        self.message = message

    def __str__(self) -> str:
        return self.message


class ValidityError(LeakageError):
    """A law was asked for a value outside the range in which it holds."""


class ParameterError(LeakageError):
    """A parameter, a path or a motor is declared with values that contradict each other."""


class ShapeError(LeakageError):
    """Arrays that belong together differ in shape."""


class CurveError(LeakageError):
    """The points of a simulated curve do not determine the law that is to be fitted to them."""


class StatisticsError(LeakageError):
    """A block of samples cannot be turned into statistics."""


class EstimationError(LeakageError):
    """There is nothing that could be estimated from the samples at hand."""
