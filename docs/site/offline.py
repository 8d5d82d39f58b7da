"""Whether a site can be read without a network: what its pages fetch, and from where."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

_FOREIGN_IN_STYLE = re.compile(r"(?:@import|url\()\s*['\"]?(?:https?:)?//[^'\")]+")


class _References(HTMLParser):
    """Collects what a browser fetches for a page."""

    def __init__(self) -> None:
        super().__init__()
        self.fetched: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note addresses of scripts, styles, fonts, pictures and frames; links are none."""
        values = dict(attrs)
        relation = values.get("rel") or ""
        if tag == "link" and relation not in ("canonical", "next", "prev"):
            self.fetched.append(values.get("href") or "")
        elif tag != "a":
            self.fetched += [values.get(name) or "" for name in ("src", "srcset", "data")]
        self.fetched += _FOREIGN_IN_STYLE.findall(values.get("style") or "")


def fetched_from_elsewhere(name: str, text: str) -> list[str]:
    """Return what of another host a browser would fetch for a page or a style sheet."""
    if name.endswith(".css"):
        return _FOREIGN_IN_STYLE.findall(text)
    parser = _References()
    parser.feed(text)
    found = [item for item in parser.fetched if re.match(r"(https?:)?//|url\(|@import", item)]
    # Material asks GitHub for stars where a page names a repository.
    return found + ["api.github.com"] * ('data-md-component="source"' in text)


def foreign_references(folder: Path) -> list[str]:
    """Return what the pages and style sheets of a site fetch from other hosts."""
    return [
        f"{path.relative_to(folder)}: {item}"
        for path in sorted([*folder.rglob("*.html"), *folder.rglob("*.css")])
        for item in fetched_from_elsewhere(path.name, path.read_text(encoding="utf-8"))
    ]
