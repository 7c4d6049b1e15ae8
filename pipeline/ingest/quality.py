"""The quality that a log states of its own samples: good, or anything else."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pipeline.config.channels import QualityValue
from pipeline.errors import LogError
from pipeline.ingest.arrow_types import is_number, is_text

_GOOD, _BAD, BLANK = 0, 1, 2
"""States of a cell of a quality column."""

_MOST_VALUES = 1000
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)(e[+-]?[0-9]+)?|[+-]?inf(inity)?")
_TRUTH = {"true": 1.0, "false": 0.0}


def quality_states(
    path: Path, name: str, cells: pa.Array | pa.ChunkedArray, good: Iterable[QualityValue]
) -> NDArray[np.uint8]:
    """State of each cell of a quality column: good, bad or blank; blank where it is null.

    Text is compared without regard to case and blanks around it, and as a number where both are
    numbers: 192, 192.0 and "192" are one, and so are true and 1.

    Raises
    ------
    LogError
        ``log_type``: the column holds neither text nor numbers, or too many different ones.

    Examples
    --------
    >>> cells = pa.array(["Good", "GOOD ", "192.0", "Uncertain", "0", ""])
    >>> quality_states(Path("a.csv"), "quality", cells, ("Good", 192)).tolist()
    [0, 0, 0, 1, 1, 2]
    """
    if not _can_be_quality(cells.type):
        raise LogError("log_type", path, f"a column of type {cells.type} is no quality", name)
    texts = frozenset(map(_text, good))
    numbers = frozenset(number for text in texts if (number := _number(text)) is not None)
    states = np.empty(len(cells), np.uint8)
    at = 0
    for chunk in cells.chunks if isinstance(cells, pa.ChunkedArray) else [cells]:
        encoded = chunk if pa.types.is_dictionary(chunk.type) else chunk.dictionary_encode()
        values = encoded.dictionary.to_pylist()
        if len(values) > _MOST_VALUES:
            raise LogError(
                "log_type", path, f"more than {_MOST_VALUES} different values are no quality", name
            )
        # The last one is for null.
        of_value = np.array([*(_state(v, texts, numbers) for v in values), BLANK], np.uint8)
        if "" in texts:
            of_value[-1] = _GOOD
        index = encoded.indices.cast(pa.int64()).fill_null(len(values)).to_numpy()
        states[at : at + len(chunk)] = of_value[index]
        at += len(chunk)
    return states


def is_bad(states: NDArray[np.uint8], missing: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Samples that the log does not call good: where the quality is blank, those with a value."""
    bad: NDArray[np.bool_] = (states == _BAD) | ((states == BLANK) & ~missing)
    return bad


def _can_be_quality(kind: pa.DataType) -> bool:
    if pa.types.is_dictionary(kind):
        return _can_be_quality(kind.value_type)
    return is_text(kind) or is_number(kind) or pa.types.is_boolean(kind) or pa.types.is_null(kind)


def _state(value: object, texts: frozenset[str], numbers: frozenset[float]) -> int:
    text = "" if value is None or value != value else _text(value)
    if text in texts or _number(text) in numbers:
        return _GOOD
    return _BAD if text else BLANK


def _text(value: object) -> str:
    return str(value).strip().casefold()


def _number(text: str) -> float | None:
    if text in _TRUTH:
        return _TRUTH[text]
    # `float` also takes 1_92 and the digits of other scripts.
    return float(text) if _NUMBER.fullmatch(text) else None
