"""Poses inside messages of types that are no poses: fields, elements, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from damaged_bags import definition, mcap_file
from hypothesis import given
from hypothesis import strategies as st
from made_bags import TYPES, header, pose, pose_stamped, transform
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.message_definitions import TEXT, Fields, Repeated
from trajeval_ros.io.bags.nested_poses import chosen_pose, nested_poses
from trajeval_ros.io.sources import read_trajectory

COUNT = 8
SECOND = 10**9
STORE = get_typestore(Stores.ROS2_JAZZY)
DEFINITIONS = {
    "acme/msg/Status": "std_msgs/Header header\nstring state\nnav_msgs/Odometry odom\n",
    "acme/msg/Bodies": "std_msgs/Header header\nuint8 n\ngeometry_msgs/Pose[] bodies\n",
    "acme/msg/Pair": "builtin_interfaces/Time stamp\ngeometry_msgs/Pose left\n"
    "geometry_msgs/Pose right\n",
    "acme/msg/Small": "std_msgs/Header header\nacme/Place place\n",
    "acme/msg/Place": "acme/Vector position\nacme/Rotation orientation\n",
    "acme/msg/Vector": "float32 x\nfloat32 y\nfloat32 z\n",
    "acme/msg/Rotation": "float32 x\nfloat32 y\nfloat32 z\nfloat32 w\n",
    "acme/msg/State": "std_msgs/Header header\nfloat64[3] position\nfloat64[4] q\n",
    "acme/msg/States": "acme/State[] all\n",
    "acme/msg/Mixed": "std_msgs/Header header\ngeometry_msgs/Point pos\nfloat32[4] q\n",
    "acme/msg/Gains": "float64[3] position\nfloat64[4] gains\nfloat64[3] velocity\n",
}
for _name, _text in DEFINITIONS.items():
    STORE.register(get_types_from_msg(_text, _name))


def bag(folder: Path, kind: str, messages: list[Any]) -> str:
    payloads = [bytes(STORE.serialize_cdr(message, kind)) for message in messages]
    schema = kind, "ros2msg", definition(kind, STORE)
    log_times = [SECOND * row + 5 for row in range(len(messages))]
    return str(
        mcap_file(folder / "run.mcap", messages=payloads, schema=schema, log_times=log_times)
    )


def expect(read: Trajectory, stamps: list[int], xs: list[float]) -> None:
    assert read.stamps.tolist() == stamps
    np.testing.assert_array_equal(read.positions, [[x, 2.0, 3.0] for x in xs])
    assert read.quaternions is not None
    half = 0.5 / np.hypot(0.5, 1.0)
    np.testing.assert_allclose(read.quaternions[:, 2], half, rtol=1e-12)


STAMPS = [SECOND * (row + 100) for row in range(COUNT)]


@pytest.mark.parametrize("field", ["", ".odom", ".odom.pose", ".odom.pose.pose"])
def test_an_odometry_inside_a_message_has_all_its_quantities(field: str, tmp_path: Path) -> None:
    twist = TYPES["geometry_msgs/msg/Twist"](
        TYPES["geometry_msgs/msg/Vector3"](1.0, 0.0, 0.5),
        TYPES["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0),
    )
    matrix = np.diag(np.arange(1.0, 7.0)).ravel()
    messages = [
        STORE.types["acme/msg/Status"](
            header(1, "rig"),
            "ok" * (row % 3),
            TYPES["nav_msgs/msg/Odometry"](
                header(stamp, "odom"),
                "base",
                TYPES["geometry_msgs/msg/PoseWithCovariance"](pose(float(row)), matrix),
                TYPES["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
            ),
        )
        for row, stamp in enumerate(STAMPS)
    ]
    read = read_trajectory(f"{bag(tmp_path, 'acme/msg/Status', messages)}:/pose{field}")
    expect(read, STAMPS, [float(row) for row in range(COUNT)])
    assert (read.frame, read.child_frame) == ("odom", "base")
    assert read.velocities is not None
    assert read.covariances is not None
    np.testing.assert_array_equal(read.covariances[:, 2, 2], 3.0)


@pytest.mark.parametrize("field", ["[{}]", ".bodies[{}]"])
def test_an_element_is_one_body_at_the_times_of_its_messages(field: str, tmp_path: Path) -> None:
    lengths = [3, 1, 2, 0, 3, 3, 2, 1]
    messages = [
        STORE.types["acme/msg/Bodies"](
            header(stamp), 7, [pose(10.0 * body + row) for body in range(lengths[row])]
        )
        for row, stamp in enumerate(STAMPS)
    ]
    path = bag(tmp_path, "acme/msg/Bodies", messages)
    for body in range(3):
        rows = [row for row in range(COUNT) if lengths[row] > body]
        read = read_trajectory(f"{path}:/pose{field.format(body)}")
        expect(read, [STAMPS[row] for row in rows], [10.0 * body + row for row in rows])
        lost = COUNT - len(rows)
        assert dict(read.reading.dropped) == ({"without_this_element": lost} if lost else {})
    with pytest.raises(InputError, match=f"{COUNT} without this element"):
        read_trajectory(f"{path}:/pose{field.format(3)}")


def test_transforms_without_frames_are_read_by_their_number(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    messages = [
        TYPES["tf2_msgs/msg/TFMessage"](
            [transform(stamp, "", "", x=10.0 * body + row) for body in range(2)]
        )
        for row, stamp in enumerate(STAMPS)
    ]
    path = bag(tmp_path, "tf2_msgs/msg/TFMessage", messages)
    read = read_trajectory(f"{path}:/pose[1]")
    assert read.stamps.tolist() == STAMPS
    assert read.positions[:, 0].tolist() == [10.0 + row for row in range(COUNT)]
    assert main(["info", path]) == 0
    source = capsys.readouterr().out.partition("by their number: ")[2].split()[0]
    assert len(read_trajectory(source)) == COUNT


def test_a_pose_without_a_stamp_has_the_log_times(tmp_path: Path) -> None:
    path = bag(tmp_path, "geometry_msgs/msg/Pose", [pose(float(row)) for row in range(COUNT)])
    read = read_trajectory(f"{path}:/pose")
    expect(read, [SECOND * row + 5 for row in range(COUNT)], [float(row) for row in range(COUNT)])
    assert "log_times" in {remark.code for remark in read.reading.remarks}


def test_one_of_two_poses_must_be_named(tmp_path: Path) -> None:
    messages = [
        STORE.types["acme/msg/Pair"](header(stamp).stamp, pose(1.0), pose(2.0)) for stamp in STAMPS
    ]
    path = bag(tmp_path, "acme/msg/Pair", messages)
    with pytest.raises(InputError, match=r"choose one of .*:/pose\.left, .*:/pose\.right"):
        read_trajectory(f"{path}:/pose")
    expect(read_trajectory(f"{path}:/pose.right"), STAMPS, [2.0] * COUNT)


def test_numbers_of_32_bits_are_read(tmp_path: Path) -> None:
    types = STORE.types
    place = types["acme/msg/Place"](
        types["acme/msg/Vector"](1.0, 2.0, 3.0), types["acme/msg/Rotation"](0.0, 0.0, 0.5, 1.0)
    )
    messages = [types["acme/msg/Small"](header(stamp), place) for stamp in STAMPS]
    read = read_trajectory(f"{bag(tmp_path, 'acme/msg/Small', messages)}:/pose.place")
    expect(read, STAMPS, [1.0] * COUNT)


@pytest.mark.parametrize("order", ["wxyz", "xyzw"])
@pytest.mark.parametrize("kind", ["acme/msg/State", "acme/msg/States", "acme/msg/Mixed"])
def test_a_quaternion_in_an_array_has_the_stated_order(
    order: str, kind: str, tmp_path: Path
) -> None:
    quaternion = {"xyzw": [0.0, 0.0, 0.5, 1.0], "wxyz": [1.0, 0.0, 0.0, 0.5]}[order]
    types, messages = STORE.types, []
    for row, stamp in enumerate(STAMPS):
        place = np.array([row, 2.0, 3.0])
        state = types["acme/msg/State"](header(stamp, "rig"), place, np.array(quaternion))
        if kind == "acme/msg/States":
            state = types[kind]([state])
        elif kind == "acme/msg/Mixed":
            point = TYPES["geometry_msgs/msg/Point"](*place)
            state = types[kind](header(stamp, "rig"), point, np.array(quaternion, dtype="f4"))
        messages.append(state)
    field = ".all[0].q" if kind == "acme/msg/States" else ".q"
    read = read_trajectory(f"{bag(tmp_path, kind, messages)}:/pose{field}[{order}]")
    expect(read, STAMPS, [float(row) for row in range(COUNT)])
    assert read.frame == "rig"


@pytest.mark.parametrize("field", ["", ".q", ".q[yzwx]", ".q[0]", ".position[wxyz]"])
def test_an_unstated_order_is_refused_with_sources_that_work(field: str, tmp_path: Path) -> None:
    state = STORE.types["acme/msg/State"]
    messages = [state(header(stamp), np.arange(3.0), np.ones(4)) for stamp in STAMPS]
    path = bag(tmp_path, "acme/msg/State", messages)
    with pytest.raises(InputError, match="does not state the order") as refused:
        read_trajectory(f"{path}:/pose{field}")
    listed = str(refused.value).partition("choose one of ")[2].partition(";")[0].split(", ")
    assert [source.rpartition(":")[2] for source in listed] == ["/pose.q[wxyz]", "/pose.q[xyzw]"]
    assert [len(read_trajectory(source)) for source in listed] == [COUNT, COUNT]


def test_arrays_of_other_names_are_no_pose(tmp_path: Path) -> None:
    messages = [
        STORE.types["acme/msg/Gains"](np.zeros(3), np.ones(4), np.zeros(3)) for _ in STAMPS
    ]
    path = bag(tmp_path, "acme/msg/Gains", messages)
    with pytest.raises(InputError, match="has type acme/msg/Gains, not poses"):
        read_trajectory(f"{path}:/pose")


@pytest.mark.parametrize("field", [".x", "[0]", "[0][1]", ".pose[", "..", ".pose.position.x"])
def test_a_wrong_field_is_refused_with_the_right_one(field: str, tmp_path: Path) -> None:
    path = mcap_file(tmp_path / "run.mcap")
    with pytest.raises(InputError, match=r"give .*run\.mcap:/pose\.pose"):
        read_trajectory(f"{path}:/pose{field}")


def test_info_lists_the_poses_inside(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    messages = [STORE.types["acme/msg/Bodies"](header(stamp), 1, [pose()]) for stamp in STAMPS]
    path = bag(tmp_path, "acme/msg/Bodies", messages)
    assert main(["info", path]) == 0
    printed = capsys.readouterr().out
    assert ".bodies[0]" in printed
    source = printed.split("is a source, too: ")[1].split()[0]
    assert len(read_trajectory(source)) == COUNT


def test_a_field_of_a_type_of_poses_gives_the_same_numbers(tmp_path: Path) -> None:
    messages = [pose_stamped(stamp, float(row)) for row, stamp in enumerate(STAMPS)]
    path = bag(tmp_path, "geometry_msgs/msg/PoseStamped", messages)
    whole, part = read_trajectory(f"{path}:/pose"), read_trajectory(f"{path}:/pose.pose")
    np.testing.assert_array_equal(whole.positions, part.positions)
    np.testing.assert_array_equal(whole.stamps, part.stamps)


VECTOR: Fields = tuple((name, "f8") for name in "xyz")
POSE: Fields = (("position", VECTOR), ("orientation", (*VECTOR, ("w", "f8"))))
NAMES = st.sampled_from(["a", "b", "header", "pose", "stamp", "child_frame_id"])
ARRAYS: Fields = (("p", Repeated("f8", 3)), ("q", Repeated("f4", 4)))
KINDS = st.recursive(
    st.sampled_from(["f8", "u1", TEXT, POSE, ARRAYS]),
    lambda inner: st.one_of(
        st.dictionaries(NAMES, inner, min_size=1, max_size=3).map(lambda d: tuple(d.items())),
        inner.map(Repeated),
    ),
    max_leaves=8,
)


@given(st.dictionaries(NAMES, KINDS, min_size=1, max_size=3))
def test_every_listed_pose_is_found_by_its_name(kinds: dict[str, Any]) -> None:
    fields: Fields = tuple(kinds.items())
    for place in nested_poses(fields):
        assert chosen_pose(fields, place.field, "/topic") == place
