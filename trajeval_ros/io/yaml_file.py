"""Reading of YAML files as untrusted input: with a size limit, and without running code."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from trajeval_ros.exceptions import InputError, reason_of

_LARGEST, _LARGEST_GENERATED = 1_000_000, 1 << 24  # bytes
_OPENCV_HEAD = "%YAML:1.0"  # in OpenCV's and EuRoC's files; not valid YAML because of the colon


def read_mapping(path: Path, what: str, *, is_generated: bool = False) -> dict[str, Any]:
    """Return the mapping in the first document of a YAML file.

    Args:
        path: The file.
        what: Expected content, for messages.
        is_generated: Whether a program writes such files. Then they may be larger, and libyaml
            reads them. It is many times faster, but reads an unquoted `no` or `off` as false.

    Raises:
        InputError: The file can't be read, is too large or is not YAML, or its first document
            is not a mapping of names.
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
    except Exception as error:  # many types: of the parser, and RecursionError of deep nesting
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
    """Check that all names are valid.

    Args:
        found: The names.
        known: All valid names.
        where: File and field with the names, for the message.
        what: Noun for a name, for the message.

    Raises:
        InputError: A name is not valid; the message suggests a similar valid name.
    """
    known = list(known)
    for name in found:
        if name not in known:
            near = get_close_matches(str(name), known, n=1)
            hint = f"did you mean {near[0]}?" if near else f"use one of {', '.join(known)}"
            raise InputError(f"{where} has an unknown {what} {name!r}; {hint}")
