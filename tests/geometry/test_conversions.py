"""Conversions of users' arrays, conventions, axes, names and projections, by hand."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from strategies import make_groundtruth

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import array_input, lie
from trajeval_ros.geometry.frame_axes import upright, with_body_axes, with_world_axes
from trajeval_ros.geometry.marker import HandEye, at_arms
from trajeval_ros.geometry.pose_conventions import Conventions
from trajeval_ros.geometry.source_info import SourceInfo
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.trajectory_edits import flattened, merged
from trajeval_ros.geometry.up_axis import UpAxis

Array = NDArray[np.float64]
SECOND = 1_000_000_000
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


def states(count: int = 6, **changed: Any) -> Trajectory:
    truth = make_groundtruth(7, count)
    roots = np.random.default_rng(0).normal(size=(count, 6, 6))
    return dataclasses.replace(
        truth, covariances=roots @ np.swapaxes(roots, 1, 2), name="run", **changed
    )


def matrices_of(trajectory: Trajectory) -> Array:
    assert trajectory.rotations is not None
    return np.asarray(trajectory.rotations.as_matrix())


class Table:
    """A part of the interface of a table."""

    def __init__(self, columns: dict[str, Any], index: Any) -> None:
        self.columns, self.index, self._columns = list(columns), index, columns

    def __getitem__(self, names: Any) -> Any:
        if isinstance(names, list):
            return Table({name: self._columns[name] for name in names}, self.index)
        return self._columns[names]

    def to_numpy(self) -> Array:
        return np.column_stack([self._columns[name] for name in self.columns])


def test_tables_have_times_in_a_column_or_the_index() -> None:
    places = {"X": [1.0, 2.0], "y": [3.0, 4.0], "Z": [5.0, 6.0]}
    rotations = {name: [0.0, 0.0] for name in ("qx", "qy", "qz")} | {"qw": [1.0, 1.0]}
    ordinal = np.arange(2)
    result = array_input.columns_of_frame(Table(places, ordinal))
    np.testing.assert_array_equal(result["positions"], [[1, 3, 5], [2, 4, 6]])
    assert result["quaternions"] is None
    assert {"stamps", "seconds"} & result.keys() == set()
    result = array_input.columns_of_frame(Table({**places, **rotations}, ordinal + 10**13))
    np.testing.assert_array_equal(result["quaternions"], [IDENTITY, IDENTITY])
    assert result["stamps"].tolist() == [10**13, 10**13 + 1]
    assert "stamps" not in array_input.columns_of_frame(Table(places, ordinal + 10**12 - 1))
    result = array_input.columns_of_frame(Table({**places, "Time": ordinal}, ordinal))
    assert result["stamps"].tolist() == [0, 1]
    result = array_input.columns_of_frame(Table({**places, "t": [0.5, 1.5]}, ordinal))
    assert result["seconds"].tolist() == [0.5, 1.5]
    dates = np.array(["1970-01-01T00:00:01", "1970-01-01T00:00:02"], dtype="datetime64[s]")
    result = array_input.columns_of_frame(Table(places, dates))
    assert result["stamps"].tolist() == [SECOND, 2 * SECOND]
    with pytest.raises(InputError, match="name the positions x, y and z"):
        array_input.columns_of_frame(Table({"x": [1.0], "y": [2.0]}, ordinal))
    del rotations["qw"]
    with pytest.raises(InputError, match="only qx, qy, qz of"):
        array_input.columns_of_frame(Table({**places, **rotations}, ordinal))


def test_units_scale_positions_velocities_and_covariances() -> None:
    truth = states()
    result = Conventions(scale=0.5).corrected(truth)
    np.testing.assert_array_equal(result.positions, 0.5 * truth.positions)
    assert result.velocities is not None
    assert truth.velocities is not None
    np.testing.assert_array_equal(result.velocities, 0.5 * truth.velocities)
    units = np.diag([0.5, 0.5, 0.5, 1.0, 1.0, 1.0])
    assert result.covariances is not None
    assert truth.covariances is not None
    np.testing.assert_allclose(result.covariances, units @ truth.covariances @ units)
    assert "multiplied by 0.5" in result.reading.remarks[-1].text
    assert Conventions().corrected(truth) is truth


@pytest.mark.parametrize("axes", ["y,z,x", "-x,-y,z", "x,-y,z"])
@pytest.mark.parametrize("of", ["", "positions=", "rotations="])
def test_axes_of_positions_and_rotations(axes: str, of: str) -> None:
    truth = states()
    matrix = np.zeros((3, 3))
    for row, name in enumerate(axes.split(",")):
        matrix[row, "xyz".index(name[-1])] = -1.0 if name.startswith("-") else 1.0
    flipped = np.linalg.det(matrix) < 0.0
    if flipped and of == "rotations=":
        return
    result = Conventions(axes=of + axes).corrected(truth)
    moved = np.eye(3) if of == "rotations=" else matrix
    np.testing.assert_allclose(result.positions, truth.positions @ moved.T)
    assert result.velocities is not None
    assert truth.velocities is not None
    np.testing.assert_allclose(result.velocities, truth.velocities @ moved.T)
    rotated = np.eye(3) if of == "positions=" else matrix
    expected = rotated @ matrices_of(truth)
    if flipped and of != "positions=":
        expected = expected @ rotated.T
    np.testing.assert_allclose(matrices_of(result), expected, atol=1e-14)
    assert result.covariances is None


def test_inverse_poses_are_those_of_the_world_in_the_body() -> None:
    truth = states()
    result = Conventions(inverse="poses").corrected(truth)
    rotations = matrices_of(truth)
    np.testing.assert_allclose(
        result.positions, -np.einsum("nji,nj->ni", rotations, truth.positions), atol=1e-12
    )
    np.testing.assert_allclose(matrices_of(result), np.swapaxes(rotations, 1, 2), atol=1e-14)
    only = Conventions(inverse="rotations").corrected(truth)
    np.testing.assert_array_equal(only.positions, truth.positions)
    np.testing.assert_allclose(matrices_of(only), np.swapaxes(rotations, 1, 2), atol=1e-14)


def test_what_a_convention_needs() -> None:
    points = Trajectory(np.arange(3), np.zeros((3, 3)))
    for wrong in ({"quaternion_order": "wxyz"}, {"inverse": "poses"}):
        with pytest.raises(InputError, match="orientations"):
            Conventions(**wrong).corrected(points)
    unstamped = dataclasses.replace(points, reading=SourceInfo(stamped=False))
    with pytest.raises(InputError, match="no timestamps, which a clock rate needs"):
        Conventions(clock_rate=10.0).corrected(unstamped)
    late = dataclasses.replace(points, stamps=np.array([5, 3, 4]) * SECOND)
    result = Conventions(clock_rate=100.0).corrected(late)
    assert (result.stamps - late.stamps).tolist() == [200_000, 0, 100_000]


def test_a_marker_moves_covariances_and_names() -> None:
    truth = states(child_frame="base")
    assert truth.rotations is not None
    hand_eye = HandEye(IDENTITY, np.array([0.4, -0.2, 0.6]), "imu", "ball")
    moved = hand_eye.of_marker(truth, 2.0)
    arms = truth.rotations.apply(hand_eye.lever_m / 2.0)
    assert truth.covariances is not None
    assert moved.covariances is not None
    np.testing.assert_allclose(moved.covariances, at_arms(truth.covariances, arms), atol=1e-12)
    assert moved.child_frame == "base"
    assert moved.velocities is None
    assert HandEye(IDENTITY, np.zeros(3)).of_marker(truth, 1.0).velocities is truth.velocities
    assert HandEye(IDENTITY, np.zeros(3)).of_body(truth).velocities is truth.velocities
    assert hand_eye.names("g", "e", of_marker=True) == ("g", "ball")
    assert hand_eye.names("g", "e", of_marker=False) == ("imu", "e")
    bare = HandEye.of(None, None)
    assert bare.names("g", "e", of_marker=True) == ("g", "g")
    assert bare.names("g", "e", of_marker=False) == ("e", "e")
    inverse = hand_eye.inverse()
    assert (inverse.body, inverse.marker) == ("ball", "imu")
    vector = np.array([0.1, 0.2, 0.3])
    np.testing.assert_allclose(lie.rotation_vector(HandEye.of(vector, None).rotation_xyzw), vector)
    with pytest.raises(InputError, match="has no orientations, which a lever arm needs"):
        hand_eye.of_marker(dataclasses.replace(truth, quaternions=None), 1.0)


@pytest.mark.parametrize(
    ("groundtruth", "estimate", "refused"),
    [("imu", "ball", True), ("ball", "imu", False), ("imu", "imu", False), ("", "ball", False)],
)
def test_inverse_transforms_are_known_by_their_names(
    groundtruth: str, estimate: str, refused: bool
) -> None:
    hand_eye = HandEye(IDENTITY, np.zeros(3), "imu", "ball")
    sides = [states(child_frame=name) for name in (groundtruth, estimate)]
    if refused:
        with pytest.raises(InputError, match="is inverted"):
            hand_eye.require_frames(*sides)
    else:
        hand_eye.require_frames(*sides)
    HandEye(IDENTITY, np.zeros(3), "imu", "imu").require_frames(*sides)


@pytest.mark.parametrize(("plane", "normal"), [("xy", 2), ("xz", 1), ("yz", 0)])
def test_projections_keep_the_turn_about_the_normal(plane: str, normal: int) -> None:
    truth = states()
    result = flattened(truth, plane)
    kept = [axis for axis in range(3) if axis != normal]
    np.testing.assert_array_equal(result.positions[:, kept], truth.positions[:, kept])
    assert not result.positions[:, normal].any()
    assert result.velocities is not None
    assert not result.velocities[:, normal].any()
    angles = np.linspace(-3.0, 3.0, 6)
    axis = np.eye(3)[normal]
    rotations = Rotation.from_rotvec(np.outer(angles, axis)).as_quat()
    flat = flattened(dataclasses.replace(truth, quaternions=rotations), plane)
    assert flat.quaternions is not None
    np.testing.assert_allclose(lie.rotation_vector(flat.quaternions) @ axis, angles, atol=1e-12)


def test_merging_needs_times_and_one_vertical_axis() -> None:
    truth = states()
    with pytest.raises(InputError, match="run has no timestamps, which --merge needs"):
        merged([truth, dataclasses.replace(truth, reading=SourceInfo(stamped=False))])
    with pytest.raises(InputError, match="the vertical axis is z"):
        merged([truth, dataclasses.replace(truth, up=UpAxis("-y"))])
    whole = merged([truth[3:], truth[:4]])
    assert [remark.code for remark in whole.reading.remarks][:2] == ["merged", "merged_duplicates"]
    bare = merged([truth[:3], dataclasses.replace(truth[3:], velocities=None)])
    assert bare.velocities is None
    assert bare.quaternions is not None


def test_quaternions_that_were_w_first() -> None:
    truth = states()
    result = Conventions(quaternion_order="wxyz").corrected(truth)
    assert result.quaternions is not None
    assert truth.quaternions is not None
    np.testing.assert_array_equal(result.quaternions, np.roll(truth.quaternions, -1, axis=1))


def test_axes_of_bodies_and_worlds() -> None:
    truth = states()
    # The rows are right, down and ahead in ROS axes.
    optical = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    body = with_body_axes(truth, "optical")
    np.testing.assert_allclose(matrices_of(body), matrices_of(truth) @ optical.T, atol=1e-14)
    np.testing.assert_array_equal(body.positions, truth.positions)
    world = with_world_axes(truth, "optical")
    np.testing.assert_array_equal(world.positions, truth.positions @ optical.T)
    np.testing.assert_allclose(matrices_of(world), optical @ matrices_of(truth), atol=1e-14)
    with pytest.raises(InputError, match="no orientations"):
        with_body_axes(dataclasses.replace(truth, quaternions=None), "ros")
    files = SourceInfo(matrices=matrices_of(truth))
    rotated = upright(dataclasses.replace(truth, up=UpAxis("-y"), reading=files))
    assert rotated.reading.matrices is not None
    np.testing.assert_allclose(rotated.reading.matrices, matrices_of(rotated), atol=1e-14)
