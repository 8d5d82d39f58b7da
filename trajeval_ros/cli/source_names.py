"""Short, unique names for sources."""

from __future__ import annotations

from collections.abc import Sequence

from trajeval_ros.formatting.topic_names import part_of_topic
from trajeval_ros.io.sources import STDIN


def names_of(sources: Sequence[str]) -> list[str]:
    """Return a unique short name per source, with as few parent folders as possible.

    Topics have the same names as in the live evaluator.
    """
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
    if source == STDIN:
        return ["stdin"]
    path, _, topic = source.rpartition("://")[2].partition(":")
    folders = [part for part in path.split("/") if part] or [path]
    if topic:
        return [*folders, part_of_topic(topic)]
    stem, _, ending = folders[-1].rpartition(".")
    return [*folders[:-1], stem if stem and ending.isalnum() else folders[-1]]
