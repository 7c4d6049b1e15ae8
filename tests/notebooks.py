"""The notebooks of the docs, executed: by their test, and for the docs site.

`python -m tests.notebooks DEMO` executes them where the demo lies, writes their figures to
`docs/pictures/` and the executed notebooks to `out/notebooks/` there, of which the docs site takes
the text of the outputs.
"""

from __future__ import annotations

import io
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from PIL import Image
from plotly.graph_objects import Figure

from tests.pipeline.report.browser import opened, wait

DOCS = Path(__file__).parent.parent / "docs"
NAMES = ("one_motor", "fleet_year", "motor_type")
COLOURS = 64


def executed(names: Sequence[str], folder: Path) -> dict[str, Any]:
    """Notebooks by name, executed in a folder one after the other by one kernel."""
    # Of requirements/docs.txt.
    import nbformat
    from nbclient import NotebookClient

    notebooks = {name: nbformat.read(DOCS / "notebooks" / f"{name}.ipynb", 4) for name in names}
    together = nbformat.v4.new_notebook(
        cells=[cell for notebook in notebooks.values() for cell in notebook.cells]
    )
    where = {"metadata": {"path": str(folder)}}
    NotebookClient(together, timeout=120, kernel_name="python3", resources=where).execute()
    return notebooks


def figures(name: str, notebook: Any) -> Iterator[tuple[str, Figure]]:
    """Name of the picture of each figure of an executed notebook, and the figure."""
    for at, cell in enumerate(notebook.cells):
        for output in cell.get("outputs", ()):
            if shown := output.get("data", {}).get("application/vnd.plotly.v1+json"):
                yield f"{name}_{at}.png", Figure(shown["data"], shown["layout"])


def main(folder: Path) -> None:
    """Execute the notebooks and write what the docs show of them."""
    kept = folder / "out" / "notebooks"
    kept.mkdir(parents=True, exist_ok=True)
    import nbformat

    with opened() as browser, tempfile.TemporaryDirectory() as work:
        for name, notebook in executed(NAMES, folder).items():
            nbformat.write(notebook, kept / f"{name}.ipynb")
            for picture, figure in figures(name, notebook):
                page = Path(work) / "figure.html"
                figure.update_layout(width=900, height=400, margin_t=50)
                figure.write_html(page, config={"displayModeBar": False})
                browser.get(page.as_uri())
                wait(browser, "return document.querySelector('.main-svg .trace')")
                chart = browser.find_element("class name", "svg-container").screenshot_as_png
                image = Image.open(io.BytesIO(chart)).convert("RGB")
                image.quantize(COLOURS).save(DOCS / "pictures" / picture, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
