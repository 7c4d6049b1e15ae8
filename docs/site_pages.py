"""Pages of the site that lie outside `docs/`: the README, the change log, benchmark results; and
the notebooks as pages."""

from __future__ import annotations

import json
import re
from pathlib import Path, PurePosixPath
from posixpath import normpath, relpath
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parent.parent
OUTSIDE = {"README.md": "index.md"} | {
    name: name
    for name in (
        "CHANGELOG.md",
        "CONTRIBUTING.md",
        *(path.relative_to(ROOT).as_posix() for path in ROOT.glob("benchmarks/results/*.md")),
    )
}
NOTEBOOKS = {
    f"docs/notebooks/{path.name}": f"notebooks/{path.stem}.md"
    for path in (ROOT / "docs" / "notebooks").glob("*.ipynb")
}
_ONE_LINE = re.compile(r"\s*\n\s*")
LINK = re.compile(
    r"(?P<image>!?)\[(?P<text>[^\]]*)\]\((?P<path>(?!\w+:|#)[^)#\s]+)(?P<anchor>[^)]*)\)"
)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that lie outside, and the notebooks."""
    for place, page in OUTSIDE.items():
        files.append(File.generated(config, page, abs_src_path=str(ROOT / place)))
    for place, page in NOTEBOOKS.items():
        files.append(File.generated(config, page, content=as_markdown(ROOT / place)))
    return files


def as_markdown(notebook: Path) -> str:
    """Text, code and outputs of a notebook, as Markdown.

    Figures are those of `docs/pictures/`; the other outputs are of `out/notebooks/`, where
    `make pictures` leaves the notebook executed, and are left out without it.
    """
    cells = json.loads(notebook.read_text("utf-8"))["cells"]
    parts = []
    for at, (cell, outputs) in enumerate(zip(cells, _outputs(notebook, cells), strict=True)):
        text = "".join(cell["source"])
        parts.append(f"```python\n{text}\n```" if cell["cell_type"] == "code" else text)
        picture = f"pictures/{notebook.stem}_{at}.png"
        if (ROOT / "docs" / picture).exists():
            parts.append(f"![Figure of the cell above](../{picture})")
        else:
            parts += [_output(output) for output in outputs]
    return "\n\n".join(parts)


def _outputs(notebook: Path, cells: list[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    """Return outputs by cell of the executed notebook; none where it is not that of these cells."""
    executed = ROOT / "out" / "notebooks" / notebook.name
    made = json.loads(executed.read_text("utf-8"))["cells"] if executed.exists() else []
    if [cell["source"] for cell in made] != [cell["source"] for cell in cells]:
        return [[] for _ in cells]
    return [cell.get("outputs", []) for cell in made]


def _output(output: dict[str, Any]) -> str:
    data = output.get("data", {})
    if html := "".join(data.get("text/html", ())):
        return f'<div class="output">{_ONE_LINE.sub(" ", html)}</div>'
    text = "".join(data.get("text/plain", output.get("text", ())))
    return f"```text\n{text.rstrip()}\n```"


def on_page_markdown(markdown: str, page: Page, files: Files, **_: object) -> str:
    """Turn links between files of the repository into links between pages.

    What is no page, such as a source file, keeps its text without a link.
    """
    here = page.file.src_uri
    places = {page: place for place, page in (OUTSIDE | NOTEBOOKS).items()}
    folder = PurePosixPath(places.get(here, f"docs/{here}")).parent

    def moved(link: re.Match[str]) -> str:
        place = normpath(str(folder / link["path"]))
        target = (OUTSIDE | NOTEBOOKS).get(place, place.removeprefix("docs/"))
        if files.get_file_from_path(target) is None and (ROOT / place).exists():
            return link["text"]
        there = relpath(target, PurePosixPath(here).parent)
        return f"{link['image']}[{link['text']}]({there}{link['anchor']})"

    return LINK.sub(moved, markdown)
