"""PX4's poses from logs and bags: axes, timestamps, validity flags, resets, damage."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import unittest.mock
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyulog
from click.testing import CliRunner
from numpy.typing import NDArray
from paths import SHARED
from rosbags.rosbag2 import Writer
from scipy.spatial.transform import Rotation
from ulog import write_ulog

from trajeval_ros import Protocol, evaluate
from trajeval_ros.cli.app import app
from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.pose_messages import decode_poses
from trajeval_ros.io.bags.px4_messages import ODOMETRY, PX4_POSE_TYPES
from trajeval_ros.io.bags.topics import trajectory_of_columns
from trajeval_ros.io.describe import Description, describe
from trajeval_ros.io.find_sources import find_sources
from trajeval_ros.io.roles import likely_evaluations
from trajeval_ros.io.sources import each_topic, read_many, read_trajectory

Array = NDArray[Any]
DATA = SHARED / "data" / "px4"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the PX4 logs are not here")
M = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
B = np.diag([1.0, -1.0, -1.0])
NED, FRD, BODY = 1, 2, 3
COUNT = 30


def turns() -> Array:
    """The 24 rotations that permute axes, and six others, (30, 3, 3)."""
    cube = [
        np.array(signs)[:, None] * np.eye(3)[list(order)]
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    ]
    cube = [item for item in cube if np.linalg.det(item) > 0.0]
    return np.concatenate([cube, Rotation.random(COUNT - 24, random_state=1).as_matrix()])


def odometry(**changes: Any) -> dict[str, Array]:
    """The columns of 30 messages of `vehicle_odometry` of PX4 1.14 or later."""
    rng = np.random.default_rng(2)
    times = 1_000_000 + 10_000 * np.arange(COUNT, dtype=np.uint64)
    xyzw = Rotation.from_matrix(turns()).as_quat()
    full = {
        "timestamp": times + np.uint64(2000),
        "timestamp_sample": times,
        "pose_frame": np.full(COUNT, NED),
        "position": rng.normal(size=(COUNT, 3)),
        "q": xyzw[:, [3, 0, 1, 2]],
        "velocity_frame": np.full(COUNT, NED),
        "velocity": rng.normal(size=(COUNT, 3)),
        "position_variance": np.tile([0.01, 0.04, 0.09], (COUNT, 1)),
        "orientation_variance": np.tile([1e-4, 4e-4, 9e-4], (COUNT, 1)),
        "reset_counter": np.zeros(COUNT),
        "quality": np.zeros(COUNT),
    } | changes
    kinds = {"pose_frame": "u1", "velocity_frame": "u1", "reset_counter": "u1", "quality": "i1"}
    return {
        name: item if item.dtype == np.uint64 else item.astype(kinds.get(name, "f8"))
        for name, item in full.items()
    }


def local_position(**changes: Any) -> dict[str, Array]:
    times = 1_000_000 + 10_000 * np.arange(COUNT, dtype=np.uint64)
    rows = np.arange(COUNT, dtype=np.float32)
    full = {"timestamp": times, "x": rows, "y": 2 * rows, "z": -rows}
    full |= {name: np.ones(COUNT, dtype=np.float32) for name in ("vx", "vy", "vz")}
    ones, zeros = np.ones(COUNT, dtype=np.uint8), np.zeros(COUNT, dtype=np.uint8)
    full |= {"xy_valid": ones, "z_valid": ones}
    full |= {f"{name}_reset_counter": zeros for name in ("xy", "z", "heading")}
    return full | changes


def read(
    folder: Path, name: str, columns: dict[str, Array], **more: dict[str, Array]
) -> Trajectory:
    path = folder / "log.ulg"
    write_ulog(path, [(name, 0, columns), *((other, 0, item) for other, item in more.items())])
    return read_trajectory(f"{path}:{name}")


def message(trajectory: Trajectory) -> str:
    return "; ".join(remark.text for remark in trajectory.reading.remarks)


@pytest.mark.parametrize(("frame", "world"), [(NED, M), (FRD, B)])
@pytest.mark.parametrize("in_body", [False, True])
def test_poses_are_in_ros_axes(tmp_path: Path, frame: int, world: Array, in_body: bool) -> None:
    velocity_frame = BODY if in_body else frame
    columns = odometry(
        pose_frame=np.full(COUNT, frame), velocity_frame=np.full(COUNT, velocity_frame)
    )
    result = read(tmp_path, "vehicle_odometry", columns)
    rotations = turns()
    np.testing.assert_allclose(result.positions, columns["position"] @ world, atol=1e-15)
    assert result.quaternions is not None
    assert result.velocities is not None
    np.testing.assert_allclose(
        lie.to_matrix(result.quaternions), world @ rotations @ B, atol=4e-15
    )
    in_world = columns["velocity"]
    if in_body:
        in_world = np.einsum("nij,nj->ni", rotations, in_world)
    np.testing.assert_allclose(result.velocities, in_world @ world, atol=1e-14)
    assert result.covariances is not None
    np.testing.assert_allclose(
        result.covariances[:, :3, :3],
        np.broadcast_to(world @ np.diag([0.01, 0.04, 0.09]) @ world, (COUNT, 3, 3)),
        atol=1e-16,
    )
    own = world @ rotations @ B
    about = own @ np.diag([1e-4, 4e-4, 9e-4]) @ np.swapaxes(own, 1, 2)
    np.testing.assert_allclose(result.covariances[:, 3:, 3:], about, atol=1e-16)
    assert (result.frame, result.child_frame) == (
        "map_enu" if frame == NED else "odom_flu",
        "base_link_flu",
    )
    assert f"converted from {'NED' if frame == NED else 'FRD'}" in message(result)


def test_level_and_north_is_a_yaw_of_90_deg(tmp_path: Path) -> None:
    columns = odometry(q=np.tile([1.0, 0.0, 0.0, 0.0], (COUNT, 1)))
    result = read(tmp_path, "vehicle_odometry", columns)
    assert result.quaternions is not None
    np.testing.assert_allclose(lie.yaw(result.quaternions), np.pi / 2.0)


def test_velocities_in_another_frame_are_missing_and_the_pose_is_kept(tmp_path: Path) -> None:
    result = read(tmp_path, "vehicle_odometry", odometry(velocity_frame=np.full(COUNT, FRD)))
    assert len(result) == COUNT
    assert result.velocities is None


def test_timestamps_are_of_the_measurement_if_that_is_plausible(tmp_path: Path) -> None:
    columns = odometry()
    measured = columns["timestamp_sample"].copy()
    measured[0], measured[1] = 0, 1  # not set, and not set before the bridge's offset
    measured[2] = columns["timestamp"][2] + 1
    columns["timestamp"] += np.uint64(2_000_000)
    measured[3:] += np.uint64(2_000_000)
    result = read(tmp_path, "vehicle_odometry", columns | {"timestamp_sample": measured})
    expected = [*columns["timestamp"][:3], *measured[3:]]
    assert result.stamps.tolist() == [1000 * int(item) for item in expected]


def test_unusable_poses_are_dropped_and_counted(tmp_path: Path) -> None:
    columns = odometry(quality=np.where(np.arange(COUNT) % 10 == 5, -1, 0))
    columns["position"][3, 1] = np.nan
    columns["q"][4:6] = np.nan
    columns["q"][6] *= 1.02
    columns["pose_frame"][7] = 0
    columns["pose_frame"][8:10] = FRD
    columns["velocity_frame"][8:10] = FRD
    result = read(tmp_path, "vehicle_odometry", columns)
    assert result.reading.dropped == {
        "no_position": 1,
        "no_orientation": 3,
        "unknown_frame": 1,
        "other_frame": 2,
    }
    assert len(result) == COUNT - 7
    assert result.frame == "map_enu"
    assert "2 messages with quality -1" in message(result)


def test_variances_of_one_kind_are_kept_and_the_missing_ones_counted(tmp_path: Path) -> None:
    """Also of the layout of PX4 1.13, which has a triangle of a matrix."""
    columns = odometry()
    columns["position_variance"][4:] = np.nan
    columns["orientation_variance"][:3] = 0.0
    result = read(tmp_path, "vehicle_odometry", columns)
    whole = read(tmp_path, "vehicle_odometry", odometry())
    assert result.covariances is not None
    assert whole.covariances is not None
    expected = whole.covariances.copy()
    expected[4:, :3, :3] = expected[:3, 3:, 3:] = np.nan
    np.testing.assert_array_equal(result.covariances, expected)
    assert (
        "covariances are incomplete: 26 messages without variances of the position, 3"
        in message(result)
    )
    assert "incomplete" not in message(whole)
    old = {name: columns[name] for name in ("timestamp", "timestamp_sample", "q")}
    old |= dict(zip("xyz", columns["position"].T, strict=True))
    old |= dict(zip(("vx", "vy", "vz"), columns["velocity"].T, strict=True))
    triangle = np.full((COUNT, 21), 1e-3)
    triangle[:, 15] = np.nan
    old |= {"local_frame": np.zeros(COUNT, dtype=np.uint8), "pose_covariance": triangle}
    result = read(tmp_path, "vehicle_odometry", old)
    assert result.covariances is not None
    assert np.isfinite(result.covariances[:, :3, :3]).all()
    assert "30 messages without variances of the orientation" in message(result)
    nothing = {f"{item}_variance": np.zeros((COUNT, 3)) for item in ("position", "orientation")}
    result = read(tmp_path, "vehicle_odometry", odometry(**nothing))
    assert result.covariances is None
    assert "incomplete" not in message(result)


def test_declared_resets_have_a_step_and_a_turn(tmp_path: Path) -> None:
    """The counter wraps, and the motion by the velocity belongs to no step."""
    rows = np.arange(COUNT)
    positions = np.outer(rows * 0.01, [3.0, 0.0, 0.0])
    positions[20:] += [0.3, 0.4, 0.0]
    headings = np.where(rows < 25, 0.0, 0.1)
    columns = odometry(
        position=positions,
        velocity=np.tile([3.0, 0.0, 0.0], (COUNT, 1)),
        q=np.column_stack([np.cos(headings / 2), *np.zeros((2, COUNT)), np.sin(headings / 2)]),
        reset_counter=np.where(rows < 20, 255, np.where(rows < 25, 0, 1)),
    )
    result = read(tmp_path, "vehicle_odometry", columns)
    first, second = result.reading.resets
    assert (first.stamp_ns, second.stamp_ns) == (1_200_000_000, 1_250_000_000)
    np.testing.assert_allclose(first[1:], [0.5, 0.0], atol=1e-5)
    np.testing.assert_allclose(second[1:], [0.0, np.degrees(0.1)], atol=1e-5)
    assert "2 resets declared by the estimator: at 0.20 s 0.50 m and 0.0 deg" in message(result)
    assert message(result).endswith("use --start @1.250")


def test_local_positions_get_interpolated_attitudes(tmp_path: Path) -> None:
    times = 995_000 + 10_000 * np.arange(COUNT + 1, dtype=np.uint64)
    headings = 0.02 * np.arange(COUNT + 1)
    q = np.column_stack([np.cos(headings / 2), *np.zeros((2, COUNT + 1)), np.sin(headings / 2)])
    keep = np.r_[:10, 22 : COUNT + 1]  # a gap of 0.13 s
    attitude = {"timestamp": times[keep], "q": q[keep]}
    result = read(tmp_path, "vehicle_local_position", local_position(), vehicle_attitude=attitude)
    assert result.reading.dropped == {"no_attitude_within_0.1_s": 13}
    assert result.quaternions is not None
    rows = np.r_[:9, 22:COUNT]
    yaw = np.pi / 2.0 - (0.02 * rows + 0.01)
    np.testing.assert_allclose(lie.yaw(result.quaternions), yaw, atol=1e-12)
    np.testing.assert_array_equal(result.positions, np.column_stack([2 * rows, rows, rows]))
    assert result.velocities is not None
    np.testing.assert_array_equal(result.velocities[0], [1.0, 1.0, -1.0])


def test_local_positions_without_attitudes_are_points(tmp_path: Path) -> None:
    result = read(tmp_path, "vehicle_local_position_groundtruth", local_position())
    assert result.quaternions is None
    assert len(result) == COUNT


@pytest.mark.parametrize(("flag", "axis"), [("xy", "horizontal"), ("z", "vertical")])
def test_positions_that_the_estimator_did_not_have_are_refused(
    tmp_path: Path, flag: str, axis: str
) -> None:
    columns = local_position(**{f"{flag}_valid": np.zeros(COUNT, dtype=np.uint8)})
    match = f"{flag}_valid is false in all 30 messages: the estimator had no {axis} position"
    with pytest.raises(InputError, match=match):
        read(tmp_path, "vehicle_local_position", columns)
    some = np.arange(COUNT) >= 4
    result = read(tmp_path, "vehicle_local_position", columns | {f"{flag}_valid": some.view("u1")})
    assert result.reading.dropped == {f"{flag}_valid_false": 4}


def test_fixes_have_the_height_and_accuracy_of_the_receiver(tmp_path: Path) -> None:
    times = 1_000_000 + 100_000 * np.arange(9, dtype=np.uint64)
    floats = {"eph": 2.0, "epv": 3.0, "latitude_deg": 47.0, "longitude_deg": 8.5}
    columns = {name: np.full(9, value) for name, value in floats.items()}
    columns["latitude_deg"] += 1e-5 * np.arange(9)
    columns |= {"timestamp": times, "altitude_ellipsoid_m": 400.0 + np.arange(9)}
    columns |= {"fix_type": np.arange(9, dtype=np.uint8)}
    result = read(tmp_path, "sensor_gps", columns)
    assert result.reading.dropped == {"no_fix": 4}
    fixes = result.reading.fixes
    assert fixes is not None
    assert fixes.status.tolist() == [0, 1, 2, 2, 0]
    np.testing.assert_allclose(fixes.places[:, 2], [403.0, 404.0, 405.0, 406.0, 408.0])
    np.testing.assert_allclose(fixes.sigma_level_m, 2.0)


def test_topics_of_a_log_are_named_and_listed(tmp_path: Path) -> None:
    path = tmp_path / "log.ulg"
    names = [("vehicle_odometry", 0), ("estimator_odometry", 1), ("vehicle_mocap_odometry", 0)]
    write_ulog(path, [(name, instance, odometry()) for name, instance in names])
    result = each_topic(str(path))
    assert sorted(item.rpartition(":")[2] for item in result) == [
        "estimator_odometry.1",
        "vehicle_mocap_odometry",
        "vehicle_odometry",
    ]
    one, other = read_many([f"{path}:vehicle_odometry", f"{path}:estimator_odometry.1"])
    np.testing.assert_array_equal(one.positions, other.positions)
    assert one.name == "vehicle_odometry"
    with pytest.raises(InputError, match=r"choose one as in .*:TOPIC, of "):
        read_trajectory(path)
    with pytest.raises(InputError, match="has no topic odometry; topics with poses: "):
        read_trajectory(f"{path}:odometry")
    roles = {
        trajectory.source.rpartition(":")[2]: trajectory.could_be
        for trajectory in describe(str(path)).trajectories
    }
    assert roles["vehicle_mocap_odometry"] == "groundtruth"
    assert roles["vehicle_odometry"] == "estimate"
    listed = CliRunner().invoke(app, ["info", str(tmp_path)])
    assert "PX4 log" in listed.output


def test_a_log_of_the_simulator_needs_no_topics(tmp_path: Path) -> None:
    path, saved = tmp_path / "ground_truth" / "log.ulg", tmp_path / "result.json"
    path.parent.mkdir()
    topics = [("vehicle_odometry", 0, odometry()), ("estimator_odometry", 1, odometry())]
    truth = "vehicle_local_position_groundtruth"
    write_ulog(path, [*topics, (truth, 0, local_position())])
    call = ["evaluate", str(path), "--gauge", "none", "--json", str(saved)]
    with unittest.mock.patch("pyulog.ULog", wraps=pyulog.ULog) as parser:
        ran = CliRunner().invoke(app, call)
    assert ran.exit_code == 0
    assert parser.call_count == 1
    assert f"assumed: groundtruth {truth}: by its name; change it with -g" in ran.output
    assert "assumed: estimate vehicle_odometry: not named as groundtruth" in ran.output
    assert f"repeat: trajeval evaluate -g {path}:{truth} -e " in ran.output
    result = json.loads(saved.read_text())
    assert result["groundtruth"]["source"] == f"{path}:{truth}"
    named = {run["estimate"]["source"].rpartition(":")[2] for run in result["runs"]}
    assert named == {"vehicle_odometry", "estimator_odometry.1"}
    for written, why in (
        (topics[:1], "has no likely groundtruth; name it: trajeval evaluate -g GROUNDTRUTH"),
        ([(truth, 0, local_position())], "has no two likely sides; list its topics"),
    ):
        write_ulog(path, written)
        assert f"{path} {why}" in str(CliRunner().invoke(app, call).exception)


@needs_data
def test_a_flight_has_the_same_roles_and_choice_as_a_log_and_as_a_bag() -> None:
    sides = [describe(str(DATA / f"synthetic_1_16.{ending}")) for ending in ("ulg", "mcap")]
    log, bag = ({_name(item.source): item for item in side.trajectories} for side in sides)
    names = sorted(log.keys() & bag.keys())
    assert len(names) == 3
    chosen = []
    for side in (log, bag):
        shared = Description(DATA, tuple(side[name] for name in names))
        chosen.append(
            [
                (_name(item.groundtruth), *map(_name, item.estimates), item.modality)
                for item in likely_evaluations(shared)
            ]
        )
    assert [log[name].could_be for name in names] == [bag[name].could_be for name in names]
    assert chosen[0] == chosen[1]
    assert chosen[0] == [
        ("vehicle_mocap_odometry", "vehicle_odometry", "gnss-aided"),
        ("vehicle_mocap_odometry", "vehicle_visual_odometry", "stereo-inertial"),
    ]


def _name(source: str) -> str:
    """Return the topic of uORB in a SOURCE."""
    return source.rpartition(":")[2].rpartition("/")[2]


def test_a_search_reads_only_the_start_of_a_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "log.ulg"
    write_ulog(path, [("vehicle_odometry", 0, odometry())])
    (whole,) = find_sources(tmp_path).sources
    assert (whole.kind, whole.topics) == ("PX4 log", ("vehicle_odometry",))
    monkeypatch.setattr("trajeval_ros.io.find_sources._PX4_BYTES", 1500)
    with path.open("ab") as file:
        file.truncate(1 << 33)
    (start,) = find_sources(tmp_path).sources
    assert (start.kind, start.topics) == ("PX4 log, first 0 MB", ("vehicle_odometry",))


def test_damage_is_reported_and_refused_if_strict(tmp_path: Path) -> None:
    path = tmp_path / "log.ulg"
    write_ulog(path, [("vehicle_odometry", 0, odometry())])
    raw = bytearray(path.read_bytes())
    raw[-1500:-1100] = bytes(400)
    path.write_bytes(raw)
    result = read_trajectory(f"{path}:vehicle_odometry")
    assert 0 < len(result) < COUNT
    assert "is damaged" in "; ".join(result.reading.messages(Level.ERROR))
    with pytest.raises(InputError, match="is damaged"):
        read_trajectory(f"{path}:vehicle_odometry", strict=True)
    path.write_bytes(raw[:20])
    with pytest.raises(InputError, match=r"log\.ulg"):
        read_trajectory(f"{path}:vehicle_odometry")


@pytest.mark.slow
def test_a_log_without_pyulog_names_the_command(tmp_path: Path) -> None:
    path = tmp_path / "log.ulg"
    write_ulog(path, [("vehicle_odometry", 0, odometry())])
    code = (
        "import sys; sys.modules['pyulog'] = None\n"
        "from trajeval_ros import read_trajectory\n"
        f"read_trajectory({str(path)!r} + ':vehicle_odometry')"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "is a log of PX4, which needs an extra; install it: " in ran.stderr
    assert "[px4]" in ran.stderr


def test_messages_of_no_release_are_refused_with_the_sizes() -> None:
    head = b"\0\1\0\0"
    for kind in PX4_POSE_TYPES:
        assert decode_poses([head + bytes(300)], kind).undecodable == 1
        assert decode_poses([head], kind).undecodable == 1
    poses = decode_poses([head + bytes(200)] * 5, ODOMETRY)
    with pytest.raises(InputError, match=r"none of its 5 .*118, 265 bytes.*release/1.14 differ"):
        trajectory_of_columns("bag:/o", "/o", ODOMETRY, poses, ())


def test_a_definition_of_something_else_is_refused(tmp_path: Path) -> None:
    with Writer(tmp_path / "bag", version=9) as bag:
        connection = bag.add_connection("/o", ODOMETRY, msgdef="uint8 a", rihs01="unknown")
        bag.write(connection, 10**18, b"\0\1\0\0\1")
    with pytest.raises(InputError, match=r"has no field timestamp; use px4_msgs of PX4 1\.12"):
        read_trajectory(tmp_path / "bag")


@needs_data
def test_conversions_equal_the_reference() -> None:
    """At 20 timestamps of every topic; float32 numbers as read, converted in doubles."""
    reference = json.loads((SHARED / "reference" / "px4.json").read_text())
    compared = 0
    for log, name, expected in _topics(reference):
        topic = "vehicle_local_position_groundtruth" if name == "groundtruth" else name
        result = read_trajectory(f"{DATA / log}:{topic}")
        assert len(result) == expected["kept"]
        at = np.searchsorted(result.stamps, 1000 * np.array(expected["t_us"]))
        assert (result.stamps[at] == 1000 * np.array(expected["t_us"])).all()
        np.testing.assert_allclose(result.positions[at], expected["p"], rtol=0, atol=1e-12)
        assert result.quaternions is not None
        rotated = result.quaternions[at]
        signs = np.sign(np.einsum("ni,ni->n", rotated, expected["q"]))
        np.testing.assert_allclose(rotated * signs[:, None], expected["q"], rtol=0, atol=1e-12)
        if result.velocities is not None:
            # The reference turns by float32 quaternions, whose length is not exactly 1.
            body = lie.rotate(lie.conjugate(rotated), result.velocities[at])
            np.testing.assert_allclose(
                body, np.array(expected["v_body"], dtype=float), rtol=0, atol=1e-6
            )
        if result.covariances is not None:
            diagonals = np.einsum("nii->ni", result.covariances[at])
            np.testing.assert_allclose(diagonals, expected["cov_diagonal"], rtol=0, atol=1e-9)
            np.testing.assert_allclose(
                result.covariances[at][:, 0], expected["cov_row_1"], rtol=0, atol=1e-12
            )
        for reset, step in zip(
            result.reading.resets, expected.get("reset_steps", []), strict=True
        ):
            np.testing.assert_allclose(reset[1:], step, atol=1e-4)
        stamps = [item.stamp_ns / 1e9 for item in result.reading.resets]
        assert stamps == expected.get("resets_s", [])
        compared += 1
    assert compared == 9


def _topics(reference: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    for log, topics in reference.items():
        for name, expected in topics.items():
            if expected.get("kept") and "flags ignored" not in name:
                yield log, name, expected


@pytest.mark.slow
@needs_data
def test_errors_equal_the_reference() -> None:
    reference = json.loads((SHARED / "reference" / "px4.json").read_text())
    for log in ("synthetic_1_13.ulg", "synthetic_1_16.ulg"):
        truth = read_trajectory(f"{DATA / log}:vehicle_local_position_groundtruth")
        known = {
            name: item for name, item in reference[log].items() if "none" in item.get("errors", ())
        }
        assert known
        for name, expected in known.items():
            estimate = read_trajectory(f"{DATA / log}:{name}")
            for gauge in ("none", "yaw", "se3"):
                result = evaluate(truth, estimate, Protocol(gauge=gauge)).ate
                values = expected["errors"][gauge]
                assert result["position_m"].rmse == pytest.approx(
                    values["position_rmse_m"], abs=1e-9
                )
                assert result["rotation_deg"].rmse == pytest.approx(
                    values["rotation_rmse_deg"], abs=1e-6
                )


@needs_data
@pytest.mark.parametrize(
    ("bag", "log"),
    [
        ("synthetic_1_16.mcap", "synthetic_1_16.ulg"),
        ("synthetic_1_16_no_definitions", "synthetic_1_16.ulg"),
        ("synthetic_1_13_no_definitions", "synthetic_1_13.ulg"),
    ],
)
def test_bags_with_and_without_definitions_equal_the_log(bag: str, log: str) -> None:
    for topic in ("out/vehicle_odometry", "in/vehicle_visual_odometry"):
        result = read_trajectory(f"{DATA / bag}:/fmu/{topic}")
        logged = read_trajectory(f"{DATA / log}:{topic.rpartition('/')[2]}")
        assert (result.stamps - logged.stamps == 1_750_000_000 * 10**9).all()
        for name in ("positions", "quaternions", "velocities", "covariances"):
            np.testing.assert_array_equal(getattr(result, name), getattr(logged, name))
        assert result.reading.dropped == logged.reading.dropped
        assert [reset[1:] for reset in result.reading.resets] == [
            reset[1:] for reset in logged.reading.resets
        ]


@needs_data
@pytest.mark.parametrize(
    ("log", "count"), [("sitl_groundtruth_1_13", 1268), ("bench_1_11", 636), ("bench_2016", 678)]
)
def test_logs_without_a_position_are_refused(log: str, count: int) -> None:
    with pytest.raises(InputError, match=f"xy_valid is false in all {count} messages"):
        read_trajectory(f"{DATA / log}.ulg:vehicle_local_position")


@needs_data
def test_a_cut_log_is_read_up_to_its_end(tmp_path: Path) -> None:
    raw = (DATA / "synthetic_1_16.ulg").read_bytes()
    path = tmp_path / "cut.ulg"
    path.write_bytes(raw[:700_000])
    result = read_trajectory(f"{path}:vehicle_odometry")
    whole = read_trajectory(f"{DATA / 'synthetic_1_16.ulg'}:vehicle_odometry")
    np.testing.assert_array_equal(result.positions, whole.positions[: len(result)])
    assert len(result) == 1555
    assert "its last 27 bytes are truncated" in "; ".join(result.reading.messages(Level.ERROR))
    with pytest.raises(InputError, match="27 bytes"):
        read_trajectory(f"{path}:vehicle_odometry", strict=True)
