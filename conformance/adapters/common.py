"""Reads the cases and prints a result; what the adapters share."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

CASES = Path(__file__).parents[1] / "cases"
Answers = dict[str, Any]


def cases() -> Iterator[tuple[Path, list[str]]]:
    """Give the folder and the quantities of every case."""
    for file in sorted(CASES.glob("*/expected.json")):
        yield file.parent, list(json.loads(file.read_text(encoding="ascii"))["quantities"])


def print_result(tool: str, version: str, answer: Callable[[Path, list[str]], Answers]) -> None:
    """Print the answers of a tool to all cases, and its refusals."""
    results: dict[str, Any] = {}
    for folder, quantities in cases():
        try:
            results[folder.name] = answer(folder, quantities)
        except Exception as error:  # noqa: PERF203 - whatever a tool raises is its answer
            results[folder.name] = f"{type(error).__name__}: {error}"[:200]
    json.dump({"tool": tool, "version": version, "results": results}, sys.stdout, indent=1)
    print()


def has_equal_stamps(quantities: list[str]) -> bool:
    """Return whether the rows of a case pair by equal timestamps."""
    return not any(":" in quantity for quantity in quantities)


def absolute_alignments(quantities: list[str]) -> set[str]:
    """Return the alignments of the absolute errors, with the rule of association if any."""
    kept = [q for q in quantities if "position_m" in q and not q.startswith("relative")]
    return {q.rsplit(".", 1)[0].replace("position_m.", "") for q in kept}
