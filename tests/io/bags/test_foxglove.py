"""Poses and transforms by Foxglove's schemas, in JSON and protobuf."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags import foxglove
from trajeval_ros.io.bags.foxglove import ENCODINGS, POSE_TYPE, TRANSFORM_TYPES, FoxglovePlan
from trajeval_ros.io.describe import describe
from trajeval_ros.io.sources import read_trajectory

COUNT = 300
BEGIN = 1_700_000_000 * 10**9
RANDOM = np.random.default_rng(0)
POSITIONS = RANDOM.normal(size=(COUNT, 3))
QUATERNIONS = RANDOM.normal(size=(COUNT, 4))
QUATERNIONS /= np.linalg.norm(QUATERNIONS, axis=1)[:, None]
STAMPS = BEGIN + np.arange(COUNT) * 5_000_001
Fields = dict[str, Any]


@pytest.fixture(params=ENCODINGS)
def encoding(request: pytest.FixtureRequest) -> str:
    if request.param == "protobuf":
        pytest.importorskip("foxglove_schemas_protobuf", reason="Foxglove's schemas are missing")
    return str(request.param)


def pose(row: int) -> Fields:
    return {
        "timestamp": divmod(int(STAMPS[row]), 10**9),
        "frame_id": "map",
        "pose": {
            "position": dict(zip("xyz", POSITIONS[row].tolist(), strict=True)),
            "orientation": dict(zip("xyzw", QUATERNIONS[row].tolist(), strict=True)),
        },
    }


def transform(row: int, parent: str = "map", child: str = "base") -> Fields:
    place = pose(row)["pose"]
    return {
        "timestamp": divmod(int(STAMPS[row]), 10**9),
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": place["position"],
        "rotation": place["orientation"],
    }


def serialised(fields: Fields, kind: str, encoding: str) -> bytes:
    if encoding == "json":
        return json.dumps(with_stamps(fields, "sec", "nsec")).encode()
    name = kind.rpartition(".")[2]
    module = importlib.import_module(f"foxglove_schemas_protobuf.{name}_pb2")
    message = getattr(module, name)(**with_stamps(fields, "seconds", "nanos"))
    return bytes(message.SerializeToString())


def with_stamps(value: Any, seconds: str, nanoseconds: str) -> Any:
    """Return fields with times as an encoding has them."""
    if isinstance(value, tuple):
        return {seconds: value[0], nanoseconds: value[1]}
    if isinstance(value, list):
        return [with_stamps(item, seconds, nanoseconds) for item in value]
    if isinstance(value, dict):
        return {key: with_stamps(item, seconds, nanoseconds) for key, item in value.items()}
    return value


def bag(path: Path, encoding: str, kind: str, topic: str, messages: list[Any]) -> Path:
    payloads = [
        message if isinstance(message, bytes) else serialised(message, kind, encoding)
        for message in messages
    ]
    schemas = {"json": "jsonschema", "protobuf": "protobuf"}
    with path.open("wb") as file:
        writer = McapWriter(file, compression=CompressionType.ZSTD)
        writer.start(profile="")
        schema = writer.register_schema(kind, schemas[encoding], b"{}")
        channel = writer.register_channel(topic, encoding, schema)
        for row, payload in enumerate(payloads):
            writer.add_message(channel, BEGIN + row, payload, BEGIN + row)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def test_poses(encoding: str, tmp_path: Path) -> None:
    path = bag(tmp_path / "x.mcap", encoding, POSE_TYPE, "/pose", [*map(pose, range(COUNT))])
    read = read_trajectory(str(path))
    assert read.quaternions is not None
    np.testing.assert_array_equal(read.stamps, STAMPS)
    np.testing.assert_array_equal(read.positions, POSITIONS)
    signs = np.sign((read.quaternions * QUATERNIONS).sum(axis=1))[:, None]
    np.testing.assert_allclose(read.quaternions * signs, QUATERNIONS, atol=1e-15)
    assert (read.frame, read.child_frame, read.covariances) == ("map", "", None)
    (summary,) = describe(str(path)).trajectories
    assert (summary.kind, summary.poses) == (POSE_TYPE, COUNT)


@pytest.mark.parametrize("several", [True, False])
def test_transforms(encoding: str, several: bool, tmp_path: Path) -> None:
    kind = TRANSFORM_TYPES[several]
    messages: list[Any] = []
    for row in range(COUNT):
        both = [transform(row), transform(row, "base", f"camera{row % 3}")]
        messages += [{"transforms": both}] if several else both
    path = bag(tmp_path / "x.mcap", encoding, kind, "/transforms", messages)
    read = read_trajectory(f"{path}:/transforms:map.base")
    np.testing.assert_array_equal(read.stamps, STAMPS)
    np.testing.assert_array_equal(read.positions, POSITIONS)
    third = read_trajectory(f"{path}:/transforms:base.camera2")
    np.testing.assert_array_equal(third.positions, POSITIONS[2::3])
    counts = {edge.child: edge.count for edge in describe(str(path)).edges}
    assert counts == {"base": COUNT, **{f"camera{index}": COUNT // 3 for index in range(3)}}
    with pytest.raises(InputError, match=r"/transforms:PARENT\.CHILD"):
        read_trajectory(f"{path}:/transforms")


def test_messages_that_are_none_are_counted(encoding: str, tmp_path: Path) -> None:
    messages: list[Any] = [*map(pose, range(10))]
    messages += [b"\xff", serialised(pose(0), POSE_TYPE, encoding)[:-3]]
    path = bag(tmp_path / "x.mcap", encoding, POSE_TYPE, "/pose", messages)
    read = read_trajectory(str(path))
    np.testing.assert_array_equal(read.positions, POSITIONS[:10])
    assert read.reading.dropped == {"undecodable": 2}


def test_zeros_that_protobuf_leaves_out() -> None:
    pytest.importorskip("foxglove_schemas_protobuf", reason="Foxglove's schemas are missing")
    fields = pose(0)
    fields["pose"] = {"orientation": {"w": 1.0}}
    columns = FoxglovePlan(POSE_TYPE, "protobuf").decode(
        [serialised(fields, POSE_TYPE, "protobuf"), b""]
    )
    assert columns.numbers["pose.position"].tolist() == [[0.0] * 3] * 2
    assert columns.numbers["pose.orientation"].tolist() == [[0, 0, 0, 1], [0, 0, 0, 0]]


def changed(path: str, value: Any) -> Fields:
    """Return a pose in JSON with another value somewhere."""
    fields: Fields = with_stamps(pose(0), "sec", "nsec")
    *parents, last = path.split(".")
    at = fields
    for name in parents:
        at = at[name]
    at[last] = value
    return fields


HOSTILE = [
    *(
        json.dumps(changed(path, value)).encode()
        for path, value in [
            ("timestamp.sec", 2**63),
            ("timestamp.sec", 1.5),
            ("timestamp.nsec", -1),
            ("timestamp", None),
            ("frame_id", 3),
            ("pose.position.x", "1"),
            ("pose.position.x", True),
            ("pose.position.x", None),
            ("pose.position.x", 10**400),
            ("pose.position.x", {}),
            ("pose.position", []),
            ("pose", "here"),
        ]
    ),
    b"",
    b"[]",
    b"null",
    b"[" * 100_000,
    b"\xff\xfe",
    json.dumps({"timestamp": {"sec": 1, "nsec": 2}, "frame_id": "map"}).encode(),
]


@pytest.mark.parametrize("payload", HOSTILE, ids=range(len(HOSTILE)))
def test_json_of_the_wrong_kind_is_no_message(payload: bytes) -> None:
    good = json.dumps(changed("frame_id", "\ud800")).encode()
    columns = FoxglovePlan(POSE_TYPE, "json").decode([payload, good])
    assert columns.rows.tolist() == [1]
    assert columns.texts["header.frame_id"].names == ("?",)


@pytest.mark.slow
@given(payloads=st.lists(st.binary(max_size=60) | st.text().map(str.encode), max_size=4))
@pytest.mark.parametrize("kind", foxglove.TYPES)
def test_random_bytes_raise_nothing(kind: str, payloads: list[bytes]) -> None:
    decodable = list(filter(foxglove.is_decodable, ENCODINGS))
    assert decodable
    for encoding in decodable:
        columns = FoxglovePlan(kind, encoding).decode(payloads)
        assert len(columns.rows) <= len(payloads)


def test_protobuf_says_what_it_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    none: Callable[[str], None] = lambda name: None  # noqa: E731
    monkeypatch.setattr(foxglove, "find_spec", none)
    path = bag(tmp_path / "x.mcap", "protobuf", POSE_TYPE, "/pose", [b""])
    for source in (str(path), f"{path}:/pose"):
        with pytest.raises(InputError, match=r"pip install 'trajeval-ros\[foxglove\]'"):
            read_trajectory(source)
    assert describe(str(path)).others == (("/pose", POSE_TYPE, 1, ""),)
