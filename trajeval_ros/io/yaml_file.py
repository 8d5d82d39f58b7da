"""YAML files, which nobody vouches for: loaded up to a size, and without running what they say."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from trajeval_ros.exceptions import InputError, reason_of

_LARGEST, _LARGEST_GENERATED = 1_000_000, 1 << 24  # bytes
_OPENCV_HEAD = "%YAML:1.0"  # EuRoC's files have it, too; the standard's directive has no colon


def read_mapping(path: Path, what: str, *, is_generated: bool = False) -> dict[str, Any]:
    """Return the mapping in a file, the first of several documents.

    Args:
        path: The file.
        what: What it should hold, for messages.
        is_generated: A program writes such files, not a person: they may be larger, and are read
            by libyaml, which is many times faster but takes a bare `no` or `off` for false.

    Raises:
        InputError: It can't be read, is no YAML, or holds something else.
    """
    from ruamel.yaml import YAML

    try:
        if path.stat().st_size > (_LARGEST_GENERATED if is_generated else _LARGEST):
            raise InputError(f"{path} is too large for {what}; check the path")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path} can't be read: {reason_of(error)}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not valid YAML: {error}") from error
    try:
        first = next(
            iter(
                YAML(typ="safe", pure=not is_generated).load_all(text.removeprefix(_OPENCV_HEAD))
            ),
            None,
        )
    except Exception as error:  # YAML's own are a dozen kinds, and deep nesting has another
        line = str(getattr(error, "problem", None) or error).split("\n", 1)[0]
        mark = getattr(error, "problem_mark", None)
        where = f" in line {mark.line + 1}" if mark is not None else ""
        raise InputError(f"{path} is not valid YAML{where}: {line}") from error
    if not isinstance(first, dict) or not all(isinstance(key, str) for key in first):
        raise InputError(f"{path} has no {what}; write a mapping of names to values")
    return first


def require_known(
    found: Iterable[str], known: Iterable[str], where: str, what: str = "key"
) -> None:
    """Check that all names are known ones.

    Args:
        found: The names.
        known: All valid names.
        where: What contains them, for the message.
        what: The noun for the message.

    Raises:
        InputError: One isn't; says which might be meant.
    """
    known = list(known)
    for name in found:
        if name not in known:
            near = get_close_matches(str(name), known, n=1)
            hint = f"did you mean {near[0]}?" if near else f"use one of {', '.join(known)}"
            raise InputError(f"{where} has an unknown {what} {name!r}; {hint}")
