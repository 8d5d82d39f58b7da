"""Reading of YAML files as untrusted input: with a size limit, and without running code."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from trajeval_ros.exceptions import InputError, reason_of
from trajeval_ros.formatting.numbers import data_size

_BARE_PATTERN = re.compile(r"""[{,:]\s*[^'"\s{}]*\{\w+\}""")  # {ours: vio/{sequence}.txt}
_LARGEST, _LARGEST_GENERATED = 1_000_000, 1 << 22  # bytes
# Lines and elements in brackets. Reading one takes 0.3 ms, with libyaml 0.03 ms.
_MOST_ELEMENTS, _MOST_GENERATED_ELEMENTS = 20_000, 200_000
_MOST_BITS = 64
_OPENCV_HEAD = "%YAML:1.0"  # in OpenCV's and EuRoC's files; not valid YAML because of the colon


def read_mapping(
    path: Path, what: str, *, is_generated: bool = False, as_text: bool = False
) -> dict[str, Any]:
    """Return the mapping in the first document of a YAML file.

    `as_text`: whether all scalars are texts, so that 0.20 keeps its digits.

    `is_generated`: whether a program writes such files. Then they may be larger, and libyaml reads
    them. It is many times faster, but reads an unquoted `no` or `off` as false.
    """
    from ruamel.yaml import YAML

    try:
        largest = _LARGEST_GENERATED if is_generated else _LARGEST
        if path.stat().st_size > largest:
            raise InputError(
                f"{path} is larger than {data_size(largest)}, the limit for YAML ({what}); check "
                "the path"
            )
        text = path.read_text(encoding="utf-8")
        most = _MOST_GENERATED_ELEMENTS if is_generated else _MOST_ELEMENTS
        if sum(map(text.count, "\n,[{")) > most:
            raise InputError(
                f"{path} has more than {most} lines and elements for {what}; shorten it"
            )
    except OSError as error:
        raise InputError(f"{path} can't be read: {reason_of(error)}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not valid YAML: {error}") from error
    yaml = YAML(typ="base" if as_text else "safe", pure=not is_generated)
    try:
        first = next(iter(yaml.load_all(text.removeprefix(_OPENCV_HEAD))), None)
    except Exception as error:  # many types: of the parser, and RecursionError of deep nesting
        line = str(getattr(error, "problem", None) or error).split("\n", 1)[0]
        mark = getattr(error, "problem_mark", None)
        where = f" in line {mark.line + 1}" if mark is not None else ""
        hint = _flow_hint(text, mark.line) if mark is not None else ""
        raise InputError(f"{path} is not valid YAML{where}: {line}{hint}") from error
    if not isinstance(first, dict) or not all(isinstance(key, str) for key in first):
        raise InputError(f"{path} has no {what}; write a mapping of names to values")
    if _has_large_integer(first):
        raise InputError(f"{path} has an integer of more than 64 bits; correct the number")
    return first


def _flow_hint(text: str, number: int) -> str:
    """Return the end of a message if braces of a pattern are read as a mapping in a line."""
    line = text.splitlines()[number : number + 1]
    if not line or not _BARE_PATTERN.search(line[0]):
        return ""
    return '; write patterns with braces in quotes, as in {vio: "vio/{sequence}.txt"}'


def _has_large_integer(content: Any) -> bool:
    """Return whether a document has an integer that can't become text or a float."""
    waiting, seen = [content], set()
    while waiting:
        value = waiting.pop()
        if isinstance(value, int) and value.bit_length() > _MOST_BITS:
            return True
        # An anchor can occur any number of times.
        if isinstance(value, (dict, list)) and id(value) not in seen:
            seen.add(id(value))
            waiting += [*value.keys(), *value.values()] if isinstance(value, dict) else value
    return False
