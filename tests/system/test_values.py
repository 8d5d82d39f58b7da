"""Values do not change after they are made: all dataclasses but those that collect are frozen."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import trajeval_ros

# What grows while something is read, sent or received.
COLLECTING = {
    *("Chunk", "McapContents", "MessageIndex", "Registry", "TopicReading", "TopicSelection"),
    *("PlaybackResult", "Progress", "StateCounts", "StreamStatus", "WatchAlarm"),
    *("_Kind", "_Leaves"),
}


def dataclasses_of(package: Path) -> Iterator[tuple[str, bool]]:
    """Yield the names of dataclasses, and whether they are frozen."""
    for file in sorted(package.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            for each in node.decorator_list if isinstance(node, ast.ClassDef) else ():
                options = each.keywords if isinstance(each, ast.Call) else []
                name = each.func if isinstance(each, ast.Call) else each
                if isinstance(node, ast.ClassDef) and ast.unparse(name).endswith("dataclass"):
                    said = {option.arg: ast.unparse(option.value) for option in options}
                    yield node.name, said.get("frozen") == "True"


def test_dataclasses_are_frozen_unless_they_collect() -> None:
    assert trajeval_ros.__file__ is not None
    found = list(dataclasses_of(Path(trajeval_ros.__file__).parent))
    assert len(found) > 200
    assert {name for name, is_frozen in found if not is_frozen} == COLLECTING
