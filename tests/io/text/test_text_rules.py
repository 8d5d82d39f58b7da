"""Rules that choose a layout, a unit or a time of text files, at their limits."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from refusals import is_refused
from scipy.spatial.transform import Rotation

from trajeval_ros.exceptions import InputError
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.io.text import head, reader
from trajeval_ros.io.text.layouts import (
    BODY_TWISTS,
    FAST_LIO,
    FIXED_AXES,
    GROUPS,
    Layout,
    by_count,
)
from trajeval_ros.io.text.number_tables import array_table
from trajeval_ros.io.text.reader import array_trajectory
from trajeval_ros.io.text.stamps import ExactNumbers, billionths, to_nanoseconds
from trajeval_ros.io.text.states import states_of
from trajeval_ros.io.text.tokens import WordError, characters_of, tokenize

Array = NDArray[Any]
SECOND = 10**9


def groups_of(names: str, rows: Any) -> tuple[Layout, dict[str, Array]]:
    layout = Layout("named", tuple(names.split()))
    columns = np.array(rows, dtype=float)
    return layout, {name: columns[:, list(at)] for name, at in layout.groups.items()}


def test_twists_of_the_body_are_turned() -> None:
    rng = np.random.default_rng(0)
    turns = Rotation.random(5, random_state=1)
    rows = np.hstack([rng.normal(size=(5, 3)), turns.as_quat(), rng.normal(size=(5, 6))])
    names = "x y z qx qy qz qw body_vx body_vy body_vz"
    layout, groups = groups_of(f"{names} vx vy vz", rows)
    both = states_of(Path("x"), layout, groups, 5)
    np.testing.assert_array_equal(both.velocities, rows[:, 10:])  # type: ignore[arg-type]
    layout, groups = groups_of(names, rows[:, :10])
    found = states_of(Path("x"), layout, groups, 5)
    assert found.velocities is not None
    np.testing.assert_allclose(found.velocities, turns.apply(rows[:, 7:10]), rtol=1e-13)
    rows[2, 3:7] = 0.0  # turns nothing
    layout, groups = groups_of(names, rows[:, :10])
    found = states_of(Path("x"), layout, groups, 5)
    assert found.velocities is not None
    np.testing.assert_array_equal(found.velocities[2], rows[2, 7:10])
    layout, groups = groups_of("x y z body_vx body_vy body_vz", rows[:, [0, 1, 2, 7, 8, 9]])
    assert states_of(Path("x"), layout, groups, 5).velocities is None


TURN = 2.0 * math.pi


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("angle", "refused"), [(TURN + 0.0099, False), (TURN + 0.0101, True), (360.0, True)]
)
def test_angles_are_in_radians_up_to_a_turn(sign: float, angle: float, *, refused: bool) -> None:
    layout, groups = groups_of("x y z roll pitch yaw", [[0, 0, 0, 0, 0, 0]] * 2)
    groups["angles"][1, 1] = sign * angle
    assert is_refused(states_of, Path("x"), layout, groups, 2) == refused
    if refused:
        with pytest.raises(InputError, match=r"x, row 2: pitch is .* name the column pitch_deg"):
            states_of(Path("x"), layout, groups, 2)
    layout, groups = groups_of("x y yaw_deg", [[0, 0, math.degrees(sign * angle)]])
    found = states_of(Path("x"), layout, groups, 1)
    assert found.quaternions is not None
    between = Rotation.from_quat(found.quaternions[0]).inv() * Rotation.from_rotvec(
        [0.0, 0.0, sign * angle]
    )
    assert between.magnitude() < 1e-12
    np.testing.assert_array_equal(found.positions, [[0.0, 0.0, 0.0]])
    assert [each.code for each in found.remarks] == ["no_height"]


@given(st.lists(st.floats(-3, 3), min_size=3, max_size=3))
def test_angles_are_about_z_then_y_then_x(angles: list[float]) -> None:
    layout, groups = groups_of("x y z roll pitch yaw", [[0, 0, 0, *angles]])
    found = states_of(Path("x"), layout, groups, 1)
    about = [np.array(axis) * angle for axis, angle in zip(np.eye(3), angles, strict=True)]
    x, y, z = map(Rotation.from_rotvec, about)
    assert found.quaternions is not None
    assert (Rotation.from_quat(found.quaternions[0]).inv() * z * y * x).magnitude() < 1e-14


@pytest.mark.parametrize(("angle", "is_kept"), [(0.99e9, True), (1.01e9, False)])
def test_sums_of_angles_without_digits_are_no_rotations(angle: float, *, is_kept: bool) -> None:
    layout = Layout("g2o", ("x", "y", "yaw"))
    groups = {"planar": np.zeros((1, 2)), "heading": np.array([[angle]])}
    found = states_of(Path("x"), layout, groups, 1).quaternions
    assert found is not None
    assert np.isfinite(found).all() == is_kept


@pytest.mark.parametrize(
    ("length", "refused"), [(math.pi + 0.99e-3, False), (math.pi + 1.01e-3, True)]
)
def test_rotation_vectors_of_fast_lio_are_up_to_pi(length: float, *, refused: bool) -> None:
    vector = length * np.array([[2.0, -3.0, 6.0]]) / 7.0
    groups = {"position": np.zeros((1, 3)), "rotation_vector": vector}
    layout = Layout(FAST_LIO, ("rx", "ry", "rz", "x", "y", "z"))
    assert is_refused(states_of, Path("x"), layout, groups, 1) == refused
    named = Layout("named", layout.columns)
    found = states_of(Path("x"), named, groups, 1).quaternions
    assert found is not None
    between = Rotation.from_quat(found[0]).inv() * Rotation.from_rotvec(vector[0])
    assert between.magnitude() < 1e-14


@pytest.mark.parametrize(
    "group", ["covariance", "covariance_upper", "covariance_lower", "variances"]
)
@pytest.mark.parametrize("convention", [FIXED_AXES, BODY_TWISTS])
def test_covariances_are_symmetric_and_about_the_stated_axes(group: str, convention: str) -> None:
    rng = np.random.default_rng(2)
    half = rng.normal(size=(3, 6, 6))
    whole = half @ half.swapaxes(1, 2)
    if group == "variances":
        whole = whole * np.eye(6)
    rows, columns = np.array([[int(digit) - 1 for digit in each[1:]] for each in GROUPS[group]]).T
    turns = Rotation.random(3, random_state=4)
    groups = {
        "position": np.zeros((3, 3)),
        "quaternion": turns.as_quat(),
        group: whole[:, rows, columns],
    }
    layout = Layout("named", (), covariances=convention)
    found = states_of(Path("x"), layout, groups, 3)
    assert found.covariances is not None
    expected = whole
    if convention == BODY_TWISTS:
        both = np.zeros((3, 6, 6))
        both[:, :3, :3] = both[:, 3:, 3:] = turns.as_matrix()
        expected = both @ whole @ both.swapaxes(1, 2)
    np.testing.assert_allclose(found.covariances, expected, rtol=1e-12, atol=1e-12)
    assert len(found.remarks) == (convention == FIXED_AXES)
    del groups["quaternion"]
    assert states_of(Path("x"), layout, groups, 3).covariances is None


POSE = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("rows", "commas", "name"),
    [
        ([[1e12, *POSE]], True, "TUM"),
        ([[1.1e12, *POSE]], True, "EuRoC/ASL"),
        ([[-1.1e12, *POSE]], True, "EuRoC/ASL"),
        ([[1.1e12, *POSE]], False, "TUM"),
        ([[*POSE[:6], 1.099]], False, "TartanAir"),
        ([[*POSE[:6], 1.101]], False, None),
        ([[*POSE[:6], 0.901]], False, "TartanAir"),
        ([[*POSE[:6], 0.899]], False, None),
        ([[*POSE[:6], 0.0]], False, "TartanAir"),  # a quaternion without length is dropped
        ([[*POSE[:6], math.inf]], False, "TartanAir"),
        ([[7, 1.5, *POSE]], False, "TUM with an id"),
        ([[7.5, 1.5, *POSE], [8.5, 2.5, *POSE]], False, None),
        ([[1.5, *POSE, 3], [2.5, *POSE, 4]], False, "TUM with an id"),
        ([[1.5, *POSE, 3], [2.5, *POSE, 3]], False, None),
        ([[1.5, *POSE, 3], [2.5, *POSE, 4.5]], False, None),
        ([[0.0] * 5], False, None),
        ([[1, 2, 3, 4]], False, "t x y z"),
        ([[0, 1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]], False, "KITTI with a frame index"),
        ([[99_999_999, 1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]], False, "KITTI with a frame index"),
        ([[1e8, 1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]], False, "KITTI with a time"),
        ([[0.5, 1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]], False, "KITTI with a time"),
        ([[1.004, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]], False, "KITTI"),
        ([[1.006, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]], False, None),
    ],
)
def test_layouts_by_the_number_of_columns(rows: Any, commas: bool, name: str | None) -> None:
    if name is None:
        assert is_refused(by_count, rows, commas)
    else:
        assert by_count(rows, commas).name == name


def whole(*numbers: int) -> ExactNumbers:
    values = np.array(numbers)
    return ExactNumbers(
        values < 0, np.abs(values).astype(np.uint64), np.zeros(len(values), dtype=np.uint64)
    )


@pytest.mark.parametrize(
    ("numbers", "more", "in_nanoseconds"),
    [
        ((10**17 - 1024, 10**17), {}, None),  # the lower of two is typical, and no time in seconds
        ((10**17, 10**17 + 1024), {}, True),
        ((0, 10**17), {}, True),  # zero means "not set"
        ((5, 500_005), {"far_apart_is_ns": True}, True),
        ((5, 500_004), {"far_apart_is_ns": True}, False),
        ((5, 500_005), {}, False),
        ((9_199_999_999, 9_200_000_000), {}, False),
        ((9_199_000_000, 9_200_000_001), {}, True),
        ((9_200_000_000, 9_200_000_001), {}, None),
        ((5,), {"far_apart_is_ns": True}, False),
        ((5, 9), {"unit_ns": 1}, True),
        ((5, 9), {"unit_ns": SECOND}, False),
    ],
)
def test_the_unit_of_timestamps(
    numbers: tuple[int, ...], more: dict[str, Any], *, in_nanoseconds: bool | None
) -> None:
    if in_nanoseconds is None:
        assert is_refused(to_nanoseconds, whole(*numbers), **more)
        return
    stamps, found = to_nanoseconds(whole(*numbers), **more)
    assert found == in_nanoseconds
    assert stamps.tolist() == [each * (1 if found else SECOND) for each in numbers]


@pytest.mark.parametrize(("unit", "last"), [(10**6, 9_200_000_000_000), (10**3, 92 * 10**14)])
def test_times_in_other_units_end_with_int64(unit: int, last: int) -> None:
    stamps, _ = to_nanoseconds(whole(-3, last), unit)
    assert stamps.tolist() == [-3 * unit, last * unit]
    assert is_refused(to_nanoseconds, whole(last + 10**4), unit)
    half = ExactNumbers(
        np.array([False]), np.array([2], np.uint64), np.array([5 * 10**8], np.uint64)
    )
    assert to_nanoseconds(half, unit)[0].tolist() == [2 * unit + unit // 2]
    assert to_nanoseconds(half, 1)[0].tolist() == [3]
    almost = ExactNumbers(half.negative, half.whole, half.billionths - np.uint64(1))
    assert to_nanoseconds(almost, 1)[0].tolist() == [2]


@given(st.lists(st.tuples(st.integers(0, 10**19 - 1), st.integers(0, 28)), min_size=1))
def test_fractions_are_rounded_to_billionths(rows: list[tuple[int, int]]) -> None:
    rows = [(digits % 10**decimals, decimals) for digits, decimals in rows]
    fraction = np.array([digits for digits, _ in rows], dtype=np.uint64)
    decimals = np.array([decimals for _, decimals in rows])
    expected = [
        digits * 10 ** (9 - count)
        if count <= 9
        else (2 * digits + 10 ** (count - 9)) // (2 * 10 ** (count - 9))
        for digits, count in rows
    ]
    assert billionths(fraction, decimals).tolist() == expected


@given(st.lists(st.floats(-1e9, 1e9), min_size=1))
def test_floats_become_exact_numbers(values: list[float]) -> None:
    found = ExactNumbers.of_floats(np.array(values))
    sizes = found.whole.astype(float) + found.billionths.astype(float) / SECOND
    np.testing.assert_allclose(np.where(found.negative, -sizes, sizes), values, atol=1e-6 / 2)
    assert (found.billionths <= SECOND).all()
    assert found.negative.tolist() == [each < 0.0 for each in values]


@pytest.mark.parametrize("width", [400, 401])
def test_a_word_has_at_most_400_characters(width: int) -> None:
    tokens = tokenize(b"1 2\n" + b"5" * width + b" 3\n", 2)
    if width > 400:
        with pytest.raises(WordError, match="contains a word of 401 characters"):
            characters_of(tokens[slice(None), slice(None)])
    else:
        found = characters_of(tokens[slice(None), slice(None)])
        assert found.shape == (4, 400)
        assert found[2].tobytes() == b"5" * 400
        assert found[3].tobytes() == b"3" + bytes(399)


def test_a_layout_is_recognised_from_fifty_rows(tmp_path: Path) -> None:
    assert (head._SAMPLE, head._HEAD) == (50, 1 << 16)
    rows = [f"{row} 1 2 3 4 5 6 7" for row in range(60)]
    path = tmp_path / "x.txt"
    path.write_text("# header\n" + "\n".join(rows))
    found = head.read_head(path)
    assert len(found.sample) == 50
    assert (found.start, found.header, found.commas) == (9, ["header"], False)
    path.write_text("\n".join([*rows[:3], "", rows[3], "1 2", *rows]))
    assert len(head.read_head(path).sample) == 4
    path.write_text("\n".join([*rows[:2], "1 2 3 x", *rows]))
    assert len(head.read_head(path).sample) == 2


@pytest.mark.parametrize("length", [99, 100, 101, 199, 200])
@pytest.mark.parametrize("end", ["\n", ""])
def test_a_line_ends_within_two_blocks(tmp_path: Path, length: int, end: str) -> None:
    path = tmp_path / "x.txt"
    rows = ["1.5 1 2 3".ljust(length), "2.5 2 3 4", "3.5 3 4 5"]
    path.write_text("\n".join(rows) + end)
    assert reader._BLOCK == 1 << 19
    with mock.patch.object(reader, "_BLOCK", 100):
        if length == 200:
            with pytest.raises(InputError, match="a line has more than 100 bytes"):
                read_trajectory(path)
            return
        found = read_trajectory(path)
    assert found.stamps.tolist() == [1_500_000_000, 2_500_000_000, 3_500_000_000]
    path.write_text("\n".join([*rows, "4.5 3 4"]))
    with (
        mock.patch.object(reader, "_BLOCK", 100),
        pytest.raises(InputError, match="line 4: 4 columns expected, found 3"),
    ):
        read_trajectory(path)


def test_columns_of_an_array() -> None:
    turns = Rotation.random(4, random_state=0).as_quat()
    rows = np.hstack([np.arange(4)[:, None] + 0.5, np.ones((4, 3)), turns])
    found = array_trajectory(rows, "vio")
    assert found.stamps.tolist() == [500_000_000 + row * SECOND for row in range(4)]
    np.testing.assert_array_equal(found.positions, np.ones((4, 3)))
    np.testing.assert_allclose(found.quaternions, turns, atol=1e-15)  # type: ignore[arg-type]
    for factor, refused in ((1.0099, False), (1.0101, True), (0.9901, False), (0.9899, True)):
        longer = rows.copy()
        longer[1, 4:] *= factor
        assert is_refused(array_trajectory, longer, "vio") == refused
    unclear = rows.copy()
    unclear[:, 1:5] = unclear[:, 4:]  # both are of unit length
    assert is_refused(array_trajectory, unclear, "vio")
    rows[2, 0] = np.nan
    layout, columns = array_table(rows, Path("x"))
    assert (columns.count, columns.untimed) == (3, 1)
    assert layout.name == "numpy (N, 8)"
    assert is_refused(array_trajectory, np.array([["a"]]), "vio")
    assert is_refused(array_trajectory, np.zeros((3, 5)), "vio")
    assert is_refused(array_trajectory, np.zeros(3), "vio")
    assert is_refused(array_trajectory, np.zeros((0, 3)), "vio")
