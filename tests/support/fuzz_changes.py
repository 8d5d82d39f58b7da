"""Random changes: of bytes, and of trees as JSON and YAML have them."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from trajeval_ros.geometry.trajectory import Trajectory

Random = np.random.Generator
ODD: tuple[Any, ...] = (
    None, True, 0, -1, 1, 2**31, 2**63, -(2**63), 2**64, 10**400, 0.5, -0.0, 1e308,
    float("nan"), float("inf"), "", "x", "\0", "-1", "1e999", "=1+1", "/pose", [], {}, [[]],
    {"a": {}},
)  # fmt: skip
_NUMBERS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**64 - 1)


@dataclass(frozen=True)
class Changed:
    """A changed input.

    Attributes:
        what: What was done to it.
        read: Reads it, and returns the trajectory if it is one.
        poses: Number of poses that are to be read, or told of.
    """

    what: str
    read: Callable[[bool], Trajectory | None]
    poses: int = 0


Make = Callable[[Random, Path], Changed]


def pick(random: Random, several: Sequence[Any]) -> Any:
    """Return one of several."""
    return several[int(random.integers(len(several)))]


def with_other_bytes(random: Random, content: bytes) -> tuple[bytes, str]:
    """Return bytes of which some are others, and what was done to them."""
    changed, what = bytearray(content), []
    for _ in range(int(random.integers(1, 4))):
        place = int(random.integers(max(len(changed), 1)))
        kind = pick(random, ["flip", "flip", "number", "cut", "hole", "move", "zeros"])
        what.append(f"{kind} at byte {place}")
        size = int(random.integers(1, 200))
        if kind == "flip":
            changed[place : place + 1] = bytes([int(random.integers(256))])
        elif kind == "number":
            width = pick(random, [2, 4, 8])
            number = pick(random, _NUMBERS) & (256**width - 1)
            changed[place : place + width] = number.to_bytes(width, "little")
        elif kind == "cut":
            del changed[place:]
        elif kind == "hole":
            del changed[place : place + size]
        elif kind == "move":
            changed[place:place] = changed[place // 2 : place // 2 + size]
        else:
            changed[place : place + size] = bytes(size)
    return bytes(changed), ", ".join(what)


def with_other_values(random: Random, tree: Any) -> Any:
    """Return a tree in which one to three values are odd, missing or there twice."""
    for _ in range(int(random.integers(1, 4))):
        tree = _changed(random, tree)
    return tree


def _changed(random: Random, tree: Any) -> Any:
    if not isinstance(tree, (dict, list)) or not tree or random.random() < 0.1:
        return pick(random, ODD)
    copy: Any = tree.copy()
    keys = list(copy) if isinstance(copy, dict) else list(range(len(copy)))
    key = pick(random, keys)
    kind = random.random()
    if kind < 0.15:
        del copy[key]
    elif kind < 0.25 and isinstance(copy, list):
        copy.append(copy[key])
    elif kind < 0.25:
        copy[str(pick(random, ODD))] = copy[key]
    else:
        copy[key] = _changed(random, copy[key])
    return copy


def with_other_cells(
    random: Random, lines: Sequence[str], separator: str, first: int = 0
) -> tuple[list[str], str]:
    """Return a table in which one or two cells or rows are others, and what was done.

    Args:
        random: Chooses.
        lines: The table.
        separator: Of its cells.
        first: The first line that may change.
    """
    changed, what = list(lines), []
    for _ in range(int(random.integers(1, 3))):
        place = int(random.integers(first, len(changed)))
        cells = changed[place].split(separator)
        at = int(random.integers(len(cells)))
        kind = pick(random, ["odd", "odd", "number", "less", "more", "twice", "gone", "noise"])
        what.append(f"{kind} in line {place + 1}")
        if kind == "odd":
            cells[at] = str(pick(random, ODD))
        elif kind == "number":
            cells[at] = f"{random.normal() * 10.0 ** random.integers(-30, 300)}"
        elif kind == "less":
            cells.pop(at)
        elif kind == "more":
            cells.insert(at, cells[at])
        elif kind == "noise":
            cells = [random.bytes(20).decode("latin-1")]
        changed[place] = separator.join(cells)
        if kind == "twice":
            changed.insert(place, changed[place])
        elif kind == "gone" and len(changed) > first + 1:
            changed.pop(place)
    return changed, ", ".join(what)


def yaml_of(tree: Any) -> bytes:
    """Return a tree in YAML."""
    output = io.BytesIO()
    YAML(typ="safe").dump(tree, output)
    return output.getvalue()
