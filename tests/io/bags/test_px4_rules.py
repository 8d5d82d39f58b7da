"""Rules for messages of PX4 at their limits: times, sizes, quaternions, fixes, frames, faults."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.io.test_ulog import COUNT, local_position, odometry
from trajeval_ros.io.bags import px4_messages
from trajeval_ros.io.bags.cdr_columns import Columns
from trajeval_ros.io.bags.declared_resets import declared_resets
from trajeval_ros.io.bags.px4_messages import (
    ATTITUDE,
    GPS,
    LOCAL_POSITION,
    ODOMETRY,
    about_px4,
    attitude_name,
    majority_frame,
    poses_of_px4,
    why_none,
    with_attitudes,
)

Array = NDArray[Any]


def columns_of(fields: dict[str, Array]) -> Columns:
    return Columns(np.arange(len(fields["timestamp"])), dict(fields), {}, {})


@pytest.mark.parametrize(
    ("delay_us", "measured"),
    [(0, True), (1, True), (1_000_000, True), (1_000_001, False), (-1, False)],
)
def test_a_measurement_is_at_most_a_second_before_its_publication(
    delay_us: int, *, measured: bool
) -> None:
    fields = odometry()
    fields["timestamp"] = np.full(COUNT, 5_000_000, dtype=np.uint64)
    fields["timestamp_sample"] = np.full(COUNT, 5_000_000 - delay_us, dtype=np.uint64)
    expected = 5_000_000 - (delay_us if measured else 0)
    assert set(poses_of_px4(columns_of(fields), ODOMETRY, 0).stamps) == {1000 * expected}


def test_times_beyond_int64_are_its_last() -> None:
    fields = odometry()
    fields["timestamp"] = np.full(COUNT, 2**63 - 1, dtype=np.uint64)
    fields["timestamp_sample"] = np.zeros(COUNT, dtype=np.uint64)
    last = (2**63 - 1) // 1000 * 1000
    assert set(poses_of_px4(columns_of(fields), ODOMETRY, 0).stamps.tolist()) == {last}


@pytest.mark.parametrize(
    ("length", "is_unit"), [(1.0099, True), (1.0101, False), (0.9901, True), (0.9899, False)]
)
def test_a_quaternion_of_px4_is_a_hundredth_from_unit_at_most(
    length: float, *, is_unit: bool
) -> None:
    fields = odometry()
    fields["q"][3] *= length / np.linalg.norm(fields["q"][3])
    attitude = {"timestamp": fields["timestamp"], "q": fields["q"]}
    for item, kind in ((fields, ODOMETRY), (attitude, ATTITUDE)):
        dropped = poses_of_px4(columns_of(item), kind, 0).dropped
        assert dropped["no_orientation"] == (0 if is_unit else 1)


@pytest.mark.parametrize(("code", "status"), [*enumerate([-1, -1, -1, 0, 1, 2, 2, -1, 0]), (9, 0)])
def test_fixes_of_px4_have_the_status_of_the_standard_message(code: int, status: int) -> None:
    fields = {
        "timestamp": np.array([5_000_000], dtype=np.uint64),
        "latitude_deg": np.array([47.4]),
        "longitude_deg": np.array([8.5]),
        "altitude_ellipsoid_m": np.array([500.25]),
        "eph": np.array([0.5]),
        "epv": np.array([0.75]),
        "fix_type": np.array([code]),
    }
    found = poses_of_px4(columns_of(fields), GPS, 0)
    np.testing.assert_array_equal(found.positions, [[47.4, 8.5, 500.25]])
    quality = np.zeros(11)
    quality[:2] = status, 1
    quality[[2, 6, 10]] = 0.25, 0.25, 0.5625
    assert found.fix_quality is not None
    np.testing.assert_array_equal(found.fix_quality[0], quality)
    old = {name: fields[name] for name in ("timestamp", "eph", "epv", "fix_type")}
    old |= {"lat": np.array([474_000_000]), "lon": np.array([85_000_000])}
    old |= {"alt_ellipsoid": np.array([500_250])}
    np.testing.assert_allclose(
        poses_of_px4(columns_of(old), GPS, 0).positions, [[47.4, 8.5, 500.25]], rtol=1e-15
    )


@pytest.mark.parametrize(("frd", "kept"), [(14, "map_enu"), (15, "map_enu"), (16, "odom_flu")])
def test_the_more_frequent_frame_of_px4_is_kept(frd: int, kept: str) -> None:
    fields = odometry()
    fields["pose_frame"][:frd] = fields["velocity_frame"][:frd] = 2
    found = majority_frame(poses_of_px4(columns_of(fields), ODOMETRY, 0))
    assert {frame for _, frame, _ in found.frames} == {kept}
    count = COUNT - frd if kept == "map_enu" else frd
    assert (len(found.stamps), found.dropped["other_frame"]) == (count, COUNT - count)
    said = "; ".join(item.text for item in about_px4(found))
    assert f"converted from {'NED' if kept == 'map_enu' else 'FRD'}" in said


@pytest.mark.parametrize(("quality", "failed"), [(-1, True), (-128, True), (0, False), (1, False)])
def test_a_failed_quality_is_counted(quality: int, *, failed: bool) -> None:
    fields = odometry()
    fields["quality"][2:4] = quality
    said = "; ".join(
        item.text for item in about_px4(poses_of_px4(columns_of(fields), ODOMETRY, 0))
    )
    assert ("2 messages with quality -1 (failed)" in said) == failed


@pytest.mark.parametrize(
    ("dropped", "why"),
    [
        ({"xy_valid_false": 4}, "xy_valid is false in all 4 messages: the estimator had no hor"),
        (
            {"z_valid_false": 3},
            "z_valid is false in all 3 messages: the estimator had no vertical",
        ),
        ({"xy_valid_false": 4, "no_position": 1}, "4 xy valid false, 1 no position"),
        ({"z_valid_false": 0, "no_position": 2}, "2 no position"),
    ],
)
def test_why_no_message_has_a_pose(dropped: dict[str, int], why: str) -> None:
    assert why_none(dropped).startswith(why)


@pytest.mark.parametrize(("gap_us", "is_usable"), [(100_000, True), (100_001, False)])
def test_attitudes_are_interpolated_over_a_tenth_of_a_second(
    gap_us: int, *, is_usable: bool
) -> None:
    times = np.array([1_000_000, 1_000_000 + gap_us], dtype=np.uint64)
    fields = {"timestamp": times, "q": np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))}
    attitudes = poses_of_px4(columns_of(fields), ATTITUDE, 0)
    local = {name: item[:1] for name, item in local_position().items()}
    local["timestamp"] = np.array([1_050_000], dtype=np.uint64)
    positions = poses_of_px4(columns_of(local), LOCAL_POSITION, 0)
    found = with_attitudes(positions, attitudes)
    assert len(found.stamps) == is_usable
    assert found.dropped.get("no_attitude_within_0.1_s", 0) == (not is_usable)
    nothing = attitudes.rows_of(np.zeros(2, dtype=bool))
    assert with_attitudes(positions, nothing) is positions


def test_names_of_attitudes() -> None:
    assert attitude_name("vehicle_local_position") == "vehicle_attitude"
    assert attitude_name("/fmu/out/vehicle_local_position_v1") == "/fmu/out/vehicle_attitude"
    assert attitude_name("/pose") == "/pose"


@pytest.mark.parametrize("kind", px4_messages._SIZES)
def test_messages_of_px4_are_known_by_their_size(kind: str) -> None:
    """The fields are numbers of the release with that size; up to three bytes may follow."""
    sizes = px4_messages._SIZES[kind]
    for size in range(min(sizes) - 5, max(sizes) + 6):
        fits = any(known <= size <= known + 3 for known in sizes)
        payload = b"\0\1\0\0" + struct.pack("<Q", 7_000_000) + bytes(size - 12)
        columns = px4_messages.Px4Plan(kind).decode([payload] * 3)
        assert len(columns.rows) == (3 if fits else 0)
        if fits:
            assert columns.numbers["timestamp"].tolist() == [7_000_000] * 3
    # The most frequent size is that of the layout.
    one, other = min(sizes), max(sizes)
    messages = [b"\0\1\0\0" + bytes(size - 4) for size in (one, other, other)]
    rows = px4_messages.Px4Plan(kind).decode(messages).rows.tolist()
    assert rows == ([1, 2] if one != other else [0, 1, 2])


def test_a_message_with_several_faults_is_counted_once() -> None:
    fields = odometry()
    fields["pose_frame"][2:6] = 0
    fields["q"][3:5] = np.nan
    fields["position"][4:6, 2] = np.nan
    found = poses_of_px4(columns_of(fields), ODOMETRY, 0)
    assert found.dropped == {"no_position": 2, "no_orientation": 1, "unknown_frame": 1}
    assert len(found.stamps) == COUNT - 4
    local = local_position()
    for name, rows in (("xy_valid", [3, 4, 5]), ("z_valid", [4, 5, 6])):
        local[name] = local[name].copy()
        local[name][rows] = 0
    local["x"] = local["x"].copy()
    local["x"][[5, 7]] = np.nan
    found = poses_of_px4(columns_of(local), LOCAL_POSITION, 0)
    assert found.dropped == {"no_position": 2, "xy_valid_false": 2, "z_valid_false": 1}
    assert len(found.stamps) == COUNT - 5


def test_resets_of_any_part_of_a_local_position_are_declared() -> None:
    local = local_position()
    for name, row in (("xy", 5), ("z", 9), ("heading", 14)):
        counter = np.zeros(COUNT, dtype=np.uint8)
        counter[row:] = 255
        local[f"{name}_reset_counter"] = counter
    found = declared_resets(poses_of_px4(columns_of(local), LOCAL_POSITION, 0))
    assert [item.stamp_ns for item in found] == [
        int(local["timestamp"][row]) * 1000 for row in (5, 9, 14)
    ]
    # Counters that change in opposite directions at once are a reset, too.
    local["z_reset_counter"] = local["xy_reset_counter"][::-1].copy()
    assert len(declared_resets(poses_of_px4(columns_of(local), LOCAL_POSITION, 0))) == 3
