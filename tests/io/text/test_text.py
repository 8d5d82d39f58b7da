"""Text files of every layout become the same trajectory."""

from __future__ import annotations

import tempfile
from decimal import Decimal
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_bags import refusal
from scipy.spatial.transform import Rotation
from strategies import SAME_ROTATION_RAD

from trajeval_ros.exceptions import InputError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.io.text import lines as text_lines
from trajeval_ros.io.text import table as text_table
from trajeval_ros.io.text.hints import TextHints

STAMPS = [1403636580838555574, 1403636580843555212, 1403636580848555000]
POSITIONS = np.array([[1.0, 2.0, 3.0], [1.5, 2.0, -3.25], [2.0, 2.5, 3.125]])
ROTATIONS = Rotation.from_rotvec([[0.1, 0.2, 0.3], [0.4, -0.2, 0.1], [1.0, 0.0, 2.0]])
XYZW = ROTATIONS.as_quat()
WXYZ = XYZW[:, [3, 0, 1, 2]]
VELOCITIES = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [0.7, 0.8, 0.9]])
BIASES = np.arange(18.0).reshape(3, 6)


def seconds(stamp: int) -> str:
    return f"{Decimal(stamp).scaleb(-9):.9f}"


def table(*columns: np.ndarray, times: list[str], separator: str = " ", end: str = "\n") -> str:
    rows = np.hstack([column.reshape(3, -1) for column in columns])
    lines = [
        separator.join([time, *(repr(value) for value in row)])
        for time, row in zip(times, rows.tolist(), strict=True)
    ]
    return end.join(lines) + end


IN_SECONDS = [seconds(stamp) for stamp in STAMPS]
IN_NANOSECONDS = [str(stamp) for stamp in STAMPS]
EUROC_HEADER = (
    "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], "
    "q_RS_z []"
)

LAYOUTS = {
    "tum": table(POSITIONS, XYZW, times=IN_SECONDS),
    "tum with comments": "# timestamp tx ty tz qx qy qz qw\n% more\n\n"
    + table(POSITIONS, XYZW, times=IN_SECONDS),
    "tum with tabs and a mark": "\ufeff"
    + table(POSITIONS, XYZW, times=IN_SECONDS, separator="\t", end="\r\n"),
    "tum with commas": table(POSITIONS, XYZW, times=IN_SECONDS, separator=","),
    "tum in nanoseconds": table(POSITIONS, XYZW, times=IN_NANOSECONDS),
    "tum with header names": "t,tx,ty,tz,qx,qy,qz,qw\n"
    + table(POSITIONS, XYZW, times=IN_SECONDS, separator=","),
    "w first by header": "# t x y z qw qx qy qz\n" + table(POSITIONS, WXYZ, times=IN_SECONDS),
    "rpg with id": "# id timestamp tx ty tz qx qy qz qw\n"
    + "".join(
        f"{row} {line}\n"
        for row, line in enumerate(table(POSITIONS, XYZW, times=IN_SECONDS).splitlines())
    ),
    "id without header": "".join(
        f"{row} {line}\n"
        for row, line in enumerate(table(POSITIONS, XYZW, times=IN_SECONDS).splitlines())
    ),
    "euroc 8": EUROC_HEADER + "\n" + table(POSITIONS, WXYZ, times=IN_NANOSECONDS, separator=","),
    "euroc 17": table(POSITIONS, WXYZ, VELOCITIES, BIASES, times=IN_NANOSECONDS, separator=","),
    "vins-mono": table(
        POSITIONS, WXYZ, VELOCITIES, times=IN_NANOSECONDS, separator=",", end=",\n"
    ),
    "openvins state": "# timestamp(s) q p v bg ba cam_imu_dt num_cam\n"
    + table(XYZW, POSITIONS, VELOCITIES, BIASES, times=IN_SECONDS),
    "openvins groundtruth": "#time(ns),px,py,pz,qw,qx,qy,qz,vx,vy,vz,bwx,bwy,bwz,bax,bay,baz\n"
    + table(POSITIONS, WXYZ, VELOCITIES, BIASES, times=IN_NANOSECONDS, separator=","),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_same_poses(layout: str, tmp_path: Path) -> None:
    path = tmp_path / "whatever.bin"  # the ending must not matter
    path.write_text(LAYOUTS[layout], encoding="utf-8")
    trajectory = read_trajectory(str(path))
    assert trajectory.stamps.tolist() == STAMPS
    np.testing.assert_array_equal(trajectory.positions, POSITIONS)
    assert trajectory.rotations is not None
    assert (trajectory.rotations * ROTATIONS.inv()).magnitude().max() <= SAME_ROTATION_RAD
    assert any("nanoseconds" in note for note in trajectory.reading.messages(Level.NOTE)) == (
        IN_NANOSECONDS[0] in LAYOUTS[layout]
    )
    if repr(VELOCITIES[1, 1].item()) in LAYOUTS[layout] and trajectory.velocities is not None:
        np.testing.assert_array_equal(trajectory.velocities, VELOCITIES)
    if trajectory.gyroscope_biases is not None:
        np.testing.assert_array_equal(trajectory.gyroscope_biases, BIASES[:, :3])
        np.testing.assert_array_equal(trajectory.accelerometer_biases, BIASES[:, 3:])


@pytest.mark.parametrize("end", ["# end", " # end", "  ", "\t", "%", "# end\r", "\r\n# end\r\n"])
@pytest.mark.parametrize("layout", [*LAYOUTS, "dates"])
def test_what_follows_the_last_row_is_no_row(layout: str, end: str, tmp_path: Path) -> None:
    path = tmp_path / "t"
    dates = [f"2024-03-{day}T10:00:00.5" for day in range(10, 10 + len(POSITIONS))]
    dated = "date,x,y,z\n" + table(POSITIONS, times=dates, separator=",")
    path.write_bytes(LAYOUTS.get(layout, dated).encode() + end.encode())
    np.testing.assert_array_equal(read_trajectory(path).positions, POSITIONS)


@pytest.mark.parametrize("layout", ["euroc 17", "vins-mono", "openvins state"])
def test_velocities_are_read(layout: str, tmp_path: Path) -> None:
    path = tmp_path / "t"
    path.write_text(LAYOUTS[layout])
    np.testing.assert_array_equal(read_trajectory(str(path)).velocities, VELOCITIES)


def test_a_guessed_order_of_the_quaternion_is_said(tmp_path: Path) -> None:
    path = tmp_path / "t"
    path.write_text(LAYOUTS["vins-mono"])
    assert any(
        "assumed qw qx qy qz" in note
        for note in read_trajectory(str(path)).reading.messages(Level.NOTE)
    )


@pytest.mark.parametrize(
    ("first", "step", "order"),
    [
        (1_700_000_000_000_000_000, 50_000_000, "qw qx qy qz"),  # nanoseconds since 1970
        (6_000_000_000, 50_000_000, "qw qx qy qz"),  # nanoseconds since the start of a clock
        (1_700_000_000_000_000, 50_000, "qx qy qz qw"),  # microseconds
        (1_700_000_000, 1, "qx qy qz qw"),  # seconds
        (0, 1, "qx qy qz qw"),
    ],
)
def test_unit_of_time_decides_the_order_of_eight_columns_with_commas(
    first: int, step: int, order: str, tmp_path: Path
) -> None:
    path = tmp_path / "t.csv"
    path.write_text("".join(f"{first + step * row},{row},2,3,0.8,0,0,0.6\n" for row in range(9)))
    read = read_trajectory(path)
    assert read.quaternions is not None
    expected = [0.0, 0.0, 0.6, 0.8] if order.startswith("qw") else [0.8, 0.0, 0.0, 0.6]
    np.testing.assert_allclose(read.quaternions[0], expected)
    assert f"assumed {order}" in " ".join(read.reading.said(Level.WARNING))


def test_openvins_covariance_is_turned_into_the_world(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    factor = random.normal(size=(3, 2, 3, 3))
    local = factor @ np.swapaxes(factor, -1, -2)
    upper = np.triu_indices(3)
    triangles = local[:, :, upper[0], upper[1]]  # rotation first
    path = tmp_path / "t"
    path.write_text(table(POSITIONS, XYZW, triangles, times=IN_SECONDS))
    covariances = read_trajectory(str(path)).covariances
    assert covariances is not None
    matrices = ROTATIONS.as_matrix()
    expected = matrices @ local[:, 0] @ np.swapaxes(matrices, 1, 2)
    np.testing.assert_allclose(covariances[:, 3:, 3:], expected, rtol=1e-12)
    np.testing.assert_allclose(covariances[:, :3, :3], local[:, 1], rtol=1e-15)
    assert not covariances[:, :3, 3:].any()


def kitti_rows(leading: list[str] | None = None) -> str:
    matrices = np.concatenate([ROTATIONS.as_matrix(), POSITIONS[:, :, None]], axis=2)
    rows = [" ".join(map(repr, matrix.ravel().tolist())) for matrix in matrices]
    leading = leading or [""] * 3
    return "".join(f"{first} {row}\n".lstrip() for first, row in zip(leading, rows, strict=True))


@pytest.mark.parametrize("name", ["poses_times.txt", "times.txt"])
def test_kitti_takes_its_times_from_beside_it(name: str, tmp_path: Path) -> None:
    (tmp_path / "poses.txt").write_text(kitti_rows())
    (tmp_path / name).write_text("0.000000e+00\n1.037359e-01\n2.073381e-01\n")
    trajectory = read_trajectory(str(tmp_path / "poses.txt"))
    assert trajectory.stamps.tolist() == [0, 103735900, 207338100]
    assert trajectory.reading.stamped
    assert any(name in note for note in trajectory.reading.messages(Level.NOTE))
    assert trajectory.rotations is not None
    assert (trajectory.rotations * ROTATIONS.inv()).magnitude().max() <= SAME_ROTATION_RAD


@pytest.mark.parametrize("times", [None, "0\n1\n"])
def test_kitti_without_times_that_fit_counts_rows(times: str | None, tmp_path: Path) -> None:
    (tmp_path / "poses.txt").write_text(kitti_rows())
    if times:
        (tmp_path / "times.txt").write_text(times)
    trajectory = read_trajectory(str(tmp_path / "poses.txt"))
    assert trajectory.stamps.tolist() == [0, 10**9, 2 * 10**9]
    assert not trajectory.reading.stamped
    assert any("no timestamps" in note for note in trajectory.reading.messages(Level.NOTE))


def test_kitti_with_an_index_or_a_time(tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_text(kitti_rows(["0", "2", "5"]))
    indexed = read_trajectory(str(path))
    assert indexed.stamps.tolist() == [0, 2 * 10**9, 5 * 10**9]
    assert not indexed.reading.stamped
    (tmp_path / "times.txt").write_text("".join(f"{row}.5\n" for row in range(6)))
    assert read_trajectory(str(path)).stamps.tolist() == [5 * 10**8, 25 * 10**8, 55 * 10**8]
    path.write_text(kitti_rows(IN_SECONDS))
    timed = read_trajectory(str(path))
    assert timed.stamps.tolist() == STAMPS
    assert timed.reading.stamped


@pytest.mark.parametrize("columns", [(POSITIONS,), (POSITIONS, np.tile([0.0, 0, 0, 1], (3, 1)))])
def test_positions_alone_have_no_rotations(
    columns: tuple[np.ndarray, ...], tmp_path: Path
) -> None:
    path = tmp_path / "t"
    path.write_text(table(*columns, times=IN_SECONDS))
    trajectory = read_trajectory(str(path))
    assert trajectory.rotations is None
    notes = trajectory.reading.messages(Level.NOTE)
    assert any("rotation metrics withheld" in note for note in notes)


def test_a_placeholder_identity_is_no_reason_to_withhold(tmp_path: Path) -> None:
    path = tmp_path / "t"
    path.write_text(table(POSITIONS, np.vstack([[0, 0, 0, 1], XYZW[1:]]), times=IN_SECONDS))
    assert read_trajectory(str(path)).rotations is not None


def test_rows_that_are_no_poses_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "t"
    lines = table(POSITIONS, XYZW, times=IN_SECONDS).splitlines()
    lines += ["nan 1 2 3 0 0 0 1", "1403636581 nan 2 3 0 0 0 1", "1403636582 1 2 3 0 0 0 0"]
    path.write_text("\n".join(lines))
    trajectory = read_trajectory(str(path))
    assert len(trajectory) == 3
    assert trajectory.reading.dropped == {"not_finite": 2, "zero_quaternion": 1}


def test_long_quaternions_are_normalised_and_said(tmp_path: Path) -> None:
    path = tmp_path / "t"
    path.write_text(table(POSITIONS, 2.0 * XYZW, times=IN_SECONDS))
    trajectory = read_trajectory(str(path))
    assert trajectory.rotations is not None
    assert (trajectory.rotations * ROTATIONS.inv()).magnitude().max() <= SAME_ROTATION_RAD
    assert any("normalised" in note for note in trajectory.reading.messages(Level.NOTE))


def test_one_pose_can_be_read(tmp_path: Path) -> None:
    path = tmp_path / "t"
    path.write_text("1.5 1 2 3 0 0 0 1")
    assert len(read_trajectory(str(path))) == 1


@pytest.mark.slow
@given(count=st.integers(1, 3000), seed=st.integers(0, 1000), places=st.integers(3, 18))
def test_files_of_many_blocks_are_read_whole(
    count: int, seed: int, places: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    random = np.random.default_rng(seed)
    stamps = 1_700_000_000 * 10**9 + np.cumsum(random.integers(1, 10**7, count))
    numbers = random.normal(size=(count, 7))
    numbers[:, 3:] /= np.linalg.norm(numbers[:, 3:], axis=1, keepdims=True)
    path = tmp_path_factory.mktemp("blocks") / "t"
    lines = []
    for row, (stamp, values) in enumerate(zip(stamps.tolist(), numbers.tolist(), strict=True)):
        comment = "# in between\n" if row % 700 == 650 else ""
        lines.append(
            comment + " ".join([seconds(stamp), *(f"{value:.{places}f}" for value in values)])
        )
    path.write_text("\n".join(lines))
    with (
        mock.patch.object(text_lines, "_BUFFER", 4096),
        mock.patch.object(text_table, "_ROWS", 64),
    ):
        trajectory = read_trajectory(str(path))
    assert trajectory.stamps.tolist() == stamps.tolist()
    expected = [[float(f"{value:.{places}f}") for value in row[:3]] for row in numbers.tolist()]
    np.testing.assert_array_equal(trajectory.positions, np.array(expected))


def test_progress_reaches_the_end(tmp_path: Path) -> None:
    path = tmp_path / "t"
    path.write_text(LAYOUTS["tum"])
    seen: list[tuple[int, int]] = []
    read_trajectory(str(path), advance=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (path.stat().st_size, path.stat().st_size)


REAL = {
    "euroc/groundtruth/MH_01.txt": (36382, 80.626),
    "euroc/groundtruth/V1_02_asl.csv": (16702, 75.891),
    "euroc/openvins/MH_01_with_covariance.csv": (3369, 76.406),
    "euroc/vins_mono/MH_01.csv": (1749, 77.965),
    "euroc/V1_02_estimate.txt": (807, 77.499),
    "kitti/KITTI_00_gt.txt": (4541, 3724.187),
    "tum/fr2_desk_groundtruth.txt": (20957, 20.339),
}


@pytest.mark.parametrize("name", REAL)
def test_real_files(name: str, shared_data: Path) -> None:
    trajectory = read_trajectory(str(shared_data / name))
    count, length = REAL[name]
    assert len(trajectory) == count
    assert trajectory.path_length_m == pytest.approx(length, abs=1e-3)
    assert trajectory.rotations is not None


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in REAL if "kitti" not in name])
def test_real_stamps_and_numbers_are_those_of_python(name: str, shared_data: Path) -> None:
    lines = (shared_data / name).read_text().replace(",", " ").splitlines()
    rows = [line.split() for line in lines if line[:1].isdigit()]
    stamps = [Decimal(row[0]) * (1 if "." not in row[0] else 10**9) for row in rows]
    trajectory = read_trajectory(str(shared_data / name))
    assert trajectory.stamps.tolist() == [round(stamp) for stamp in stamps]
    expected = np.array([[float(value) for value in row[1:4]] for row in rows])
    np.testing.assert_array_equal(trajectory.positions, expected)


GOOD = LAYOUTS["tum"]
FIRST, SECOND, THIRD = GOOD.splitlines()
BAD_FILES: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "is empty"),
    "blank": (b"\n \n", "is empty"),
    "only comments": (b"# t x y z\n", "is text without a row of numbers"),
    "half a line": (GOOD.encode()[:-60], r"line 3: 8 columns expected, found \d"),
    "letters": (f"{FIRST}\n{SECOND}\n1 2 3 x4 5 6 7 8\n".encode(), "line 3, column 4: 'x4'"),
    "letters in the first row": (b"1 2 3 x4 5 6 7 8\n", "line 1, column 4: 'x4'"),
    "prose": (b"Dear reader,\nthis is no trajectory.\n", "is text without a row of numbers"),
    "all NaN": (b"1 nan 0 0 0 0 0 1\n2 nan 0 0 0 0 0 1\n", "no valid pose in 2 rows"),
    "all stamps NaN": (b"nan 1 0 0 0 0 0 1\nnan 1 0 0 0 0 0 1\n", "no valid pose in 2 rows"),
    "equal stamps": (f"{FIRST}\n{FIRST}\n".encode(), r"all timestamps \(2\) are equal"),
    "zero stamps": (b"0 1 2 3 0 0 0 1\n0 1 2 3 0 0 0 1\n", "all timestamps are zero"),
    "binary": (bytes(range(256)) * 4, "binary file"),
    "five columns": (b"1 2 3 4 5\n", "unknown layout with 5 columns"),
    "no matrix": (b"1 2 3 4 5 6 7 8 9 10 11 12\n", "unknown layout with 12 columns"),
    "a huge matrix": (b"1e200 -1e200 3 4 5 6 7 8 9 10 11 12\n", "unknown layout with 12 columns"),
    "zero bytes at the end": (f"{FIRST}\n{SECOND}\n".encode() + bytes(70000), "zero bytes"),
    "a long line of spaces": (
        b"a," + b" " * 60_000 + b"b\n1 2 3 4 5\n",
        "without a row of numbers|unknown layout with",
    ),
    "decimal commas and spaces": (
        b"1,2" + b" " * 60_000 + b"b\n",
        "is not a number",
    ),
    "one endless line": (b"1 " * 1_000_000, "unknown layout|is not a trajectory"),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_files_are_refused_with_one_sentence(case: str, tmp_path: Path) -> None:
    content, message = BAD_FILES[case]
    path = tmp_path / "bad.txt"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        read_trajectory(str(path))
    assert "bad.txt" in str(caught.value)
    assert "\n" not in str(caught.value)


@given(st.binary(max_size=300))
def test_any_bytes_are_read_or_refused(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "t"
        path.write_bytes(content)
        assert "\n" not in refusal(path)


@given(st.data())
def test_any_damage_is_read_or_refused(data: st.DataObject) -> None:
    content = bytearray(LAYOUTS[data.draw(st.sampled_from(sorted(LAYOUTS)))].encode())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(
            st.sampled_from(b" \n\t,.-+e0179#%\0xn\xff")
        )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "t"
        path.write_bytes(content)
        assert "\n" not in refusal(path)


def test_a_missing_file_has_a_neighbour(tmp_path: Path) -> None:
    (tmp_path / "groundtruth.txt").write_text(GOOD)
    with pytest.raises(InputError, match=r"does not exist; did you mean .*groundtruth\.txt\?"):
        read_trajectory(str(tmp_path / "groundtruht.txt"))
    with pytest.raises(InputError, match="nor does the folder"):
        read_trajectory(str(tmp_path / "nowhere" / "t.txt"))


def test_a_folder_that_may_not_be_read_is_not_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "exists", refuse)
    monkeypatch.setattr(Path, "iterdir", refuse)
    with pytest.raises(InputError, match="can't be read; check its permissions"):
        read_trajectory(str(tmp_path / "t.txt"))


@pytest.mark.parametrize("name", ["gzip", "bz2", "lzma", "backports.zstd"])
def test_a_compressed_file_is_read(tmp_path: Path, name: str) -> None:
    module = pytest.importorskip(name)
    # As the program zstd does; the others always have one.
    checksum = (
        {"options": {module.CompressionParameter.checksum_flag: 1}} if "zstd" in name else {}
    )
    (tmp_path / "t.txt").write_text(GOOD)
    (tmp_path / "t.txt.zst").write_bytes(module.compress(GOOD.encode(), **checksum))
    plain, packed = (read_trajectory(tmp_path / name) for name in ("t.txt", "t.txt.zst"))
    assert packed.stamps.tolist() == plain.stamps.tolist()
    np.testing.assert_array_equal(packed.positions, plain.positions)
    damaged = bytearray((tmp_path / "t.txt.zst").read_bytes())
    damaged[len(damaged) // 2] ^= 255
    (tmp_path / "t.txt.zst").write_bytes(damaged)
    with pytest.raises(InputError, match="damaged"):
        read_trajectory(tmp_path / "t.txt.zst")


@pytest.mark.parametrize(
    "content",
    [
        GOOD.encode("utf-16"),
        GOOD.replace("\n", "\r").encode(),
        GOOD.replace("\n", "\r\n").encode(),
    ],
    ids=["utf-16", "carriage returns", "both"],
)
def test_encodings_and_line_ends(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "t.txt").write_text(GOOD)
    (tmp_path / "u.txt").write_bytes(content)
    plain, other = (read_trajectory(tmp_path / name) for name in ("t.txt", "u.txt"))
    assert other.stamps.tolist() == plain.stamps.tolist()
    np.testing.assert_array_equal(other.positions, plain.positions)


def test_a_text_file_has_no_topics(tmp_path: Path) -> None:
    (tmp_path / "t.txt").write_text(GOOD)
    with pytest.raises(InputError, match="is not a bag"):
        read_trajectory(f"{tmp_path / 't.txt'}:/odom")


def test_a_path_may_hold_a_colon(tmp_path: Path) -> None:
    (tmp_path / "a:b.txt").write_text(GOOD)
    assert len(read_trajectory(str(tmp_path / "a:b.txt"))) == 3


def test_a_file_that_may_not_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "t.txt").write_text(GOOD)

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(InputError, match=r"t\.txt can't be read: permission denied"):
        read_trajectory(str(tmp_path / "t.txt"))


@pytest.mark.parametrize("first", [True, False])
def test_one_damaged_timestamp_does_not_change_the_unit(first: bool, tmp_path: Path) -> None:
    lines = [f"{1500000000 + row} {row} 0 0 0 0 0 1" for row in range(300)]
    lines[0 if first else 15] = "1500000015000000000 15 0 0 0 0 0 1"
    path = tmp_path / "x.txt"
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"most timestamps are near 1.5.*e\+09, and 1 of 300"):
        read_trajectory(path)


def test_timestamps_in_nanoseconds_with_one_small_one_stay_nanoseconds(tmp_path: Path) -> None:
    lines = [f"{1500000000 + row}000000000 {row} 0 0 0 0 0 1" for row in range(300)]
    lines[15] = "1500000015 15 0 0 0 0 0 1"
    path = tmp_path / "x.txt"
    path.write_text("\n".join(lines))
    read = read_trajectory(path)
    assert len(read) + sum(read.reading.dropped.values()) == 300
    assert len(read) >= 299


@pytest.mark.parametrize("date", ["9999-01-15T05:00:00.5", "2263-01-01T00:00:00", "1600-01-01"])
def test_dates_beyond_nanoseconds_are_refused(date: str, tmp_path: Path) -> None:
    rows = [f"2024-03-01T12:00:{row:02},{row},0,0,0,0,0,1" for row in range(30)]
    rows[7] = f"{date},7,0,0,0,0,0,1"
    path = tmp_path / "x.csv"
    path.write_text("\n".join(["time,x,y,z,qx,qy,qz,qw", *rows]))
    with pytest.raises(InputError, match="its dates leave the years 1678 to 2261"):
        read_trajectory(path)


def test_a_link_to_itself_suggests_another_file(tmp_path: Path) -> None:
    path = tmp_path / "run.txt"
    path.symlink_to(path)
    with pytest.raises(InputError, match="check the path"):
        read_trajectory(path)


def test_a_comma_at_the_end_of_a_header_names_no_column(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text("z,y,x,time,\n" + "".join(f"1,2,3,{row}\n" for row in range(5)))
    read = read_trajectory(path)
    assert read.positions[0].tolist() == [3.0, 2.0, 1.0]


@pytest.mark.parametrize("first", ["0,north,east,up", "0,1,2,", "words only", "0,1,2,up"])
def test_named_columns_begin_at_the_first_row_of_numbers(first: str, tmp_path: Path) -> None:
    """An empty field is a missing value, whose row is dropped."""
    path = tmp_path / "t"
    path.write_text("\n".join([first, *(f"{row},1,2,{row}" for row in range(1, 4))]))
    read = read_trajectory(path, hints=TextHints(("t", "x", "y", "z")))
    assert read.positions.tolist() == [[1.0, 2.0, float(row)] for row in range(1, 4)]
    assert sum(read.reading.dropped.values()) == (first == "0,1,2,")


@pytest.mark.parametrize("name", ["t.txt", "t.gz", "t.xz"])
def test_a_zero_byte_in_a_late_timestamp_is_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    rows = [f"{1_700_000_000 + row}.5 {row}.25 0 0 0 0 0 1\n" for row in range(3000)]
    path.write_text("".join(rows))
    assert len(read_trajectory(str(path))) == 3000
    rows[-1] = rows[-1].replace("1700002999.5", "17000029\x009.5")
    path.write_text("".join(rows))
    with pytest.raises(InputError, match=r"zero bytes|row 3000 has .* is not a time"):
        read_trajectory(str(path))


def test_a_table_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "t.txt"
    path.write_bytes(b"\xef\xbb\xbf" + LAYOUTS["tum"].encode())
    plain = tmp_path / "p.txt"
    plain.write_text(LAYOUTS["tum"])
    assert (
        read_trajectory(str(path)).stamps.tolist() == read_trajectory(str(plain)).stamps.tolist()
    )


@pytest.mark.parametrize("name", ["poses.txt", "run.mcap", "run.bag"])
def test_a_pointer_of_git_lfs_is_named(name: str, tmp_path: Path) -> None:
    pointer = tmp_path / name
    pointer.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0a\nsize 12\n")
    with pytest.raises(InputError, match=f"git lfs pull --include {name}"):
        read_trajectory(str(pointer))
