"""Layouts of files that tools and datasets write: read right, or refused with a command."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from paths import SHARED
from scipy.spatial.transform import Rotation

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.io.text.hints import NO_HINTS, SideHints, TextHints
from trajeval_ros.io.watched_sources import imu_of

COUNT = 60
RNG = np.random.default_rng(7)
PLACES = np.cumsum(RNG.normal(size=(COUNT, 3)), axis=0).round(6)
TURNS = Rotation.from_rotvec(np.cumsum(RNG.normal(scale=0.2, size=(COUNT, 3)), axis=0))
XYZW = TURNS.as_quat().round(9)
STAMPS = 1_700_000_000_250_000_000 + 50_000_000 * np.arange(COUNT)
MATRICES = np.tile(np.eye(4), (COUNT, 1, 1))
MATRICES[:, :3, :3] = TURNS.as_matrix().round(9)
MATRICES[:, :3, 3] = PLACES
INVERSE = np.linalg.inv(MATRICES)
ANGLES = TURNS.as_euler("ZYX")[:, ::-1].round(9)


def words(values: object) -> list[str]:
    return [str(value) for value in np.ravel(np.asarray(values)).tolist()]


def rows(*columns: object, separator: str = " ", header: str = "") -> str:
    tables = [np.asarray(column).reshape(COUNT, -1) for column in columns]
    lines = [separator.join(word for table in tables for word in words(table[row]))
             for row in range(COUNT)]  # fmt: skip
    return "\n".join([*([header] if header else []), *lines]) + "\n"


SECONDS = np.array([f"{stamp // 10**9}.{stamp % 10**9:09d}" for stamp in STAMPS.tolist()])
ZEROS = np.zeros((COUNT, 36))
WXYZ = XYZW[:, [3, 0, 1, 2]]
BOTTOM = np.tile([0, 0, 0, 1], (COUNT, 1))
HALF = np.hstack([STAMPS[:, None] // 10**9, STAMPS[:, None] % 10**9])
TIMES = 0.05 * np.arange(COUNT)
MOMENTS = (STAMPS // 1000).astype("M8[us]").astype(str)
DATES, CLOCKS = np.array([moment.split("T") for moment in MOMENTS.tolist()]).T
NAMES = np.full((COUNT, 1), "odom")
INVERSE_WXYZ = TURNS.inv().as_quat()[:, [3, 0, 1, 2]]
IMAGES = "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n" + "".join(
    f"{row + 1} {' '.join(words(INVERSE_WXYZ[row]))} "
    f"{' '.join(words(INVERSE[row, :3, 3]))} 1 {row:06d}.png\n\n"
    for row in range(COUNT)
)
MESSAGES = "---\n".join(
    f"header:\n  seq: {row}\n  stamp:\n    secs: {HALF[row, 0]}\n    nsecs: {HALF[row, 1]:9d}\n"
    "  frame_id: map\npose:\n  position:\n"
    + "".join(f"    {axis}: {value}\n" for axis, value in zip("xyz", PLACES[row], strict=True))
    + "  orientation:\n"
    + "".join(f"    {axis}: {value}\n" for axis, value in zip("xyzw", XYZW[row], strict=True))
    for row in range(COUNT)
)
RECORDS = "".join(
    json.dumps(
        {
            "timestamp": int(STAMPS[row] // 1000),
            "token": "a",
            "translation": PLACES[row].tolist(),
            "rotation": WXYZ[row].tolist(),
        }
    )
    + "\n"
    for row in range(COUNT)
)
ANGLES_ROWS = rows(PLACES, ANGLES).splitlines()
OLD_MOTIVE = "Format Version,1.2,Rotation Type,Quaternion,Length Units,Millimeters\n\n"
OLD_MOTIVE += "".join(f",,{','.join([body] * 7)}\n" for body in ("Rigid Body", "drone", "1"))
OLD_MOTIVE += f",,{','.join(['Rotation'] * 4 + ['Position'] * 3)}\nFrame,Time,X,Y,Z,W,X,Y,Z\n"
OLD_MOTIVE += rows(np.arange(COUNT), TIMES, XYZW, 1000.0 * PLACES, separator=",")


def entries(name: str, first: int, rows: int = 3, columns: int = 4) -> str:
    """Return the names of the entries of a matrix, row by row."""
    return ",".join(
        name.format(first + row, first + column)
        for row in range(rows)
        for column in range(columns)
    )


# Text, whether it has rotations, and whether it has times.
KINDS: dict[str, tuple[str, bool, bool]] = {
    "KITTI-360 cam0_to_world": (rows(np.arange(COUNT), MATRICES), True, False),
    "a time and 4 x 4": (rows(SECONDS, MATRICES), True, True),
    "16 columns": (rows(MATRICES), True, False),
    "blocks of 4 x 4": (
        "".join(f"{' '.join(words(row))}\n" for row in MATRICES.reshape(-1, 4)),
        True,
        False,
    ),
    "Open3D log": (
        "".join(
            f"{row} {row} {row + 1}\n"
            + "".join(f"{' '.join(words(line))}\n" for line in MATRICES[row])
            for row in range(COUNT)
        ),
        True,
        False,
    ),
    "time named nsec": (
        rows(STAMPS, PLACES, XYZW, separator=",", header="nsec,x,y,z,qx,qy,qz,qw"),
        True,
        True,
    ),
    "x y height": (
        rows(SECONDS, PLACES, XYZW, separator=",", header="time,x,y,height,qx,qy,qz,qw"),
        True,
        True,
    ),
    "phi theta psi": (rows(SECONDS, PLACES, ANGLES, header="t x y z phi theta psi"), True, True),
    "seconds and nanoseconds": (
        rows(HALF, PLACES, XYZW, header="secs nsecs x y z qx qy qz qw"),
        True,
        True,
    ),
    "microseconds": (rows(STAMPS // 1000, PLACES, XYZW), True, True),
    "milliseconds": (rows(STAMPS // 10**6, PLACES, XYZW), True, True),
    "ros2 echo of PoseStamped": (rows(HALF, NAMES, PLACES, XYZW, separator=","), True, True),
    "ros2 echo of Odometry": (
        rows(HALF, NAMES, NAMES, PLACES, XYZW, ZEROS, ZEROS[:, :6], ZEROS, separator=","),
        True,
        True,
    ),
    "rostopic echo": (MESSAGES, True, True),
    "Aria": (
        rows(
            STAMPS // 1000,
            PLACES,
            XYZW,
            separator=",",
            header="tracking_timestamp_us,"
            + ",".join(
                f"{name}_world_device" for name in ["tx", "ty", "tz", "qx", "qy", "qz", "qw"]
            ),
        ),
        True,
        True,
    ),
    "quoted": (
        rows(
            [f'"{stamp}"' for stamp in SECONDS],
            PLACES,
            XYZW,
            separator=",",
            header='"t","x","y","z","qx","qy","qz","qw"',
        ),
        True,
        True,
    ),
    "OpenVINS q p v": (
        rows(SECONDS, XYZW, PLACES, ZEROS[:, :3], header="# timestamp(s) q p v"),
        True,
        True,
    ),
    "micro-JSON lines": (RECORDS, True, True),
    "day and clock": (
        rows(
            ["14/11/2023 22:13:" + f"{20.25 + 0.05 * row:09.6f}" for row in range(COUNT)],
            PLACES,
            separator=",",
            header="Time,X,Y,Z",
        ),
        False,
        True,
    ),
    "COLMAP": (IMAGES, True, False),
    "GPST of RTKLIB": (
        rows(
            DATES,
            CLOCKS,
            PLACES,
            ZEROS[:, :1] + 9,
            separator="  ",
            header="%  GPST  e-baseline(m)  n-baseline(m)  u-baseline(m)  ns",
        ),
        False,
        True,
    ),
    "a date and a time with commas": (
        rows(DATES, CLOCKS, PLACES, separator=",", header="date,time,x,y,z"),
        False,
        True,
    ),
    "a zone of whole hours": (
        rows(np.char.add(MOMENTS, "+00"), PLACES, separator=",", header="time,x,y,z"),
        False,
        True,
    ),
    "seconds and nanoseconds without a header": (rows(HALF, PLACES, XYZW), True, True),
    "a time of something": (
        rows(TIMES, SECONDS, PLACES, separator=",", header="compute_time,timestamp,x,y,z"),
        False,
        True,
    ),
    "a position of something": (
        rows(
            SECONDS,
            PLACES + 1,
            PLACES,
            separator=",",
            header="time,target_x,target_y,target_z,x,y,z",
        ),
        False,
        True,
    ),
    "words after the names": (
        rows(SECONDS, PLACES, WXYZ, header="# timestamp_s tx ty tz qw qx qy qz. in the frame"),
        True,
        True,
    ),
    "a word before the names": (
        rows(SECONDS, PLACES, WXYZ, header="# format: timestamp x y z qw qx qy qz"),
        True,
        True,
    ),
    "COLMAP without its comment": (IMAGES.partition("\n")[2], True, False),
    "TORO": (
        "".join(f"VERTEX3 {row} {line}\n" for row, line in enumerate(ANGLES_ROWS)),
        True,
        False,
    ),
    "a matrix from 00 to 23": (
        rows(SECONDS, MATRICES[:, :3], separator=",", header="time," + entries("m{}{}", 0)),
        True,
        True,
    ),
    "a matrix from 11 to 44": (
        rows(SECONDS, MATRICES, separator=",", header="time," + entries("T_{}{}", 1, rows=4)),
        True,
        True,
    ),
    "a position and a rotation matrix": (
        rows(
            SECONDS,
            PLACES,
            MATRICES[:, :3, :3],
            separator=",",
            header="time,x,y,z," + entries("r{}{}", 1, columns=3),
        ),
        True,
        True,
    ),
    "an old export of Motive": (OLD_MOTIVE, True, False),
    "positions of two quantities": (
        rows(
            SECONDS,
            PLACES + 1,
            PLACES,
            header="time mag_pos_x mag_pos_y mag_pos_z p_x p_y p_z",
        ),
        False,
        True,
    ),
    "commas, seconds": (rows(SECONDS, PLACES, XYZW, separator=","), True, True),
    "commas, nanoseconds": (rows(STAMPS, PLACES, WXYZ, separator=","), True, True),
}


def assert_right(outcome: Trajectory, *, rotations: bool = True, times: bool = True) -> None:
    np.testing.assert_allclose(outcome.positions, PLACES, rtol=0, atol=1e-6)
    if rotations:
        assert outcome.quaternions is not None
        between = Rotation.from_quat(outcome.quaternions).inv() * TURNS
        assert between.magnitude().max() < 1e-6
    if times:
        assert outcome.reading.stamped
        assert outcome.stamps.tolist() == STAMPS.tolist()


@pytest.mark.parametrize("kind", KINDS)
def test_a_public_kind_is_read(kind: str, tmp_path: Path) -> None:
    text, rotations, times = KINDS[kind]
    path = tmp_path / "t.txt"
    path.write_text(text)
    result = read_trajectory(path)
    assert_right(result, rotations=rotations, times=times)
    doubts = [remark for remark in result.reading.remarks if remark.level is Level.WARNING]
    assert bool(doubts) == kind.startswith("commas")


def test_a_folder_of_poses(tmp_path: Path) -> None:
    folder = tmp_path / "poses"
    folder.mkdir()
    for row, matrix in enumerate(MATRICES):
        (folder / f"frame-{row:06d}.pose.txt").write_text(rows_of(matrix))
    assert_right(read_trajectory(folder), times=False)


def rows_of(matrix: np.ndarray) -> str:
    return "".join(f"{' '.join(words(row))}\n" for row in matrix)


UNPADDED = np.array([f"{stamp // 10**9}.{stamp % 10**9}" for stamp in (STAMPS - 200_000_000)])
REFUSED: dict[str, tuple[str, int]] = {  # text, and which of the suggested options is right
    "unpadded nanoseconds": (rows(UNPADDED, PLACES, XYZW), 0),
    "eleven columns with commas": (rows(SECONDS, PLACES, XYZW, ZEROS[:, :3], separator=","), 0),
    "eleven columns, w first": (rows(SECONDS, PLACES, WXYZ, ZEROS[:, :3], separator=","), 1),
    "nine columns": (rows(SECONDS, PLACES, XYZW, ZEROS[:, :1] + 0.5), 0),
    "the last column is a time": (
        rows(PLACES, XYZW, SECONDS, header="x y z qx qy qz qw lidar_seconds"),
        0,
    ),
    "a frame number and another time": (
        rows(np.arange(COUNT), SECONDS, PLACES, XYZW, header="frame image x y z qx qy qz qw"),
        0,
    ),
    "a position of a magnetometer": (
        rows(SECONDS, PLACES, XYZW, header="t mag_pos_x mag_pos_y mag_pos_z qx qy qz qw"), 0,
    ),
    "PX4": (
        rows(SECONDS, PLACES, WXYZ, separator=",",
             header="timestamp," + entries("position[{1}]", 0, 1, 3) + ","
                    + entries("q[{1}]", 0, 1)),
        1,
    ),
    "a matrix without names": (
        rows(SECONDS, MATRICES[:, :3], header="t " + " ".join(f"p{at}" for at in range(12))), 0,
    ),
    "a position and a rotation matrix": (rows(SECONDS, PLACES, MATRICES[:, :3, :3]), 0),
    "a number and angles": (rows(np.arange(COUNT), SECONDS, PLACES, ANGLES), 0),
    "unknown names": (rows(SECONDS, PLACES, XYZW, header="a1 a2 a3 a4 a5 a6 a7 a8"), 0),
    "a quaternion without names": (
        rows(SECONDS, PLACES, WXYZ, header="time x y z rot1 rot2 rot3 rot4"), 1,
    ),
    "a height without a name": (
        rows(SECONDS, PLACES, XYZW, header="time x y vert qx qy qz qw"), 0,
    ),
    "two bodies": (
        rows(SECONDS, PLACES, ZEROS[:, :3], XYZW, header="time x y z x y z qx qy qz qw"), 0,
    ),
    "two positions": (
        rows(SECONDS, PLACES, PLACES + 1, XYZW, separator=",",
             header="time,a_position_x,a_position_y,a_position_z,b_position_x,b_position_y,"
                    "b_position_z,qx,qy,qz,qw"),
        0,
    ),
    "more names than columns": (
        rows(SECONDS, PLACES, XYZW, header="# timestamp id x y z qx qy qz qw"), 0,
    ),
    "millimetres without a name of the rotation": (
        rows(SECONDS, 1e3 * PLACES, WXYZ, separator=",",
             header="time,x [mm],y [mm],z [mm],a0,a1,a2,a3"),
        1,
    ),
    "degrees without a unit": (
        rows(SECONDS, PLACES, np.degrees(ANGLES), header="time x y z roll pitch yaw"), 0,
    ),
    "angles without a header": (rows(SECONDS, PLACES, ANGLES), 0),
    "dates without a header": (rows(DATES, CLOCKS, PLACES, XYZW), 0),
    "one word of date and time": (rows(MOMENTS, PLACES, XYZW), 0),
    "a word in a column": (rows(SECONDS, NAMES, PLACES, XYZW), 0),
    "microseconds from the start of a clock": (
        rows(10**13 + 50_000 * np.arange(COUNT), PLACES, XYZW), 0,
    ),
    "keys of GTSAM": (rows((97 << 56) + np.arange(COUNT), PLACES, XYZW), 0),
    "words for times": (
        rows(np.char.add("day", np.arange(COUNT).astype(str)), PLACES, XYZW,
             header="time x y z qx qy qz qw"), 0,
    ),
    "Qualisys": (
        "NO_OF_FRAMES\t60\nFrame\tTime\tX\tY\tZ\tRoll\tPitch\tYaw\tResidual\n"
        + rows(np.arange(COUNT), SECONDS, 1e3 * PLACES, np.degrees(ANGLES), ZEROS[:, :1],
               separator="\t"), 0,
    ),
}  # fmt: skip
OTHER_TIMES = {  # their timestamps are no times since 1970
    "unpadded nanoseconds", "microseconds from the start of a clock", "keys of GTSAM",
    "words for times",
}  # fmt: skip


@pytest.mark.parametrize("side", [NO_HINTS, SideHints.of(None, None).groundtruth])
@pytest.mark.parametrize("kind", REFUSED)
def test_the_option_that_a_refusal_suggests_works(
    kind: str, side: TextHints, tmp_path: Path
) -> None:
    text, right = REFUSED[kind]
    path = tmp_path / "t.txt"
    path.write_text(text)
    with pytest.raises(InputError) as refusal:
        read_trajectory(path, hints=side)
    options = re.findall(r"--columns '([^']*)'", str(refusal.value))
    assert all(option.startswith("groundtruth: ") == bool(side.side) for option in options)
    hints = SideHints.of(options[right], None)
    result = read_trajectory(path, hints=hints.groundtruth if side.side else hints.estimate)
    if kind == "Qualisys":
        assert "with the columns ['Frame', 'Time', 'X', 'Y', 'Z'," in str(refusal.value)
    if kind == "unpadded nanoseconds":
        assert result.stamps.tolist() == (STAMPS - 200_000_000).tolist()
    assert_right(result, times=kind not in OTHER_TIMES)


@pytest.mark.parametrize(
    ("text", "has_times"),
    [
        (rows(PLACES), False),
        (rows(SECONDS, PLACES, ZEROS[:, :1] + 0.3), True),
        (rows(SECONDS, PLACES, separator=",", header="when,where"), True),
        (rows(SECONDS, PLACES, header="time vel_x vel_y vel_z"), True),  # if these are positions
    ],
)
def test_the_option_for_a_few_columns_works(text: str, has_times: bool, tmp_path: Path) -> None:
    path = tmp_path / "t.txt"
    path.write_text(text)
    with pytest.raises(InputError) as refusal:
        read_trajectory(path)
    [option] = re.findall(r"--columns '([^']*)'", str(refusal.value))
    read = read_trajectory(path, hints=SideHints.of(option, None).estimate)
    assert_right(read, rotations=False, times=has_times)


NOON = 1_718_971_198_760_000_000 + 50_000_000 * np.arange(COUNT)  # from 11:59:58.76
EARLY = NOON % (86_400 * 10**9) - 43_140 * 10**9  # from 00:00:58.76
BOOT = 123_456_789 + 50_000 * np.arange(COUNT)


def digits(stamps: np.ndarray) -> list[str]:
    """Return nanoseconds as yyyymmddhhmmss.sss."""
    return [re.sub("[-T:]", "", word) for word in (stamps // 10**6).astype("M8[ms]").astype(str)]


@pytest.mark.parametrize(
    ("times", "expected"),
    [
        ([word[8:] for word in digits(NOON)], NOON % (86_400 * 10**9)),
        ([word[8:].lstrip("0") for word in digits(EARLY)], EARLY),
        (digits(NOON), NOON),
        (BOOT, 1000 * BOOT),
        (BOOT - BOOT[0], 1000 * (BOOT - BOOT[0])),
    ],
    ids=["hhmmss", "mmss", "yyyymmddhhmmss", "microseconds", "microseconds from zero"],
)
def test_numbers_that_are_no_seconds_are_refused(
    times: list[str], expected: np.ndarray, tmp_path: Path
) -> None:
    path = tmp_path / "t.txt"
    path.write_text(rows(times, PLACES, XYZW))
    with pytest.raises(InputError) as refusal:
        read_trajectory(path)
    option = re.findall(r"--columns '([^']*)'", str(refusal.value))[0]
    read = read_trajectory(path, hints=SideHints.of(option, None).estimate)
    assert_right(read, times=False)
    assert read.stamps.tolist() == expected.tolist()


@pytest.mark.parametrize("first", [735_774.79375, 45_000.79375])
def test_days_are_no_seconds(first: float, tmp_path: Path) -> None:
    path = tmp_path / "t.txt"
    path.write_text(rows([f"{first + time / 86_400.0:.12f}" for time in TIMES], PLACES, XYZW))
    with pytest.raises(InputError, match=r"steps of 6e-07, too short for seconds, as those of da"):
        read_trajectory(path)


@pytest.mark.parametrize(
    ("above", "comment", "is_refused"),
    [
        ("", "# t x y z qw qx qy qz", True),
        ("# t x y z qx qy qz qw", "# t x y z qw qx qy qz", True),
        ("", "# x y z t", True),
        ("", "# timestamp tx ty tz qx qy qz qw", False),
        ("# t x y z qx qy qz qw", "# lost at this time, at x 3 and y 4", False),
        ("# t x y z qx qy qz qw", f"#{SECONDS[30]} 1 2 3 0 0 0 1", False),
    ],
)
def test_comments_between_rows(above: str, comment: str, is_refused: bool, tmp_path: Path) -> None:
    """They can name the columns of the following rows, or be a row that was removed."""
    path = tmp_path / "t.txt"
    lines = rows(SECONDS, PLACES, XYZW, header=above).splitlines()
    path.write_text("\n".join([*lines[:30], comment, *lines[30:]]))
    if is_refused:
        with pytest.raises(
            InputError, match=r"line 31: a comment names other columns .* tail -n "
        ):
            read_trajectory(path)
    else:
        assert_right(read_trajectory(path))


@pytest.mark.parametrize("unit", ["10ns", "min", "h", "days"])
def test_a_time_in_another_unit_is_refused(unit: str, tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    header = f"time [{unit}],x,y,z,qx,qy,qz,qw"
    path.write_text(rows(TIMES, PLACES, XYZW, separator=",", header=header))
    with pytest.raises(
        InputError, match=rf"unit of 'time \[{unit}\]', .*, is unknown; convert it"
    ):
        read_trajectory(path)


def test_rows_are_not_paired_by_number_while_an_unnamed_column_may_be_the_time(
    tmp_path: Path,
) -> None:
    path = tmp_path / "t.txt"
    path.write_text(rows(PLACES, ZEROS[:, :1], SECONDS))
    with pytest.raises(InputError, match="column 5 has no name and may be the time") as refusal:
        read_trajectory(path, hints=SideHints.of("x y z", None).estimate)
    as_time, ignored = re.findall(r"--columns '([^']*)'", str(refusal.value))
    read = read_trajectory(path, hints=SideHints.of(as_time, None).estimate)
    assert_right(read, rotations=False)
    assert not read_trajectory(path, hints=SideHints.of(ignored, None).estimate).reading.stamped
    path.write_text(rows(PLACES, ZEROS[:, :1], np.arange(COUNT)))  # counts rows
    assert_right(
        read_trajectory(path, hints=SideHints.of("x y z", None).estimate),
        rotations=False, times=False,
    )  # fmt: skip


def test_velocities_are_no_positions(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text(rows(SECONDS, PLACES, separator=",", header="time,vel_x,vel_y,vel_z"))
    with pytest.raises(InputError, match=r"no column has a name of a position .* first row is"):
        read_trajectory(path)


def test_columns_of_both_sides(tmp_path: Path) -> None:
    both = SideHints.of(["groundtruth: t_us x y z", "t x y z"], 10.0)
    assert both.groundtruth.columns == ("t_us", "x", "y", "z")
    assert both.estimate.columns == ("t", "x", "y", "z")
    path = tmp_path / "t.txt"
    path.write_text(rows(STAMPS // 1000, 1000.0 * PLACES, ZEROS[:, :2]))
    result = read_trajectory(path, hints=SideHints.of("t_us x_mm y_mm z_mm", None).estimate)
    assert_right(result, rotations=False)  # the last two columns need no _


def test_receptions_are_exact_to_the_nanosecond(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    header = "t,x,y,z,received"
    path.write_text(rows(STAMPS, PLACES, STAMPS + 1_234_567, separator=",", header=header))
    receive_times = read_trajectory(path).reading.receive_times
    assert receive_times is not None
    assert receive_times.times.tolist() == (STAMPS + 1_234_567).tolist()


@pytest.mark.parametrize("unit", [1, 10**9])
def test_a_table_of_an_imu(tmp_path: Path, unit: int) -> None:
    path = tmp_path / "data.csv"
    times = STAMPS if unit == 1 else SECONDS
    header = "#timestamp [ns],w_RS_S_x [rad s^-1],w_y,w_z,a_RS_S_x [m s^-2],a_y,a_z"
    path.write_text(rows(times, PLACES, ANGLES, separator=",", header=header))
    readings = imu_of(str(path))
    assert readings.stamps.tolist() == STAMPS.tolist()
    np.testing.assert_array_equal(readings.rates, PLACES)
    np.testing.assert_array_equal(readings.accelerations, ANGLES)  # type: ignore[arg-type]
    path.write_text(rows(times, PLACES, separator=","))
    with pytest.raises(InputError, match="use the columns t wx wy wz ax ay az"):
        imu_of(str(path))


NPY = b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': "  # a header of 118 bytes


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("many digits", b'{"time": 1, "x": ' + b"9" * 400 + b', "y": 0, "z": 0}\n'),
        ("deep", b'{"a":' * 2000 + b"1" + b"}" * 2000),
        ("far time", b'{"time": 1e30, "x": 1, "y": 0, "z": 0}\n' * 2),
        ("shape", NPY + b"False, 'shape': (1000000000000, 8), }".ljust(79) + b"\n"),
        ("header", NPY + b"(((False, ".ljust(79) + b"\n"),
    ],
)
def test_hostile_numbers_are_refused_before_they_are_allocated(
    name: str, content: bytes, tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError, match=re.escape(name)):
        read_trajectory(path)


def test_a_graph_of_two_kinds_of_poses_is_refused_with_a_command(tmp_path: Path) -> None:
    path = tmp_path / "t.g2o"
    graph = "VERTEX_XY 9 1 2\nVERTEX_SE2 0 1 2 0.5\n" + "".join(
        f"VERTEX_SE3:QUAT {row} {' '.join(words([*PLACES[row], *XYZW[row]]))}\n"
        for row in range(COUNT)
    )
    path.write_text(graph)
    with pytest.raises(InputError, match="line 3: VERTEX_SE3:QUAT after VERTEX_SE2") as refusal:
        read_trajectory(path)
    command = str(refusal.value).partition("type: ")[2]
    subprocess.run(["bash", "-c", command], cwd=tmp_path, check=True)
    assert_right(read_trajectory(tmp_path / "one.g2o"), times=False)


FIELD = SHARED / "data" / "field_cases" / "text"


FILES = [path.relative_to(FIELD) for path in sorted(FIELD.rglob("*")) if path.is_file()]
REFUSED_CASES = ("05_header_of_velocities", "08_unpadded_nanoseconds", "11_frames_from_1")


@pytest.mark.parametrize(
    "name",
    [path for path in FILES if path.name != "times.txt" and "23_" not in str(path)],
    ids=str,
)
def test_a_field_case_is_read_or_refused_with_one_sentence(name: Path) -> None:
    if name.parent.name in REFUSED_CASES and name.stem == "est":
        with pytest.raises(InputError, match="--columns '") as refusal:
            read_trajectory(FIELD / name)
        assert "\n" not in str(refusal.value)
    else:
        assert len(read_trajectory(FIELD / name)) > 10


@pytest.mark.parametrize(
    ("columns", "up"),
    [
        ((MATRICES[:, :3],), "-y"),  # KITTI's first camera
        ((np.arange(COUNT), MATRICES[:, :3]), "z"),  # KITTI-360, whose world is level
        ((np.arange(COUNT), MATRICES), "z"),
        ((SECONDS, MATRICES[:, :3]), "z"),  # MulRan's UTM
    ],
)
def test_the_up_axis_of_matrices(columns: tuple[np.ndarray, ...], up: str, tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_text(rows(*columns))
    assert read_trajectory(path).up.name == up


SCIENTIFIC = [f"{value:.17e}" for value in PLACES[:, 0]]


@pytest.mark.parametrize(
    "text",
    [
        rows(SECONDS, PLACES, XYZW),
        rows([f"{stamp / 1e9:.{1 + stamp // 10**8 % 3}f}" for stamp in STAMPS], PLACES, XYZW),
        rows(STAMPS, SCIENTIFIC, PLACES[:, 1:], WXYZ, separator=",", header="t,x,y,z,qw,qx,qy,qz"),
        rows(SECONDS, PLACES, NAMES, XYZW, separator=", ", header="t, x, y, z, n, qx, qy, qz, qw"),
        rows(SECONDS, PLACES, XYZW).replace(" ", "  ", 3),
        rows(SECONDS, PLACES, XYZW) + "# end\n",
        rows(SECONDS, PLACES, XYZW) + f"{SECONDS[-1]} nan - 3 0 0 0 1\n",
    ],
    ids=["TUM", "widths", "scientific", "names", "spaces", "comment", "missing"],
)
def test_large_files_have_the_same_bits(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    path = tmp_path / "t.txt"
    path.write_text(text)
    plain = read_trajectory(path)
    monkeypatch.setattr("trajeval_ros.io.text.table._LARGE", 0)
    large = read_trajectory(path)
    assert large.reading.dropped == plain.reading.dropped
    assert large.stamps.tobytes() == plain.stamps.tobytes()
    assert large.positions.tobytes() == plain.positions.tobytes()
    if text.startswith(SECONDS[0]) and text.count("\n") == COUNT and "  " not in text:
        monkeypatch.delattr(np, "loadtxt")  # pyarrow reads it
        assert len(read_trajectory(path)) == COUNT
    assert large.known_quaternions.tobytes() == plain.known_quaternions.tobytes()


def test_lists_of_echoed_messages_are_read(tmp_path: Path) -> None:
    """`rostopic echo` prints covariances as a list."""
    covariance = np.diag([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    echo = MESSAGES.replace("pose:\n", f"covariance: [{', '.join(words(covariance))}]\npose:\n")
    path = tmp_path / "t.txt"
    path.write_text(echo)
    covariances = read_trajectory(path).covariances
    assert covariances is not None
    np.testing.assert_allclose(covariances, np.tile(covariance, (COUNT, 1, 1)))


def test_a_header_can_be_repeated(tmp_path: Path) -> None:
    """As after two files were joined."""
    path = tmp_path / "t.csv"
    header = "time,x,y,z,qx,qy,qz,qw"
    lines = rows(SECONDS, PLACES, XYZW, separator=",", header=header).splitlines()
    path.write_text("\n".join([*lines[:30], header, *lines[30:]]))
    assert_right(read_trajectory(path))


def test_whole_seconds_beside_a_file_of_times_are_seconds(tmp_path: Path) -> None:
    """Only layouts whose first column can count frames take their times from the file."""
    (tmp_path / "times.txt").write_text("".join(f"{second}\n" for second in SECONDS))
    path = tmp_path / "t.txt"
    path.write_text(rows(np.arange(COUNT), PLACES))
    assert read_trajectory(path).stamps.tolist() == (10**9 * np.arange(COUNT)).tolist()


@pytest.mark.parametrize("time", ["stamp)", "t (s)", "time [s]"])
def test_brackets_in_names(time: str, tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    header = f"{time},x,y,z,qx,qy,qz,qw"
    path.write_text(rows(SECONDS, PLACES, XYZW, separator=",", header=header))
    assert_right(read_trajectory(path))


def test_covariances_named_by_axes(tmp_path: Path) -> None:
    axes = ("x", "y", "z", "roll", "pitch", "yaw")
    pairs = [(first, second) for first in range(6) for second in range(first, 6)]
    names = [f"cov_{axes[first]}_{axes[second]}" for first, second in pairs]
    values = np.arange(1.0, 22.0)
    path = tmp_path / "t.csv"
    header = ",".join(["time,x,y,z,qx,qy,qz,qw", *names])
    path.write_text(
        rows(SECONDS, PLACES, XYZW, np.tile(values, (COUNT, 1)), separator=",", header=header)
    )
    covariances = read_trajectory(path).covariances
    assert covariances is not None
    for (first, second), value in zip(pairs, values.tolist(), strict=True):
        assert covariances[0, first, second] == covariances[0, second, first] == value


def test_time_differences_are_no_times(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    differences = RNG.normal(0.05, 1e-3, COUNT).round(6)
    path.write_text(rows(differences, PLACES, separator=",", header="delta_time,x,y,z"))
    read = read_trajectory(path)
    np.testing.assert_array_equal(read.positions, PLACES)
    assert not read.reading.stamped
    assert any("ignored columns: delta_time" in remark.text for remark in read.reading.remarks)
