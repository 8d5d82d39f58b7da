"""Values do not change after they are made: all dataclasses but those that collect are frozen."""

from __future__ import annotations

import re
from pathlib import Path

import trajeval_ros

# What grows while something is read, sent or received.
COLLECTING = {
    *("Chunk", "McapContents", "MessageIndex", "Registry", "TopicReading", "TopicSelection"),
    *("PlaybackResult", "Progress", "StateCounts", "StreamStatus", "WatchAlarm"),
    *("_Kind", "_Leaves"),
}
DATACLASS = r"^ *@(?:dataclasses\.)?dataclass(?:\(([^()]*)\))?\n *class (\w+)"


def test_dataclasses_are_frozen_unless_they_collect() -> None:
    assert trajeval_ros.__file__ is not None
    files = Path(trajeval_ros.__file__).parent.rglob("*.py")
    texts = [each.read_text("utf-8") for each in files]
    found = [each for text in texts for each in re.findall(DATACLASS, text, re.MULTILINE)]
    assert len(found) > 200
    assert len(found) == sum(len(re.findall(r"(?m)^ *@.*dataclass\b", text)) for text in texts)
    assert {name for options, name in found if "frozen=True" not in options} == COLLECTING
