"""Pages of the site that lie outside `docs/`: the README, the change log, benchmark results."""

from __future__ import annotations

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
LINK = re.compile(
    r"(?P<image>!?)\[(?P<text>[^\]]*)\]\((?P<path>(?!\w+:|#)[^)#\s]+)(?P<anchor>[^)]*)\)"
)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that lie outside."""
    for place, page in OUTSIDE.items():
        files.append(File.generated(config, page, abs_src_path=str(ROOT / place)))
    return files


def on_page_markdown(markdown: str, page: Page, files: Files, **_: object) -> str:
    """Turn links between files of the repository into links between pages.

    What is no page, such as a source file, keeps its text without a link.
    """
    here = page.file.src_uri
    places = {page: place for place, page in OUTSIDE.items()}
    folder = PurePosixPath(places.get(here, f"docs/{here}")).parent

    def moved(link: re.Match[str]) -> str:
        place = normpath(str(folder / link["path"]))
        target = OUTSIDE.get(place, place.removeprefix("docs/"))
        if files.get_file_from_path(target) is None and (ROOT / place).exists():
            return link["text"]
        there = relpath(target, PurePosixPath(here).parent)
        return f"{link['image']}[{link['text']}]({there}{link['anchor']})"

    return LINK.sub(moved, markdown)
