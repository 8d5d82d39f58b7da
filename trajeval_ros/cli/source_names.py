"""Short names for the sources that a user named."""

from __future__ import annotations

from collections.abc import Sequence


def names_of(sources: Sequence[str]) -> list[str]:
    """Return a short name for each source, told apart by as many folders as it takes."""
    parts = [_parts(source) for source in sources]
    depth = 1
    names = ["/".join(each[-1:]) for each in parts]
    while len(set(names)) < len(set(sources)) and depth < max(len(each) for each in parts):
        depth += 1
        names = ["/".join(each[-depth:]) for each in parts]
    return [
        name if names.count(name) == 1 else f"{name}#{names[:place].count(name) + 1}"
        for place, name in enumerate(names)
    ]


def _parts(source: str) -> list[str]:
    path, _, topic = source.partition(":")
    if topic:
        return [part for part in (*path.split("/"), topic.strip("/")) if part]
    parts = [part for part in path.split("/") if part] or [path]
    stem, _, ending = parts[-1].rpartition(".")
    return [*parts[:-1], stem if stem and ending.isalnum() else parts[-1]]
