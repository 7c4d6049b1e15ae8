"""Reads what the report packs, apart from the code that packs it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any


def night_file(path: Path) -> dict[str, Any]:
    """The payload that a night's script hands over."""
    found = re.fullmatch(r"motorLeakage\.night\((.*)\);\n", path.read_text("utf-8"), re.DOTALL)
    return json.loads(found[1])


def page_payload(page: Path) -> dict[str, Any]:
    """The payload within a motor's page."""
    pattern = r'<script type="application/json" id="payload">(.*?)</script>'
    found = re.search(pattern, page.read_text("utf-8"), re.DOTALL)
    return json.loads(found[1])
