"""What is saved is read back to the bit, and is there whole or not at all."""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import SAME_ROTATION_RAD, make_groundtruth, seeds

from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.outlier_stamps import LONE, OutlierStamps
from trajeval_ros.geometry.source_info import SourceInfo
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.encode_messages import (
    encode_odometry,
    encode_stamped,
    encode_transforms,
)
from trajeval_ros.io.save_trajectories import save_trajectories
from trajeval_ros.io.sources import each_topic, read_trajectory

COLUMNS = ("stamps", "positions", "quaternions")
# For each way to save: the columns that are read back to the bit.
WAYS: dict[tuple[str, str], tuple[str, ...]] = {
    ("tum", "PoseStamped"): COLUMNS,
    ("euroc", "PoseStamped"): (
        *COLUMNS,
        "velocities",
        "gyroscope_biases",
        "accelerometer_biases",
    ),
    ("kitti", "PoseStamped"): ("stamps", "positions"),
    ("mcap", "PoseStamped"): COLUMNS,
    ("mcap", "Odometry"): (*COLUMNS, "covariances"),
    ("mcap", "Path"): COLUMNS,
    # Rotations of transforms are multiplied along the tree when they are read.
    ("mcap", "tf"): ("stamps", "positions"),
    ("rosbag2", "PoseStamped"): COLUMNS,
}
ways = pytest.mark.parametrize("way", WAYS, ids="-".join)


def made(seed: int) -> Trajectory:
    """Return a trajectory with every column, and floats of all kinds."""
    truth = make_groundtruth(seed, 60)
    factors = np.random.default_rng(seed).normal(size=(60, 6, 6))
    return dataclasses.replace(
        truth,
        positions=truth.positions * 10.0 ** (seed % 7 - 3),
        quaternions=lie.normalized(np.asarray(truth.quaternions)),
        covariances=factors @ np.swapaxes(factors, 1, 2),
        frame="odom",
        child_frame="imu",
        name="run",
    )


def again(folder: Path, trajectory: Trajectory, way: tuple[str, str]) -> Trajectory:
    kind, message = way
    (path,) = save_trajectories(folder, [trajectory], kind, message)
    tf = f":/tf:{trajectory.frame}.{trajectory.child_frame}"
    return read_trajectory(f"{path}{tf if message == 'tf' else ''}")


@ways
@given(seed=seeds)
@settings(max_examples=4, deadline=None)
def test_what_is_saved_is_read_back_to_the_bit(way: tuple[str, str], seed: int) -> None:
    trajectory = made(seed)
    with tempfile.TemporaryDirectory() as folder:
        read = again(Path(folder), trajectory, way)
        for column in WAYS[way]:
            np.testing.assert_array_equal(getattr(read, column), getattr(trajectory, column))
        assert read.rotations is not None
        assert trajectory.rotations is not None
        rotated = (read.rotations * trajectory.rotations.inv()).magnitude()
        assert rotated.max() <= SAME_ROTATION_RAD


@given(seed=seeds)
@settings(max_examples=4, deadline=None)
def test_kittis_matrices_are_read_back_to_the_bit(seed: int) -> None:
    trajectory = made(seed)
    with tempfile.TemporaryDirectory() as first, tempfile.TemporaryDirectory() as second:
        read = again(Path(first), trajectory, ("kitti", "PoseStamped"))
        more = again(Path(second), read, ("kitti", "PoseStamped"))
    np.testing.assert_array_equal(
        read.reading.matrices, lie.to_matrix(np.asarray(trajectory.quaternions))
    )
    np.testing.assert_array_equal(more.reading.matrices, read.reading.matrices)
    np.testing.assert_array_equal(more.quaternions, read.quaternions)


@given(
    stamps=st.lists(st.integers(0, 2**31 * 10**9 - 1), min_size=2, max_size=20, unique=True).map(
        sorted
    ),
    way=st.sampled_from([("tum", ""), ("euroc", ""), ("mcap", ""), ("kitti", "")]),
)
@settings(max_examples=20, deadline=None)
def test_any_stamps_survive(stamps: list[int], way: tuple[str, str]) -> None:
    times = np.array(stamps)
    # Zeros among times since 1970 are dropped as no times.
    trajectory = Trajectory(times[times > 0], np.ones((int((times > 0).sum()), 3)), name="run")
    if len(trajectory) < 2:
        return
    with tempfile.TemporaryDirectory() as folder:
        read = again(Path(folder), trajectory, (way[0], "PoseStamped"))
    expected = trajectory.stamps
    if way[0] == "mcap":  # where a stamp that stands alone is dropped, and counted
        (expected,) = OutlierStamps().take(expected, at_end=True)
        assert read.reading.dropped.get(LONE, 0) == len(trajectory) - len(expected)
    np.testing.assert_array_equal(read.stamps, expected)


@ways
def test_positions_alone_stay_positions_alone(way: tuple[str, str], tmp_path: Path) -> None:
    full = made(1)
    bare = Trajectory(full.stamps, full.positions, frame="odom", child_frame="imu", name="run")
    if way[1] == "tf":
        with pytest.raises(InputError, match="no orientations"):
            again(tmp_path, bare, way)
        return
    read = again(tmp_path, bare, way)
    np.testing.assert_array_equal(read.positions, bare.positions)
    assert read.quaternions is None


def test_messages_are_those_of_rosbags() -> None:
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    trajectory = made(2)
    poses = np.hstack([trajectory.positions, np.asarray(trajectory.quaternions)])
    covariances = np.asarray(trajectory.covariances).reshape(-1, 36)
    for frames in (("map", "base_link"), ("", "x"), ("odom_1", "")):
        kinds = {
            "geometry_msgs/msg/PoseStamped": encode_stamped(trajectory.stamps, poses, frames[0]),
            "nav_msgs/msg/Odometry": encode_odometry(
                trajectory.stamps, poses, covariances, trajectory.positions, frames
            ),
            "tf2_msgs/msg/TFMessage": encode_transforms(trajectory.stamps, poses, frames),
        }
        for kind, rows in kinds.items():
            for row in (0, 59):
                payload = rows[row].tobytes()
                message: Any = store.deserialize_cdr(payload, kind)
                assert bytes(store.serialize_cdr(message, kind)) == payload
                first = message.transforms[0] if kind.endswith("TFMessage") else message
                stamp = first.header.stamp.sec * 10**9 + first.header.stamp.nanosec
                assert stamp == trajectory.stamps[row]
                assert first.header.frame_id == frames[0]


def test_several_in_one_bag_keep_their_topics(tmp_path: Path) -> None:
    one = dataclasses.replace(made(1), name="a", reading=SourceInfo("run.mcap:/vio/odom"))
    two = dataclasses.replace(made(2), name="b", reading=SourceInfo("run.mcap:/gt/pose"))
    (path,) = save_trajectories(tmp_path, [one, two], "mcap")
    assert set(each_topic(str(path))) == {f"{path}:/vio/odom", f"{path}:/gt/pose"}
    np.testing.assert_array_equal(read_trajectory(f"{path}:/gt/pose").positions, two.positions)
    (transforms,) = save_trajectories(tmp_path / "tf", [one, two], "mcap", "tf")
    read = read_trajectory(f"{transforms}:/tf:odom.b")
    np.testing.assert_array_equal(read.positions, two.positions)


def test_names_become_files_and_topics_that_can_be(tmp_path: Path) -> None:
    odd = [dataclasses.replace(made(1), name=name) for name in ("../1 run", "2#b", "_1_run")]
    paths = save_trajectories(tmp_path, odd, "tum")
    assert [path.parent for path in paths] == [tmp_path] * 3
    assert len({path.name for path in paths}) == 3
    (bag,) = save_trajectories(tmp_path, odd[1:2], "mcap")
    assert each_topic(str(bag)) == [f"{bag}:/_2_b"]


def test_nothing_is_overwritten_or_half_there(tmp_path: Path) -> None:
    trajectory = made(3)
    for kind in ("tum", "kitti", "euroc", "mcap", "rosbag2"):
        folder = tmp_path / kind
        save_trajectories(folder, [trajectory], kind)
        before = sorted(folder.rglob("*"))
        with pytest.raises(InputError, match="exists; remove it"):
            save_trajectories(folder, [trajectory], kind)
        assert sorted(folder.rglob("*")) == before
    late = dataclasses.replace(trajectory, stamps=trajectory.stamps - trajectory.stamps[-1])
    with pytest.raises(InputError, match="before 1970"):
        save_trajectories(tmp_path / "late", [late], "mcap")
    assert not list((tmp_path / "late").iterdir())
    with pytest.raises(SettingsError, match="unknown format"):
        save_trajectories(tmp_path / "none", [trajectory], "csv")
    assert not (tmp_path / "none").exists()
