"""The first lines of a text file: is it a trajectory, and of which layout?"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.text.layouts import Layout, recognise

COMMENT = re.compile(rb"[#%][^\n]*")
_HEAD = 1 << 16  # bytes
_SAMPLE = 50  # rows that are looked at to recognise a layout
_UTF8_MARK = b"\xef\xbb\xbf"
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")


@dataclass(frozen=True)
class TextFormat:
    """What the head of a file shows.

    Attributes:
        layout: The meaning of its columns.
        columns: Number of its columns.
        start: Offset of the first row, bytes.
    """

    layout: Layout
    columns: int
    start: int


def recognise_text(path: Path) -> TextFormat:
    """Return the layout of a file, from its first lines.

    Raises:
        InputError: It is empty, not text, or of no known layout.
    """
    head = read_head(path)
    try:
        layout = recognise(head.header, head.sample, head.commas)
    except InputError as error:
        raise InputError(f"{path} is no trajectory that can be read: {error}") from None
    return TextFormat(layout, len(head.sample[0]), head.start)


@dataclass(frozen=True)
class Head:
    """The first lines: those that aren't rows, a few rows, and where the rows begin."""

    header: list[str]
    sample: list[list[float]]
    commas: bool
    start: int


def read_head(path: Path) -> Head:
    """Look at the beginning of a file, or raise InputError if it can't hold rows of numbers."""
    with path.open("rb") as file:
        data = file.read(_HEAD)
    if not data.strip():
        raise InputError(f"{path} is empty; was the recording stopped before the first pose?")
    if data.startswith(_UTF16_MARKS):
        raise InputError(f"{path} is UTF-16 text; save it as UTF-8")
    if b"\0" in data.partition(b"\n")[0]:
        raise InputError(f"{path} is a binary file of no known kind, neither text nor a bag")
    start = len(_UTF8_MARK) if data.startswith(_UTF8_MARK) else 0
    lines = data[start:].splitlines(keepends=True)
    if len(data) == _HEAD and len(lines) > 1:
        lines.pop()  # it may be cut
    header: list[str] = []
    named = False
    for index, line in enumerate(lines):
        words = _words(line)
        numbers = [_to_float(word) for word in words]
        if words and None not in numbers:
            return Head(header, _sample(lines[index:]), b"," in line, start)
        if words and (named or numbers.count(None) < len(numbers)):
            wrong = words[numbers.index(None)][:40].decode(errors="replace")
            raise InputError(
                f"{path}, line {index + 1}: has {wrong!r} where a number should be; correct or "
                "remove the line"
            )
        named = named or bool(words)
        header.append(line.decode(errors="replace").strip().lstrip("#%").strip())
        start += len(line)
    raise InputError(f"{path} has no row of numbers in its first {len(lines)} lines")


def _words(line: bytes) -> list[bytes]:
    """Return what separators leave of a line, without its comment."""
    return COMMENT.sub(b"", line).replace(b",", b" ").split()


def _to_float(word: bytes) -> float | None:
    """Return the number that a word is, or None."""
    try:
        return None if b"_" in word else float(word)
    except ValueError:
        return None


def _sample(lines: list[bytes]) -> list[list[float]]:
    """Return the first rows, up to one that differs: reading the file says what is wrong there."""
    sample: list[list[float]] = []
    for line in lines[:_SAMPLE]:
        numbers = [_to_float(word) for word in _words(line)]
        if None in numbers or (sample and len(numbers) not in (0, len(sample[0]))):
            break
        if numbers:
            sample.append([number for number in numbers if number is not None])
    return sample
