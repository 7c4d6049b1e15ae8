"""Payloads of pages: numbers in few bytes, and JSON that no name can break out of.

A page may be opened from a file, so its data are scripts; what stands in them came out of files
of others and is never trusted.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

LARGEST = float(np.finfo(np.float32).max)
# In a string of JSON their escapes mean the same, and end no script element; what lies beyond
# ASCII, and could end a line, is escaped by JSON itself.
HARMFUL = "<>&"


def numbers(values: ArrayLike) -> dict[str, str]:
    """Numbers as little-endian single floats in Base64; NaN where there is none.

    Seven digits are kept, more than a chart can show.
    """
    wide = np.asarray(values, dtype=np.float64)
    # Beyond the largest single float is nothing that a chart could show.
    single = np.where(np.abs(wide) < LARGEST, wide, np.nan).astype("<f4")
    return {"f4": base64.b64encode(single.tobytes()).decode("ascii")}


def whole_numbers(values: ArrayLike) -> dict[str, str]:
    """Whole numbers as little-endian 32-bit ones in Base64."""
    return {"i4": base64.b64encode(np.asarray(values).astype("<i4").tobytes()).decode("ascii")}


def script_json(document: Mapping[str, Any]) -> str:
    r"""JSON that may stand inside a script, of a page or of a file of its own.

    Raises ValueError if it holds NaN or infinity, which JSON has not.
    """
    text = json.dumps(document, separators=(",", ":"), allow_nan=False)
    for character in HARMFUL:  # one after the other: `translate` takes a hundred times as long
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text
