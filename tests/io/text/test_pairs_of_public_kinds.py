"""Pairs in layouts that tools and datasets write: the ATE is that of numpy, in one command."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from paths import SHARED
from scipy.spatial.transform import Rotation

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.io.text.hints import SideHints
from trajeval_ros.metrics.association_rule import AssociationRule
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.pipeline.pipeline import evaluate

Array = NDArray[Any]
COUNT = 80
TIMES = 0.1 * np.arange(COUNT)
STAMPS = 1_700_000_000_250_000_000 + 100_000_000 * np.arange(COUNT)
SECONDS = [f"{stamp // 10**9}.{stamp % 10**9:09d}" for stamp in STAMPS.tolist()]
PLACES = np.column_stack([8 * np.sin(TIMES), 6 * np.cos(0.7 * TIMES), np.sin(2 * TIMES)]).round(6)
TURNS = Rotation.from_rotvec(np.column_stack([0.1 * np.sin(TIMES), 0.2 * TIMES, 0.5 * TIMES]))
XYZW = TURNS.as_quat().round(9)
ANGLES = TURNS.as_euler("ZYX")[:, ::-1].round(9)
RNG = np.random.default_rng(11)
MOVED = Rotation.from_rotvec([0.2, -0.3, 1.1])
ESTIMATE = (MOVED.apply(PLACES + RNG.normal(scale=0.1, size=(COUNT, 3))) + [4, 5, 6]).round(6)
ESTIMATE_XYZW = (MOVED * TURNS).as_quat().round(9)


def rows(*columns: Any, separator: str = " ", header: str = "") -> str:
    tables = [np.asarray(column).reshape(COUNT, -1) for column in columns]
    lines = [separator.join(str(word) for table in tables for word in table[row].tolist())
             for row in range(COUNT)]  # fmt: skip
    return "\n".join([*([header] if header else []), *lines]) + "\n"


def matrices(places: Array, xyzw: Array) -> Array:
    poses = np.tile(np.eye(4), (COUNT, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = Rotation.from_quat(xyzw).as_matrix().round(9), places
    return poses


def numpy_ate(truth: Array, estimate: Array) -> float:
    """Return the RMSE after the rigid alignment of Kabsch."""
    one, two = truth - truth.mean(axis=0), estimate - estimate.mean(axis=0)
    left, _, right = np.linalg.svd(one.T @ two)
    sign = np.diag([1.0, 1.0, np.linalg.det(left @ right)])
    return float(np.sqrt(((one - two @ (left @ sign @ right).T) ** 2).sum(axis=1).mean()))


def ate_of(groundtruth: Path, estimate: Path, *columns: str, offset_s: float = 0.0) -> float:
    hints = SideHints.of(list(columns), None)
    sides = (read_trajectory(groundtruth, hints=hints.groundtruth),
             read_trajectory(estimate, hints=hints.estimate))  # fmt: skip
    method = "nearest" if all(side.reading.stamped for side in sides) else "auto"
    rule = AssociationRule(method, 0.02, time_offset_s=offset_s)
    evaluation = evaluate(*sides, Protocol(gauge="se3", lengths=(), association=rule))
    position = evaluation.ate["position_m"]
    assert position is not None
    return float(position.rmse)


LATITUDE = np.radians(47.3)
CURVED = 1.0 - 0.00669437999014 * np.sin(LATITUDE) ** 2  # WGS 84
NORMAL_M = 6_378_137.0 / np.sqrt(CURVED)
MERIDIAN_M = NORMAL_M * (1.0 - 0.00669437999014) / CURVED
LEVEL = np.column_stack(
    [
        47.3 + np.degrees(PLACES[:, 1] / (MERIDIAN_M + 400.0)),
        8.5 + np.degrees(PLACES[:, 0] / (NORMAL_M + 400.0) / np.cos(LATITUDE)),
        400.0 + PLACES[:, 2],
    ]
)
CLOCKS = np.array([f"2023/11/14 22:13:{20.25 + time:06.3f}" for time in TIMES])
HALF = np.column_stack([STAMPS // 10**9, STAMPS % 10**9])
LOST = np.full((COUNT, 7), "-nan(ind)", dtype=object)
LOST[3:] = np.hstack([ESTIMATE, ESTIMATE_XYZW])[3:]
UNTRACKED = np.full((COUNT, 6), "nan", dtype=object)
UNTRACKED[3:] = np.hstack([PLACES, ANGLES])[3:]
TUM = rows(SECONDS, PLACES, XYZW)
TUM_ESTIMATE = rows(SECONDS, ESTIMATE, ESTIMATE_XYZW)
KITTI = rows(matrices(PLACES, XYZW)[:, :3])
G2O = "".join(
    f"VERTEX_SE3:QUAT {row + 1} {' '.join(map(str, [*ESTIMATE[row], *ESTIMATE_XYZW[row]]))}\n"
    for row in range(COUNT)
)
G2O_OF_GROUNDTRUTH = "".join(
    f"VERTEX_SE3:QUAT {row + 1} {' '.join(map(str, [*PLACES[row], *XYZW[row]]))}\n"
    for row in range(COUNT)
)
CAMERA_FROM_WORLD = Rotation.from_quat(ESTIMATE_XYZW).inv()
IMAGES = np.hstack(
    [CAMERA_FROM_WORLD.as_quat()[:, [3, 0, 1, 2]], -CAMERA_FROM_WORLD.apply(ESTIMATE)]
)
COLMAP = "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n" + "".join(
    f"{row + 7} {' '.join(map(str, IMAGES[row].tolist()))} 1 frame_{row + 1:05d}.png\n1.0 2.0 -1\n"
    for row in range(COUNT)
)
MESSAGES = "---\n".join(
    f"header: \n  seq: {row}\n  stamp: \n    secs: {HALF[row, 0]}\n    nsecs: {HALF[row, 1]}\n"
    '  frame_id: "map"\npose: \n  position: \n'
    + "".join(f"    {axis}: {value}\n" for axis, value in zip("xyz", ESTIMATE[row], strict=True))
    + "  orientation: \n"
    + "".join(f"    {axis}: {value}\n" for axis, value in zip("xyzw", XYZW[row], strict=True))
    for row in range(COUNT)
)
NERF = json.dumps(
    {
        "camera_model": "OPENCV",
        "frames": [
            {"file_path": f"f{row}.png", "transform_matrix": pose.tolist()}
            for row, pose in enumerate(matrices(ESTIMATE, ESTIMATE_XYZW))
        ],
    },
    indent=1,
)
FIX_HEADER = (
    "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.status.status,"
    "field.latitude,field.longitude,field.altitude"
)
BOREAS = "GPSTime,easting,northing,altitude,vel_east,vel_north,vel_up,roll,pitch,heading"
RTKLIB = (
    "% program   : RTKPOST ver.2.4.3\n"
    "%  UTC  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)"
)
ZEROS = np.zeros((COUNT, 36))
ECHO = [[name] * COUNT for name in ("odom", "base_link")]
# Groundtruth, estimate, --columns, and the first row that has a pose on both sides.
PAIRS: dict[str, tuple[str, str, tuple[str, ...], int]] = {
    "NCLT with lost rows": (
        rows(STAMPS // 1000, UNTRACKED, separator=", "),
        TUM_ESTIMATE,
        ("groundtruth: t_us x y z roll pitch yaw",),
        3,
    ),
    "NCLT without options": (
        rows(STAMPS // 1000, UNTRACKED, separator=", "), TUM_ESTIMATE, (), 3,
    ),
    "ros2 topic echo --csv of Odometry": (
        TUM,
        rows(HALF, *ECHO, ESTIMATE, XYZW, ZEROS, ZEROS[:, :6], ZEROS, separator=","),
        (),
        0,
    ),
    "rostopic echo": (TUM, MESSAGES, (), 0),
    "rostopic echo -p of NavSatFix": (
        rows(
            STAMPS + 3_000_000, np.arange(COUNT), STAMPS, ["gps"] * COUNT, [2] * COUNT, LEVEL,
            separator=",", header=FIX_HEADER,
        ),
        TUM_ESTIMATE, (), 0,
    ),
    "RTKLIB": (
        rows(CLOCKS, LEVEL, ZEROS[:, :1] + 1, ZEROS[:, :1] + 12, ZEROS[:, :3] + 0.01,
             separator="  ", header=RTKLIB),
        TUM_ESTIMATE, (), 0,
    ),
    "rows of -nan(ind)": (TUM, rows(SECONDS, LOST), (), 3),
    "Boreas": (
        rows(STAMPS // 1000, PLACES, ZEROS[:, :3], ANGLES, separator=",", header=BOREAS),
        TUM_ESTIMATE, (), 0,
    ),
    "g2o from 1": (KITTI, G2O, ("frame1 x y z qx qy qz qw",), 0),
    "transforms.json of NeRF": (KITTI, NERF, (), 0),
}  # fmt: skip


@pytest.mark.parametrize("kind", PAIRS)
def test_the_ate_of_a_pair_is_that_of_numpy(kind: str, tmp_path: Path) -> None:
    groundtruth, estimate, columns, first = PAIRS[kind]
    paths = tmp_path / "gt.txt", tmp_path / "est.txt"
    for path, text in zip(paths, (groundtruth, estimate), strict=True):
        path.write_text(text)
    expected = numpy_ate(PLACES[first:], ESTIMATE[first:])
    assert ate_of(*paths, *columns) == pytest.approx(expected, rel=1e-4)


def test_a_folder_of_poses_pairs_with_another(tmp_path: Path) -> None:
    for name, poses in (
        ("gt", matrices(PLACES, XYZW)),
        ("est", matrices(ESTIMATE, ESTIMATE_XYZW)),
    ):
        folder = tmp_path / name
        folder.mkdir()
        for row, pose in enumerate(poses):
            np.savetxt(folder / f"frame-{row:06d}.pose.txt", pose)
    ate = ate_of(tmp_path / "gt", tmp_path / "est")
    assert ate == pytest.approx(numpy_ate(PLACES, ESTIMATE), rel=1e-6)


def test_repeated_frames_take_the_times_next_to_them(tmp_path: Path) -> None:
    """Submaps of VGGT-SLAM repeat the frame where they meet."""
    kept = sorted([*range(0, COUNT, 3), *range(0, COUNT, 12)])
    lines = rows(10.0**-8 * np.round(1e8 * np.arange(COUNT)), ESTIMATE, XYZW).splitlines()
    (tmp_path / "poses.txt").write_text("\n".join(lines[row] for row in kept))
    (tmp_path / "times.txt").write_text("\n".join(SECONDS))
    (tmp_path / "gt.txt").write_text(TUM)
    expected = numpy_ate(PLACES[::3], ESTIMATE[::3])
    assert ate_of(tmp_path / "gt.txt", tmp_path / "poses.txt") == pytest.approx(expected, rel=1e-6)


UNPADDED = [f"{stamp // 10**9}.{stamp % 10**9}" for stamp in (STAMPS - 200_000_000).tolist()]
GPS_S = (1_700_000_000 - 315_964_800 + 18) % 604_800


def option_of(message: str) -> tuple[tuple[str, ...], float]:
    """Return the columns and the time offset that a message suggests."""
    columns = re.findall(r"--columns '([^']*)'", message)[:1]
    offset = re.search(r"set the time offset to (\S+) s", message)
    return tuple(columns), float(offset[1]) if offset else 0.0


@pytest.mark.parametrize(
    ("name", "groundtruth", "estimate"),
    [
        (
            "unpadded nanoseconds",
            rows([f"{second:.9f}" for second in (STAMPS - 200_000_000) / 1e9], PLACES, XYZW),
            rows(UNPADDED, ESTIMATE, XYZW),
        ),
        ("GPS seconds of the week", rows(GPS_S + 0.25 + TIMES, PLACES, XYZW), TUM_ESTIMATE),
        ("from zero", rows(TIMES, PLACES, XYZW), TUM_ESTIMATE),
        ("estimate from zero", TUM, rows(TIMES, ESTIMATE, XYZW)),
        ("g2o from 1", KITTI, G2O),
        ("groundtruth from 1", G2O_OF_GROUNDTRUTH, rows(matrices(ESTIMATE, ESTIMATE_XYZW)[:, :3])),
        ("COLMAP from 1", KITTI, COLMAP),
    ],
)
def test_a_refused_pair_is_right_with_what_the_message_suggests(
    name: str, groundtruth: str, estimate: str, tmp_path: Path
) -> None:
    paths = tmp_path / "gt.txt", tmp_path / "est.txt"
    for path, text in zip(paths, (groundtruth, estimate), strict=True):
        path.write_text(text)
    with pytest.raises(InputError) as refusal:
        ate_of(*paths)
    columns, offset_s = option_of(str(refusal.value))
    assert columns or offset_s, name
    ate = ate_of(*paths, *columns, offset_s=offset_s)
    assert ate == pytest.approx(numpy_ate(PLACES, ESTIMATE), rel=1e-5)


FIELD = SHARED / "data" / "field_cases" / "text"
# Rounded nanoseconds drop digits of the first; the metres per degree of the fixes are 0.2 % wrong.
TOLERANCES = {"08": 0.06, "15": 0.02, "19": 0.02}
# Files of the groundtruth and the estimate.
CASES: dict[str, tuple[str, str]] = {
    "08_unpadded_nanoseconds": ("gt.txt", "08_unpadded_nanoseconds/est.txt"),
    "11b_g2o_from_1": ("11b_g2o_from_1/gt.txt", "11b_g2o_from_1/est.g2o"),
    "12_columns_of_groundtruth": ("12_columns_of_groundtruth/gt.csv", "est.txt"),
    "13_ros2_echo_csv": ("13_ros2_echo_csv/gt.csv", "13_ros2_echo_csv/est.csv"),
    "14_rostopic_echo": ("gt.txt", "14_rostopic_echo/est.txt"),
    "15_navsatfix_echo_p": ("15_navsatfix_echo_p/gt.csv", "est.txt"),
    "19_rtklib_pos": ("19_rtklib_pos/gt.pos", "est.txt"),
    "25_gps_seconds_of_week": ("25_gps_seconds_of_week/gt.txt", "est.txt"),
    "26_from_zero": ("26_from_zero/gt.txt", "est.txt"),
    "34_nan_ind": ("gt.txt", "34_nan_ind/est.txt"),
    "35_boreas": ("35_boreas/gt.csv", "est.txt"),
    "37_transforms_json": ("gt5.txt", "37_transforms_json/transforms.json"),
}


@pytest.mark.skipif(not FIELD.is_dir(), reason="../shared is absent")
@pytest.mark.parametrize("case", CASES)
def test_the_right_number_of_a_field_case_is_at_most_one_command_away(case: str) -> None:
    paths = FIELD / CASES[case][0], FIELD / CASES[case][1]
    truth, estimate = (np.loadtxt(FIELD / name)[:, 1:4] for name in ("gt.txt", "est.txt"))
    try:
        ate = ate_of(*paths)
    except InputError as error:
        columns, offset_s = option_of(str(error))
        ate = ate_of(*paths, *columns, offset_s=offset_s)
    expected = numpy_ate(truth[::2], estimate)
    assert ate == pytest.approx(expected, rel=TOLERANCES.get(case[:2], 0.01))
