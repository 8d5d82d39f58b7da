"""Definitions of messages: those that are standard are known without being parsed."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from trajeval_ros.io.bags.bag import Bag
from trajeval_ros.io.bags.cdr import CdrPlan
from trajeval_ros.io.bags.message_definitions import (
    STANDARD,
    Fields,
    Repeated,
    UnplannedError,
    fields_of,
    is_standard,
    recorded_fields,
    types_in,
)
from trajeval_ros.io.bags.pose_messages import FIX_TYPE

STORES = [Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY]
WITHOUT_CONSTANTS = [kind for kind in STANDARD if kind != FIX_TYPE]


def text_of(store: Any, kind: str) -> str:
    return str(store.generate_msgdef(kind, ros_version=2)[0])


def parsed(text: str, kind: str) -> Any:
    try:
        return fields_of(types_in("MSG", text, kind), kind)
    except Exception:  # rosbags raises half a dozen kinds
        return None


@pytest.mark.parametrize("store", STORES)
@pytest.mark.parametrize("kind", WITHOUT_CONSTANTS)
def test_standard_definitions_are_what_rosbags_parses(store: Stores, kind: str) -> None:
    text = text_of(get_typestore(store), kind)
    assert is_standard(text, kind)
    assert parsed(text, kind) == STANDARD[kind]
    commented = re.sub("\n", "  # float64 x = 5\n\n", text.replace("float64 w", "float64 w 1"))
    commented = re.sub(r"^(=+|MSG: .*)  # .*$", r"\1", commented, flags=re.MULTILINE)
    commented = commented.replace("=\n\nMSG", "=\nMSG")
    assert is_standard(commented, kind)
    assert parsed(commented, kind) == STANDARD[kind]


@pytest.mark.parametrize("kind", WITHOUT_CONSTANTS)
def test_no_line_can_be_changed_unnoticed(kind: str) -> None:
    text = text_of(get_typestore(Stores.ROS2_JAZZY), kind)
    lines = text.splitlines()
    fields = [row for row, line in enumerate(lines) if len(line.split()) == 2 and ":" not in line]
    assert len(fields) > 3
    for row in fields:
        type_name, name = lines[row].split()
        others = [f"int8 {name}", f"float32[2] {name}", f"{type_name} {name}_"]
        for changed in ([], ["int8 more", lines[row]], *([item] for item in others)):
            other = "\n".join([*lines[:row], *changed, *lines[row + 1 :]])
            assert not is_standard(other, kind)
            assert parsed(other, kind) != STANDARD[kind]
    assert not is_standard(f"int8 X=1\n{text}", kind)
    assert not is_standard("", kind)


@pytest.mark.parametrize("store", STORES)
def test_a_definition_with_constants_is_parsed(store: Stores) -> None:
    text = text_of(get_typestore(store), FIX_TYPE)
    assert not is_standard(text, FIX_TYPE)
    assert parsed(text, FIX_TYPE) == STANDARD[FIX_TYPE]


def test_definitions_of_real_bags(shared_data: Path) -> None:
    result = set()
    for name in ("nav2_turtlebot.mcap", "tf_example"):
        with Bag(shared_data / "bags" / name) as bag:
            for topic in bag.topics:
                recorded = topic.connections[0]
                if topic.type in STANDARD and recorded.language == "MSG":
                    text = recorded.definition
                    assert recorded_fields(recorded) == parsed(text, topic.type)
                    result.add((topic.type, is_standard(text, topic.type)))
    assert result
    assert all(standard for _, standard in result)


def test_a_nested_message_of_one_kind_is_one_column() -> None:
    values = np.arange(5.0)
    fields: Fields = (
        ("a", (("x", "f8"),)),
        ("b", (("x", "f8"), ("y", "f8"))),
        ("c", (("x", Repeated("f8", 2)),)),
    )
    payload = b"\0\1\0\0" + values.tobytes()
    result = CdrPlan(fields, ["a", "b", "c.x"]).decode([payload, payload])
    assert result.numbers["a"].tolist() == [[0.0]] * 2
    assert result.numbers["b"].tolist() == [[1.0, 2.0]] * 2
    assert result.numbers["c.x"].tolist() == [[3.0, 4.0]] * 2
    mixed: Fields = (("d", (("x", "f8"), ("y", "f4"))),)
    for given, expected in ((fields, "c"), (mixed, "d"), (fields, "e"), (fields, "a.y")):
        with pytest.raises(UnplannedError, match=f"no field {expected} of a single type"):
            CdrPlan(given, [expected])
