"""What MkDocs adds to docs: pages from the code, links to the repository, formulas, a check."""

from __future__ import annotations

import html
import re
import tempfile
from pathlib import Path, PurePosixPath
from posixpath import normpath
from typing import Any

import gallery
import offline
import reference
from latex2mathml.converter import convert
from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[2]
REPOSITORY = "https://github.com/trajeval/trajeval_ros/blob/main/"
_APPENDED = {
    "figures.md": gallery.section,
    "python.md": reference.names,
    "settings.md": reference.parameters,
}
_FORMULA = re.compile(
    r'<(?:span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</(?:span|div)>', re.DOTALL
)
_LINK = re.compile(r"(?<=\]\()(?!https?:|mailto:|#)([^)\s#]+)")


def on_files(files: Any, config: Any) -> Any:
    """Add the pages that are written from the code, and the figures of the gallery."""
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").replace("](docs/", "](../")
    pages: dict[str, str | bytes] = {
        "generated/command_line.md": reference.command_line(),
        "generated/changelog.md": changelog,
    }
    with tempfile.TemporaryDirectory() as folder:
        figures = gallery.draw(Path(folder))
    pages |= {f"gallery/{name}": content for name, content in figures.items()}
    for name, content in pages.items():
        files.append(File.generated(config, name, content=content))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Append what the code writes, and lead links to files that are no pages to the repository."""
    if (written := _APPENDED.get(page.file.src_uri)) is not None:
        markdown += "\n" + written()
    here = PurePosixPath("docs") / PurePosixPath(page.file.src_uri).parent

    def lead(match: re.Match[str]) -> str:
        target = normpath((here / match[1]).as_posix())
        is_page = target.startswith("docs/") and target.endswith((".md", ".png"))
        if is_page or target.startswith("docs/generated"):
            return match[1]
        if not (ROOT / target).exists():
            raise FileNotFoundError(f"{page.file.src_uri} links to {target}, which doesn't exist")
        return REPOSITORY + target

    return _LINK.sub(lead, markdown)


def on_page_content(content: str, **_: Any) -> str:
    """Typeset formulas as MathML, which browsers draw without a script."""
    return _FORMULA.sub(
        lambda found: convert(
            html.unescape(found[2]), display="inline" if found[1] == "(" else "block"
        ),
        content,
    )


def on_post_build(config: Any, **_: Any) -> None:
    """Refuse a site that needs a network to be read."""
    found = offline.foreign_references(Path(config["site_dir"]))
    if found:
        raise RuntimeError("the site refers to other hosts:\n" + "\n".join(found))
