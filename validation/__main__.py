"""`python -m validation pump_rig FOLDER` and `python -m validation machines`.

With `--page` the tables go into their page, too, and the pictures beside it.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

from validation import published, pump_rig
from validation.tables import show


def main() -> None:
    """Answer one set of questions."""
    parser = argparse.ArgumentParser(prog="python -m validation", description=__doc__)
    parser.add_argument("subject", choices=("pump_rig", "machines"))
    default = os.environ.get("MOTOR_LEAKAGE_TEST_DATA")
    parser.add_argument("folder", nargs="?", default=default, help="of records *UT*.csv")
    parser.add_argument("--page", type=Path, help="Markdown page to put the tables into")
    asked = parser.parse_args()
    if asked.subject == "pump_rig" and not asked.folder:
        parser.error("name the folder of the records")
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(scratch) / "work"
        if asked.subject == "machines":
            show(published.judge(work), asked.page)
        else:
            pictures = asked.page.parent / "pictures" if asked.page else None
            show(pump_rig.judge(Path(asked.folder), work, pictures=pictures), asked.page)


if __name__ == "__main__":
    main()
