"""Coverage-guided fuzzing of what reads strangers' bytes: `make fuzz-bytes`.

Whatever the bytes, the CDR decoder raises nothing, and the readers of MCAP and of ROS 1 bags
nothing but errors about the file.

Usage: python tests/support/fuzz_bags.py CORPUS [options of libFuzzer]
"""

from __future__ import annotations

import io
import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["trajeval_ros.io"]):
    from trajeval_ros.exceptions import InputError
    from trajeval_ros.io.bags.blocks import TopicSelection, all_connections, are_of
    from trajeval_ros.io.bags.cdr import CdrPlan
    from trajeval_ros.io.bags.foxglove import TYPES, FoxglovePlan
    from trajeval_ros.io.bags.mcap_bag import McapReader
    from trajeval_ros.io.bags.message_definitions import STANDARD, ros1_fields
    from trajeval_ros.io.bags.pose_messages import (
        decode_path,
        decode_poses,
        decode_transforms,
        plan_of,
    )
    from trajeval_ros.io.bags.ros1_bag import Ros1Reader

import numpy as np
from mcap.writer import CompressionType, Writer
from memory_file import Memory
from rosbags.rosbag1 import Writer as Ros1Writer

POSE = "geometry_msgs/msg/PoseStamped"
KINDS = sorted(STANDARD)
PLANS = [CdrPlan(STANDARD[kind]) for kind in KINDS]
PLANS += [CdrPlan(ros1_fields(STANDARD[kind]), is_ros1=True) for kind in KINDS]
POSES = plan_of(None, POSE)
ROS1_POSES = plan_of(None, POSE, is_ros1=True)
BAG = Path(tempfile.mkdtemp()) / "x.bag"
FOXGLOVE = [FoxglovePlan(kind, "json") for kind in TYPES]
ROS1 = 253  # the first byte of an input that is a bag of ROS 1
JSON = 254  # the first byte of messages in JSON
MCAP = 255  # the first byte of an input that is a file


def one_input(data: bytes) -> None:
    """Read bytes as a file, or as messages that are each as long as the second byte says."""
    if len(data) < 2:
        return
    if data[0] == MCAP:
        for strict in (False, True):
            read_file(data[1:], strict=strict)
        return
    if data[0] == ROS1:
        read_ros1(data[1:])
        return
    if data[0] == JSON:
        for item in FOXGLOVE:
            item.decode([data[1:]])
        return
    size = data[1] or 1
    payloads = [data[place : place + size] for place in range(2, len(data), size)]
    plan = PLANS[data[0] % len(PLANS)]
    assert len(plan.decode(payloads).rows) <= len(payloads)
    decode_poses(payloads, POSE)
    decode_transforms(payloads)
    decode_path(data[2:])


def read_file(data: bytes, *, strict: bool) -> None:
    try:
        reader = McapReader(Memory(data), strict=strict)
    except InputError:
        return
    channels = [frozenset([connection.id]) for connection in reader.connections]
    channels.append(frozenset().union(*channels))
    assert reader.span is None or len(reader.span) == 2
    together = [TopicSelection(channel) for channel in channels]
    for selections in (*([item] for item in together), together):
        for block in reader.blocks(selections):
            assert are_of(block.connections, all_connections(selections)).all()
            columns = POSES.decode_at(block.buffer, block.begins, block.sizes)
            assert len(columns.rows) <= len(block)
            list(block.decompressed())


def read_ros1(data: bytes) -> None:
    try:
        BAG.write_bytes(data)
        reader = Ros1Reader(BAG, "x.bag")
    except Exception:  # `bag._one_sentence` makes a sentence of the library's exceptions
        return
    selection = TopicSelection(frozenset(connection.id for connection in reader.connections))
    for block in reader.blocks([selection]):
        assert (block.begins + block.sizes <= len(block.buffer)).all()
        ROS1_POSES.decode_at(block.buffer, block.begins, block.sizes)


def seeds(folder: Path) -> None:
    """Write inputs to begin with: small files of all kinds, and messages."""
    folder.mkdir(parents=True, exist_ok=True)
    random = np.random.default_rng(0)
    payload = b"\0\1\0\0" + bytes(8) + b"\4\0\0\0map\0" + random.normal(size=7).tobytes()
    for number in range(len(PLANS)):
        (folder / f"messages_{number}").write_bytes(bytes([number, len(payload)]) + payload * 3)
    (folder / "json").write_bytes(
        bytes([JSON]) + b'{"timestamp": {"sec": 1, "nsec": 2}, "frame_id": "map", "pose": '
        b'{"position": {"x": 1, "y": 2, "z": 3}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}}'
    )
    for ros1_compression in (None, *Ros1Writer.CompressionFormat):
        path = folder / f"ros1_{ros1_compression}"
        path.unlink(missing_ok=True)
        old = Ros1Writer(path)
        if ros1_compression is not None:
            old.set_compression(ros1_compression)
        with old:
            topic = old.add_connection(
                "/pose", POSE, msgdef="# nothing", md5sum="d3812c3cbc69362b77dc0b19b345f8f5"
            )
            for row in range(4):
                old.write(topic, row, payload)
        path.write_bytes(bytes([ROS1]) + path.read_bytes())
    for compression in CompressionType:
        for chunked in (True, False):
            output = io.BytesIO()
            writer = Writer(
                output, compression=compression, use_chunking=chunked, enable_crcs=False
            )
            writer.start(profile="ros2")
            schema = writer.register_schema(POSE, "ros2msg", b"")
            channel = writer.register_channel("/pose", "cdr", schema)
            for row in range(4):
                writer.add_message(channel, row, payload, row)
            writer.finish()
            name = f"file_{compression.name}_{chunked}"
            (folder / name).write_bytes(bytes([MCAP]) + output.getvalue())


if __name__ == "__main__":
    seeds(Path(sys.argv[1]))
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()
