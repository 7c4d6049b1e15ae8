"""Pages of the site that lie outside `docs/`: the README, the change log, benchmark results; and
the notebooks as pages."""

from __future__ import annotations

import json
import re
from pathlib import Path, PurePosixPath
from posixpath import normpath, relpath

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
    """Text and code of a notebook, as Markdown."""
    cells = json.loads(notebook.read_text("utf-8"))["cells"]
    parts = [("".join(cell["source"]), cell["cell_type"] == "code") for cell in cells]
    return "\n\n".join(f"```python\n{text}\n```" if code else text for text, code in parts)


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
