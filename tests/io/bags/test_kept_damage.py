"""What is read of damaged files and what is said of the damage, byte by byte, as it was kept."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from damaged_bags import SECOND, mcap_file, payloads
from kept import assert_kept
from kept_runs import told
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore
from ulog import write_ulog

COUNT = 12  # poses
PLACES = 120  # that are damaged


def mcap(path: Path) -> str:
    mcap_file(path, messages=payloads(COUNT), chunk_size=1 << 9, enable_data_crcs=True)
    return "/pose"


def unchunked_mcap(path: Path) -> str:
    mcap_file(path, messages=payloads(COUNT), use_chunking=False)
    return "/pose"


def ros1(path: Path) -> str:
    store = get_typestore(Stores.ROS1_NOETIC)
    kind = "geometry_msgs/msg/PoseStamped"
    with Writer(path) as writer:
        writer.chunk_threshold = 300
        topic = writer.add_connection("/pose", kind, typestore=store)
        for row in range(COUNT):
            pose = struct.pack("<4I3s7d", row, row + 1, 0, 3, b"map", row, 0, 0, 0, 0, 0.6, 0.8)
            writer.write(topic, row * SECOND, pose)
    return "/pose"


def ulog(path: Path) -> str:
    rotations = np.tile(np.float32([1.0, 0.0, 0.0, 0.0]), (COUNT, 1))
    times = np.arange(1, COUNT + 1, dtype=np.uint64) * 10**6
    attitude = {"timestamp": times, "q": rotations}
    axes = {axis: np.arange(COUNT, dtype=np.float32) for axis in ("x", "y", "z", "vx", "vy", "vz")}
    valid = {f"{part}_valid": np.ones(COUNT, dtype=np.uint8) for part in ("xy", "z")}
    place = {"timestamp": times, **axes, **valid}
    write_ulog(path, [("vehicle_attitude", 0, attitude), ("vehicle_local_position", 0, place)])
    return "vehicle_local_position"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("x.mcap", mcap),
        pytest.param("y.mcap", unchunked_mcap, marks=pytest.mark.slow),
        ("x.bag", ros1),
        ("x.ulg", ulog),
    ],
)
def test_damage_is_told_as_it_was(
    name: str, write: Callable[[Path], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = Path(name)
    topic = write(path)
    whole = path.read_bytes()
    lines = [f"whole: {told(f'{path}:{topic}')}"]
    for number, place in enumerate(np.linspace(0, len(whole) - 1, PLACES).astype(int).tolist()):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x81]) + whole[place + 1 :])
        lines.append(f"byte {place} changed: {told(f'{path}:{topic}')}")
        if number % 4 == 0:
            path.write_bytes(whole[:place])
            lines.append(f"cut at {place}: {told(f'{path}:{topic}')}")
    assert_kept(f"damage_{name}", "\n".join(lines))
