"""Names of sources: given as NAME=SOURCE, or short and unique."""

from __future__ import annotations

from collections.abc import Sequence

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.formatting.escaping import part_of_topic
from trajeval_ros.io.sources import STDIN, parse_source


def split_name(text: str) -> tuple[str, str]:
    """Return name and source of NAME=SOURCE; the name is empty if none is given.

    If a file with the whole text as its path exists, the text is a source without a name.
    """
    name, equals, source = text.partition("=")
    if not equals or not name.strip() or "/" in name:
        return "", text
    return ("", text) if is_source(text) else (name.strip(), source)


def is_source(text: str) -> bool:
    """Return whether a text is a SOURCE whose file exists."""
    try:
        parse_source(text)
    except InputError:
        return False
    return True


def names_with(given: Sequence[str], sources: Sequence[str]) -> list[str]:
    """Return a name per source: the given one, or a short one if that is empty.

    Raises:
        SettingsError: Two sources have the same name.
    """
    short = iter(
        names_of([source for name, source in zip(given, sources, strict=True) if not name])
    )
    names = [name or next(short) for name in given]
    for name in filter(None, given):
        if names.count(name) > 1:
            raise SettingsError(f"two sources have the name {name!r}; give different names")
    return names


def names_of(sources: Sequence[str]) -> list[str]:
    """Return a unique short name per source, with as few parent folders as possible.

    Topics have the same names as in the live evaluator. A "-", which ROS 2 does not permit in
    topics, is kept.
    """
    parts = [_parts(source) for source in sources]
    depth = 1
    names = ["/".join(part[-1:]) for part in parts]
    while len(set(names)) < len(set(sources)) and depth < max(len(part) for part in parts):
        depth += 1
        names = ["/".join(part[-depth:]) for part in parts]
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
        return [*folders, part_of_topic(topic, kept="-")]
    # Bytes of a name that are not UTF-8, which no file of results can have.
    folders = [part.encode("utf-8", "backslashreplace").decode() for part in folders]
    stem, _, ending = folders[-1].rpartition(".")
    return [*folders[:-1], stem if stem and ending.isalnum() else folders[-1]]
