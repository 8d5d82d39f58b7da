"""Tables that other programs write: named columns, dates, angles, covariances, g2o, no stamps."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from strategies import SAME_ROTATION_RAD

from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError, SettingsError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.io.text.hints import SideHints, TextHints

STAMPS = [1403636580_838555574, 1403636580_843555212, 1403636580_848555000]
POSITIONS = np.array([[1.0, 2.0, 3.0], [1.5, 2.0, -3.25], [2.0, 2.5, 3.125]])
ROTATIONS = Rotation.from_rotvec([[0.1, 0.2, 0.3], [0.4, -0.2, 0.1], [1.0, 0.0, 2.0]])
VELOCITIES = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [0.7, 0.8, 0.9]])
_FACTORS = np.random.default_rng(3).normal(size=(3, 6, 6))
COVARIANCES = _FACTORS @ np.swapaxes(_FACTORS, 1, 2)
SECONDS = [f"{stamp // 10**9}.{stamp % 10**9:09d}" for stamp in STAMPS]
UPPER, LOWER = np.triu_indices(6), np.tril_indices(6)


def read(path: Path, text: str, **hints: object) -> Trajectory:
    path.write_text(text, encoding="utf-8")
    return read_trajectory(path, hints=TextHints(**hints))  # type: ignore[arg-type]


def rows(*columns: list[str] | np.ndarray, separator: str = ",") -> str:
    texts = []
    for column in columns:
        if isinstance(column, list):
            texts.append([[item] for item in column])
        else:
            texts.append([list(map(repr, row)) for row in column.reshape(3, -1).tolist()])
    lines = [[word for column in texts for word in column[row]] for row in range(3)]
    return "".join(separator.join(line) + "\n" for line in lines)


def is_the_pose(trajectory: Trajectory, stamps: list[int] | None = STAMPS) -> bool:
    assert trajectory.rotations is not None
    same = (trajectory.rotations * ROTATIONS.inv()).magnitude().max() <= 4.0 * SAME_ROTATION_RAD
    return bool(
        same
        and (trajectory.positions == POSITIONS).all()
        and (stamps is None or trajectory.stamps.tolist() == stamps)
    )


NANOSECONDS = list(map(str, STAMPS))
XYZW = ROTATIONS.as_quat()
WXYZ = XYZW[:, [3, 0, 1, 2]]
RPY = ROTATIONS.as_euler("ZYX")[:, ::-1]
NAMES = ["a cat", "", '"x, y"']
TABLES = {
    "text between": "time_ns,name,x,y,z,qx,qy,qz,qw\n" + rows(NANOSECONDS, NAMES, POSITIONS, XYZW),
    "semicolons": "timestamp;state;tx;ty;tz;qw;qx;qy;qz\n"
    + rows(SECONDS, NAMES, POSITIONS, WXYZ, separator=";"),
    "tabs": "timestamp\tstate\ttx\tty\ttz\tqw\tqx\tqy\tqz\n"
    + rows(SECONDS, NAMES, POSITIONS, WXYZ, separator="\t"),
    "units": "Time (s), X [m], Y [m], Z [m], Roll [deg], Pitch [deg], Yaw [deg]\n"
    + rows(SECONDS, POSITIONS, np.degrees(RPY)),
    "radians": "t,x,y,z,roll,pitch,yaw\n" + rows(SECONDS, POSITIONS, RPY),
    "degrees by name": "t,x,y,z,roll_deg,pitch_deg,yaw_deg\n"
    + rows(SECONDS, POSITIONS, np.degrees(RPY)),
    "messages": "/odom/header/stamp,/odom/pose/pose/position/x,/odom/pose/pose/position/y,"
    "/odom/pose/pose/position/z,/odom/pose/pose/orientation/x,/odom/pose/pose/orientation/y,"
    "/odom/pose/pose/orientation/z,/odom/pose/pose/orientation/w\n"
    + rows(SECONDS, POSITIONS, XYZW),
    "trajectopy": "#epsg 0\n#name Trajectory\n#nframe enu\n"
    "#fields t,l,px,py,pz,qx,qy,qz,qw,vx,vy,vz\n"
    + rows(SECONDS, ["0.0", "0.5", "6.9"], POSITIONS, XYZW, VELOCITIES),
    "an index before": "index,stamp,x,y,z,qx,qy,qz,qw\n"
    + rows(["0", "1", "2"], SECONDS, POSITIONS, XYZW),
    "trailing commas": "t,x,y,z,qx,qy,qz,qw,\n" + rows(SECONDS, POSITIONS, XYZW, [""] * 3),
}


@pytest.mark.parametrize("name", TABLES)
def test_columns_are_found_by_name(name: str, tmp_path: Path) -> None:
    assert is_the_pose(read(tmp_path / "t.csv", TABLES[name]))


@pytest.mark.parametrize(
    "text",
    [
        "1,5 0,5 -1,25 2,0\n2,5 0,5 -1,25 2,0\n",
    ],
)
def test_decimal_commas_are_named(text: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"line \d: numbers have decimal commas; write decimal p"):
        read(tmp_path / "t.csv", text)


def test_other_columns_are_not_taken_for_an_id_or_for_a_quaternion(tmp_path: Path) -> None:
    level = np.tile([0.0, 0.0, 0.6, 0.8], (3, 1))
    times = [f"{index}.25" for index in range(3)]
    status = rows(times, POSITIONS, level, ["0"] * 3)
    angles = rows(times, POSITIONS, RPY)
    for text in (status, angles):
        with pytest.raises(
            InputError, match=r"unknown layout with [79] columns, .* --columns 't x"
        ):
            read(tmp_path / "t.csv", text.replace(",", " "))
    with_id = read(tmp_path / "t.csv", rows(["7", "8", "9"], times, POSITIONS, XYZW))
    np.testing.assert_allclose(with_id.positions, POSITIONS)
    assert "the first of 9 columns is an id" in with_id.reading.messages(Level.NOTE)


def test_columns_that_are_not_used_are_said(tmp_path: Path) -> None:
    notes = read(tmp_path / "t.csv", TABLES["text between"]).reading.messages(Level.NOTE)
    assert "ignored columns: name" in notes
    trajectopy = read(tmp_path / "u.csv", TABLES["trajectopy"])
    notes = set(trajectopy.reading.messages(Level.NOTE))
    assert "ignored columns: l" in notes
    np.testing.assert_array_equal(trajectopy.velocities, VELOCITIES)


@pytest.mark.parametrize("separator", ["T", " "])
def test_calendar_dates_are_utc(separator: str, tmp_path: Path) -> None:
    seconds = np.array(STAMPS, dtype="datetime64[ns]").astype(str)
    dates = [second.replace("T", separator) for second in seconds]
    result = read(tmp_path / "t.csv", "date,x,y,z,qx,qy,qz,qw\n" + rows(dates, POSITIONS, XYZW))
    assert is_the_pose(result)
    assert "dates read as UTC" in result.reading.messages(Level.NOTE)


def test_angles_in_degrees_are_not_taken_for_radians(tmp_path: Path) -> None:
    text = "t,x,y,z,roll,pitch,yaw\n" + rows(SECONDS, POSITIONS, np.degrees(RPY))
    with pytest.raises(InputError, match="--columns 't x y z roll_deg pitch_deg yaw_deg'"):
        read(tmp_path / "t.csv", text)


def echo_header(kind: str) -> str:
    pose = "field.pose.pose" if kind == "odometry" else "field.pose"
    names = ["%time", "field.header.seq", "field.header.stamp", "field.header.frame_id"]
    names += ["field.child_frame_id"] if kind == "odometry" else []
    names += [f"{pose}.position.{axis}" for axis in "xyz"]
    names += [f"{pose}.orientation.{axis}" for axis in "xyzw"]
    if kind == "odometry":
        names += [f"field.pose.covariance{index}" for index in range(36)]
        names += [f"field.twist.twist.linear.{axis}" for axis in "xyz"]
        names += [f"field.twist.twist.angular.{axis}" for axis in "xyz"]
        names += [f"field.twist.covariance{index}" for index in range(36)]
    return ",".join(names) + "\n"


def test_rostopic_echo_of_poses(tmp_path: Path) -> None:
    arrival = [str(stamp + 70_000_000) for stamp in STAMPS]
    text = rows(arrival, ["1", "2", "3"], NANOSECONDS, ["", "map", "map"], POSITIONS, XYZW)
    assert is_the_pose(read(tmp_path / "t.csv", echo_header("pose") + text))


def test_rostopic_echo_of_odometry(tmp_path: Path) -> None:
    zeros = np.zeros((3, 3))
    text = rows(
        NANOSECONDS, ["1", "2", "3"], NANOSECONDS, ["odom"] * 3, ["base"] * 3, POSITIONS, XYZW,
        COVARIANCES, VELOCITIES, zeros, np.full((3, 36), 7.0),
    )  # fmt: skip
    result = read(tmp_path / "t.csv", echo_header("odometry") + text)
    assert is_the_pose(result)
    np.testing.assert_array_equal(result.covariances, COVARIANCES)
    np.testing.assert_allclose(result.velocities, ROTATIONS.apply(VELOCITIES), atol=1e-14)


def covariance_names(indices: tuple[np.ndarray, np.ndarray], first: int, name: str) -> str:
    return ",".join(
        f"{name}{row + first}{column + first}" for row, column in zip(*indices, strict=True)
    )


EVERY = (np.repeat(range(6), 6), np.tile(range(6), 6))


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("indices", [EVERY, UPPER, LOWER], ids=["36", "upper 21", "lower 21"])
def test_covariances_by_number(
    indices: tuple[np.ndarray, np.ndarray], first: int, tmp_path: Path
) -> None:
    header = "t,x,y,z,qx,qy,qz,qw," + covariance_names(indices, first, "cov_")
    values = COVARIANCES[:, indices[0], indices[1]]
    result = read(tmp_path / "t.csv", header + "\n" + rows(SECONDS, POSITIONS, XYZW, values))
    np.testing.assert_array_equal(result.covariances, COVARIANCES)


@pytest.mark.parametrize(
    "names", ["var_{}", "cov_{}_{}", "variance_{}"], ids=["var", "pairs", "variance"]
)
def test_six_variances(names: str, tmp_path: Path) -> None:
    axes = ("x", "y", "z", "roll", "pitch", "yaw")
    header = "t,x,y,z,qx,qy,qz,qw," + ",".join(names.format(axis, axis) for axis in axes)
    diagonal = COVARIANCES[:, range(6), range(6)]
    result = read(tmp_path / "t.csv", header + "\n" + rows(SECONDS, POSITIONS, XYZW, diagonal))
    np.testing.assert_array_equal(result.covariances, np.einsum("ni,ij->nij", diagonal, np.eye(6)))


def test_smfeval_has_covariances_of_body_twists(tmp_path: Path) -> None:
    text = rows(SECONDS, POSITIONS, XYZW, COVARIANCES[:, LOWER[0], LOWER[1]], separator=" ")
    result = read(tmp_path / "t.txt", text)
    assert is_the_pose(result)
    rotation = np.zeros((3, 6, 6))
    rotation[:, :3, :3] = rotation[:, 3:, 3:] = ROTATIONS.as_matrix()
    expected = rotation @ COVARIANCES @ np.swapaxes(rotation, 1, 2)
    np.testing.assert_allclose(result.covariances, expected, atol=1e-12)
    assert any("body twists" in note for note in result.reading.messages(Level.NOTE))
    head = "#%SQUARE 1\n#%TANGENT_CONVENTION {}\n"
    message = read(tmp_path / "u.txt", head.format("right_perturbation") + text)
    np.testing.assert_array_equal(message.covariances, result.covariances)
    assert not any("body twists" in note for note in message.reading.messages(Level.NOTE))
    other = read(tmp_path / "v.txt", head.format("left_perturbation") + text)
    assert other.covariances is None
    assert any("covariances dropped" in note for note in other.reading.messages(Level.NOTE))


def test_tartanair_has_a_rate_or_counts(tmp_path: Path) -> None:
    text = rows(POSITIONS, XYZW, separator=" ")
    counted = read(tmp_path / "pose_left.txt", text)
    assert is_the_pose(counted, [0, 10**9, 2 * 10**9])
    assert not counted.reading.stamped
    assert counted.up.name == "-z"
    assert any("--frame-rate" in note for note in counted.reading.messages(Level.NOTE))
    timed = read(tmp_path / "pose_left.txt", text, frame_rate_hz=30.0)
    assert is_the_pose(timed, [0, 33_333_333, 66_666_667])
    assert timed.reading.stamped


G2O = """# a graph
VERTEX_SE3:QUAT 3 1.0 2.0 3.0 {}
EDGE_SE3:QUAT 3 5 1 0 0 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1
VERTEX_SE3:QUAT 5 1.5 2.0 -3.25 {}
FIX 3
VERTEX_SE3:QUAT 9 2.0 2.5 3.125 {}
"""


def test_vertices_of_a_graph_are_read_and_edges_ignored(tmp_path: Path) -> None:
    text = G2O.format(*(" ".join(map(repr, row)) for row in XYZW.tolist()))
    result = read(tmp_path / "t.g2o", text)
    assert is_the_pose(result, [3 * 10**9, 5 * 10**9, 9 * 10**9])
    assert result.reading.frame_numbers is not None
    assert result.reading.frame_numbers.tolist() == [3, 5, 9]
    assert result.reading.numbered
    assert is_the_pose(
        read(tmp_path / "t.g2o", text, frame_rate_hz=10.0), [3 * 10**8, 5 * 10**8, 9 * 10**8]
    )
    with pytest.raises(InputError, match="line 4: 'x' is not a number"):
        read(tmp_path / "t.g2o", text.replace("1.5", "x"))


def test_vertices_in_a_plane(tmp_path: Path) -> None:
    text = "VERTEX_SE2 0 1.5 2.5 0.25\nVERTEX_SE2 1 2.5 2.5 -9.5\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"
    result = read(tmp_path / "t.g2o", text)
    np.testing.assert_array_equal(result.positions, [[1.5, 2.5, 0.0], [2.5, 2.5, 0.0]])
    assert result.rotations is not None
    expected = Rotation.from_rotvec([[0, 0, 0.25], [0, 0, -9.5]])
    assert (result.rotations * expected.inv()).magnitude().max() < 1e-14


NAMED = {
    "w first": ("t x y z qw qx qy qz", rows(SECONDS, POSITIONS, WXYZ, separator=" ")),
    "microseconds": (
        "t_us x y z qx qy qz qw",
        rows([f"{stamp // 1000}.{stamp % 1000:03d}" for stamp in STAMPS], POSITIONS, XYZW),
    ),
    "text to ignore": (
        "_ t_ns _ x y z qx qy qz qw",
        rows(["a b", "c", ""], NANOSECONDS, NAMES, POSITIONS, XYZW),
    ),
    "a header that says little": (
        "t x y z qx qy qz qw",
        "these are,the,columns,of,a,file,without,names\n" + rows(SECONDS, POSITIONS, XYZW),
    ),
    "degrees": ("t x y z roll_deg pitch_deg yaw_deg", rows(SECONDS, POSITIONS, np.degrees(RPY))),
    "twelve that are no matrix": (
        "t x y z qx qy qz qw vx vy vz _",
        rows(SECONDS, POSITIONS, XYZW, VELOCITIES, ["9", "9", "9"]),
    ),
}


@pytest.mark.parametrize("name", NAMED)
def test_columns_may_be_named_by_the_user(name: str, tmp_path: Path) -> None:
    columns, text = NAMED[name]
    assert is_the_pose(read(tmp_path / "t.txt", text, columns=tuple(columns.split())))


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ("t x y z qx qy qz w", "unknown column 'w'; did you mean"),
        ("t x y z qx qy qz x", "--columns has x twice"),
        ("t t_ns x y z", "--columns has t and t_ns"),
        ("t x z", "have no position"),
    ],
)
def test_names_that_are_none(columns: str, message: str) -> None:
    with pytest.raises(SettingsError, match=re.escape(message)):
        TextHints(tuple(columns.split()))


def test_a_file_with_other_columns_than_named(tmp_path: Path) -> None:
    columns = ("t", "x", "y", "z", *["_"] * 5)
    with pytest.raises(InputError, match=r"no row of 9 columns .* \(its first line has 8\)"):
        read(tmp_path / "t.txt", NAMED["w first"][1], columns=columns)
    first = read(tmp_path / "t.txt", NAMED["w first"][1], columns=columns[:4])  # the rest is _
    assert first.quaternions is None
    np.testing.assert_allclose(first.positions, POSITIONS)


@pytest.mark.parametrize(
    "text",
    [
        "timestamp;x;y;z\n1,5;0,5;-1,25;1,0e-3\n2,5;0,5;-1,25;1\n",
        "1,5\t0,5\t-1,25\t2,0\n2,5\t0,5\t-1,25\t2,0\n",
        "1,5 ; 0,5 ; -1,25 ; 2,0\n2,5 ; 0,5 ; -1,25 ; 2,0\n",
    ],
)
def test_decimal_commas_between_other_separators_are_read(text: str, tmp_path: Path) -> None:
    result = read(tmp_path / "t.csv", text)
    assert result.stamps.tolist() == [1_500_000_000, 2_500_000_000]
    np.testing.assert_array_equal(result.positions[:, :2], [[0.5, -1.25]] * 2)


def test_half_a_row_at_the_end_of_the_head_is_no_row(tmp_path: Path) -> None:
    row = "1500000000.123 1.5 0 0 0 0 0 1\n"
    # 65536 bytes are read first: the last of these rows ends after its third column.
    text = "#" * ((65536 - 20) % len(row) - 1) + "\n" + row * 3000
    assert len(text[:65536].rpartition("\n")[2].split()) == 3
    with pytest.raises(InputError, match=r"no row of 9 columns .* \(its first line has 8\)"):
        read(tmp_path / "t", text, columns=("t", "x", "y", *["_"] * 6))


def test_what_is_in_the_way_is_named(tmp_path: Path) -> None:
    text = "t,x,y,z,qx,qy,qz,qw\n" + rows(SECONDS, POSITIONS, XYZW) + "4,1,2,oops,0,0,0,1\n"
    with pytest.raises(InputError, match=r"line 5: 'oops' is .* in column 4 \(z\)"):
        read(tmp_path / "t.csv", text)
    with pytest.raises(
        InputError, match=r"column 2: 'here' is not a number; .* --columns 't _ x y"
    ):
        read(tmp_path / "u.csv", "1 here 2 3\n")
    with pytest.raises(InputError, match=r"unknown layout with 5 columns, .* --columns 't x y z"):
        read(tmp_path / "v.csv", "1 2 3 4 5\n")


def test_tables_of_ros2_topic_echo_have_two_columns_of_time(tmp_path: Path) -> None:
    parts = [[str(divmod(stamp, 10**9)[part]) for stamp in STAMPS] for part in (0, 1)]
    names = ("t_s", "nanosec", "_", "x", "y", "z", "qx", "qy", "qz", "qw")
    text = rows(*parts, NAMES, POSITIONS, XYZW)
    assert is_the_pose(read(tmp_path / "a.csv", text, columns=names))


def test_missing_values_are_rows_that_are_no_poses(tmp_path: Path) -> None:
    text = "t,x,y,z,qx,qy,qz,qw\n" + rows(SECONDS, POSITIONS, XYZW) + "1403636582,1,,2,0,0,0,1\n"
    result = read(tmp_path / "t.csv", text)
    assert is_the_pose(result)
    assert result.reading.dropped["not_finite"] == 1


DAMAGED = [
    *TABLES.values(),
    echo_header("pose") + rows(NANOSECONDS, NAMES, NANOSECONDS, NAMES, POSITIONS, XYZW),
    "date,x,y,z\n" + rows(["2024-03-01 12:00:00.5"] * 3, POSITIONS),
    G2O.format("0 0 0 1", "0 0 0 1", "0 0 0 1"),
    "#%TANGENT_CONVENTION x\n"
    + rows(SECONDS, POSITIONS, XYZW, COVARIANCES[:, LOWER[0], LOWER[1]], separator=" "),
    rows(POSITIONS, XYZW, separator=" "),
]


def refusal(path: Path, hints: TextHints) -> str:
    """Return why the path is refused, "" if it is read."""
    try:
        read_trajectory(path, hints=hints)
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.slow
@given(st.data())
@settings(max_examples=200)
def test_any_damage_is_read_or_refused(data: st.DataObject) -> None:
    content = bytearray(data.draw(st.sampled_from(DAMAGED)).encode())
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(content) - 1))
        content[place] = data.draw(st.sampled_from(b' \n\t,;.-+e0179#%\0xn"_:/\xff'))
    columns = data.draw(st.sampled_from(["", "t x y z qx qy qz qw", "_ t _ x y z"]))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "t"
        path.write_bytes(content)
        assert "\n" not in refusal(path, SideHints.of(columns or None, 10.0).estimate)


def test_info_has_no_duration_without_timestamps(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for names, rest in (("x,y,z", [POSITIONS]), ("t_ns,x,y,z", [NANOSECONDS, POSITIONS])):
        (tmp_path / "a.csv").write_text(f"{names}\n{rows(*rest)}")  # type: ignore[arg-type]
        main(["info", str(tmp_path / "a.csv")])
        printed = capsys.readouterr().out
        timed = "t_ns" in names
        assert all(
            (word in printed) == timed for word in ("\nrate ", "\nduration ", "\ngaps over ")
        )
        assert ("timestamps   none" in printed) != timed


def test_from_the_command_line(tmp_path: Path) -> None:
    source = tmp_path / "odd.csv"
    source.write_text(rows(NAMES, SECONDS, POSITIONS, WXYZ))
    columns = ["--columns", "_ t x y z qw qx qy qz"]
    saved = ["--save-as", "tum", "--output", str(tmp_path / "out")]
    assert main(["trajectory", str(source), *columns, *saved]) == 0
    assert is_the_pose(read_trajectory(tmp_path / "out" / "odd.txt"))
    truth = ["evaluate", "-g", str(tmp_path / "out" / "odd.txt"), "-e", str(source)]
    # Columns are the estimates'; the groundtruth is read by its content.
    done = main([*truth, *columns, "--gauge", "none", "--require", "ate.position_m.max < 1e-12"])
    assert done == 0
    poses = tmp_path / "pose_left.txt"
    poses.write_text(rows(POSITIONS, XYZW, separator=" "))
    assert main(["trajectory", str(poses), "--frame-rate", "10", *saved]) == 0
    assert is_the_pose(read_trajectory(tmp_path / "out" / "pose_left.txt"), [0, 10**8, 2 * 10**8])


@pytest.mark.parametrize("rate", ["0", "-1", "nan"])
def test_a_rate_is_above_zero(rate: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["trajectory", "x.txt", "--frame-rate", rate]) == 2
    assert "the frame rate must be greater than zero" in capsys.readouterr().err


def test_labels_of_motive_are_no_damaged_row(tmp_path: Path) -> None:
    """Exports of Motive 2 and 3 label their header in the second column, also identifiers."""
    body = "Rotation,Rotation,Rotation,Rotation,Position,Position,Position"
    header = [
        "Format Version,1.23,Take Name,Take 1",
        "",
        ",Type" + 7 * ",Rigid Body",
        ",Name" + 7 * ",drone",
        ",ID" + 7 * ",1",
        f",,{body}",
        "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z",
    ]
    rows = [f"{row},{row / 10},0,0,0.6,0.8,{row},2,3" for row in range(20)]
    path = tmp_path / "take.csv"
    path.write_text("\n".join([*header, *rows]) + "\n")
    result = read_trajectory(str(path))
    assert len(result) == 20
    np.testing.assert_array_equal(result.positions[5], [5.0, 2.0, 3.0])
    assert result.quaternions is not None
    np.testing.assert_allclose(result.quaternions[5], [0.0, 0.0, 0.6, 0.8])
    path.write_text("\n".join([*header, "x0,0,0,0,0.6,0.8,1,2,3", *rows]) + "\n")
    with pytest.raises(InputError, match="line 8: 'x0' is not a number"):
        read_trajectory(str(path))
