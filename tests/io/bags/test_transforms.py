"""Chains of transforms: the laws of composition, and real TF."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from composed import compose_transforms
from hypothesis import given
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp
from strategies import seeds

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.bags.transform_tree import Edge
from trajeval_ros.io.sources import read_trajectory

Matrices = NDArray[np.float64]
SECOND = 10**9


def random_edge(random: np.random.Generator, count: int, *, is_static: bool = False) -> Edge:
    stamps = np.cumsum(random.integers(1, 10**8, count)).astype(np.int64)
    numbers = random.normal(size=(count, 7))
    return Edge.from_columns(stamps, numbers, is_static=is_static)


def matrices(translations: Matrices, quaternions: Matrices) -> Matrices:
    poses = np.tile(np.eye(4), (len(translations), 1, 1))
    poses[:, :3, :3] = Rotation.from_quat(quaternions).as_matrix()
    poses[:, :3, 3] = translations
    return poses


def interpolated(edge: Edge, stamps: NDArray[np.int64]) -> Matrices:
    if edge.is_static:
        return matrices(edge.translations, edge.quaternions)
    translations = np.stack(
        [np.interp(stamps, edge.stamps, column) for column in edge.translations.T], axis=1
    )
    slerp = Slerp(edge.stamps, Rotation.from_quat(edge.quaternions))
    return matrices(translations, slerp(stamps).as_quat())


@given(seeds)
def test_a_chain_is_the_product_of_its_edges(seed: int) -> None:
    random = np.random.default_rng(seed)
    edges = {
        ("map", "odom"): random_edge(random, 20),
        ("odom", "base"): random_edge(random, 50),
        ("camera", "base"): random_edge(random, 1, is_static=True),  # points the other way
        ("base", "elsewhere"): random_edge(random, 30),
    }
    stamps, positions, quaternions = compose_transforms(edges, "map", "camera", "t")
    first, second = edges["map", "odom"], edges["odom", "base"]
    assert stamps[0] >= max(first.stamps[0], second.stamps[0])
    assert stamps[-1] <= min(first.stamps[-1], second.stamps[-1])
    inside = [
        edge.stamps[(edge.stamps >= stamps[0]) & (edge.stamps <= stamps[-1])]
        for edge in (first, second)
    ]
    assert len(stamps) >= max(len(item) for item in inside)
    expected = (
        interpolated(first, stamps)
        @ interpolated(second, stamps)
        @ np.linalg.inv(interpolated(edges["camera", "base"], stamps))
    )
    np.testing.assert_allclose(matrices(positions, quaternions), expected, atol=1e-9)


@given(seeds)
def test_the_way_back_is_the_inverse(seed: int) -> None:
    random = np.random.default_rng(seed)
    edges = {
        ("a", "b"): random_edge(random, 10),
        ("c", "b"): random_edge(random, 1, is_static=True),
    }
    _, *there = compose_transforms(edges, "a", "c", "t")
    _, *back = compose_transforms(edges, "c", "a", "t")
    product = matrices(*there) @ matrices(*back)
    np.testing.assert_allclose(product, np.tile(np.eye(4), (10, 1, 1)), atol=1e-9)


def test_a_single_edge_is_given_as_it_is() -> None:
    edge = random_edge(np.random.default_rng(0), 10)
    stamps, positions, quaternions = compose_transforms({("a", "b"): edge}, "a", "b", "t")
    np.testing.assert_array_equal(stamps, edge.stamps)
    np.testing.assert_array_equal(positions, edge.translations)
    np.testing.assert_allclose(quaternions, edge.quaternions, atol=1e-15)


def test_stamps_are_sorted_and_the_last_of_equals_holds() -> None:
    numbers = np.array([[x, 0, 0, 0, 0, 0, 1] for x in (1.0, 2.0, 3.0, 4.0, np.nan)])
    edge = Edge.from_columns(np.array([5, 3, 5, 4, 6]), numbers, is_static=False)
    assert edge.stamps.tolist() == [3, 4, 5]
    assert edge.translations[:, 0].tolist() == [2.0, 4.0, 3.0]


def test_the_edge_that_is_most_frequent_at_first_leads_to_the_end() -> None:
    begin = 1_700_000_000 * SECOND
    slows_down = (
        begin + np.concatenate([np.arange(0.0, 3.0, 0.01), np.arange(3.0, 60.0, 0.5)]) * SECOND
    )
    steady = begin + np.arange(0.0, 60.0, 0.05) * SECOND
    random = np.random.default_rng(1)
    edges = {
        key: Edge.from_columns(
            stamps.astype(np.int64), random.normal(size=(len(stamps), 7)), False
        )
        for key, stamps in ((("a", "b"), steady), (("b", "c"), slows_down))
    }
    stamps, _, _ = compose_transforms(edges, "a", "c", "t")
    np.testing.assert_array_equal(stamps, slows_down.astype(np.int64))


def test_a_zero_among_times_since_1970_is_no_time() -> None:
    numbers = np.array([[x, 0, 0, 0, 0, 0, 1] for x in (1.0, 2.0, 3.0)])
    begin = 1_700_000_000 * SECOND
    edge = Edge.from_columns(np.array([begin, 0, begin + 5]), numbers, is_static=False)
    assert edge.stamps.tolist() == [begin, begin + 5]
    simulated = Edge.from_columns(np.array([0, 5, 10]), numbers, is_static=False)
    assert simulated.stamps.tolist() == [0, 5, 10]
    assert len(Edge.from_columns(np.array([0]), numbers[:1], is_static=True).stamps) == 1


def test_frames_that_do_not_fit() -> None:
    random = np.random.default_rng(0)
    edges = {
        ("map", "odom"): random_edge(random, 10),
        ("odom", "base_link"): random_edge(random, 1, is_static=True),
        ("world", "vicon"): random_edge(random, 10),
    }
    with pytest.raises(InputError, match="unknown frame base_lnk; use one of base_link, "):
        compose_transforms(edges, "map", "base_lnk", "t")
    with pytest.raises(InputError, match="vicon is not connected to map; use one of"):
        compose_transforms(edges, "map", "vicon", "t")
    with pytest.raises(InputError, match="between odom and base_link are static"):
        compose_transforms(edges, "odom", "base_link", "t")
    with pytest.raises(InputError, match="between map and map are static"):
        compose_transforms(edges, "map", "map", "t")
    late = Edge.from_columns(np.array([10**15]), np.ones((1, 7)), is_static=False)
    with pytest.raises(InputError, match="no common time span"):
        compose_transforms({**edges, ("base_link", "late"): late}, "map", "late", "t")


@pytest.mark.parametrize("bag", ["tf_example.bag", "tf_example", "tf_example/tf_example.db3"])
def test_the_same_run_in_ros_1_and_ros_2(bag: str, shared_data: Path) -> None:
    source = shared_data / "bags" / bag
    moving = read_trajectory(f"{source}:/tf:odom.base_footprint")
    whole = read_trajectory(f"{source}:/tf:odom.base_link")
    reference = read_trajectory(f"{shared_data / 'bags/tf_example.bag'}:/tf:odom.base_link")
    assert len(moving) == len(whole) == 517
    assert (whole.frame, whole.child_frame) == ("odom", "base_link")
    np.testing.assert_array_equal(whole.stamps, reference.stamps)
    np.testing.assert_array_equal(whole.positions, reference.positions)


def test_tf_repeats_the_odometry(shared_data: Path) -> None:
    bag = shared_data / "bags/nav2_turtlebot.mcap"
    odometry = read_trajectory(f"{bag}:/odom")
    tf = read_trajectory(f"{bag}:/tf:/odom./base_link")
    np.testing.assert_array_equal(tf.stamps, odometry.stamps)
    np.testing.assert_allclose(tf.positions, odometry.positions, atol=1e-12)


@pytest.mark.parametrize("frames", ["", ":", ":map", ":map.", ":.map"])
def test_tf_needs_two_frames(frames: str, shared_data: Path) -> None:
    with pytest.raises(InputError, match=r"give two as in BAG:/tf:PARENT\.CHILD"):
        read_trajectory(f"{shared_data / 'bags/nav2_turtlebot.mcap'}:/tf{frames}")


def test_frames_of_a_topic_without_transforms(shared_data: Path) -> None:
    with pytest.raises(InputError, match="/odom has type nav_msgs/msg/Odometry, not transforms"):
        read_trajectory(f"{shared_data / 'bags/nav2_turtlebot.mcap'}:/odom:map.odom")
