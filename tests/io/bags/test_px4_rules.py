"""Rules for messages of PX4 at their limits: times, sizes, quaternions, fixes, frames, faults."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.io.test_ulog import COUNT, local_position, odometry
from trajeval_ros.io.bags.cdr_columns import Columns
from trajeval_ros.io.bags.declared_resets import declared_resets
from trajeval_ros.io.bags.px4_messages import (
    GPS,
    LOCAL_POSITION,
    ODOMETRY,
    about_px4,
    attitude_name,
    majority_frame,
    poses_of_px4,
)

Array = NDArray[Any]


def columns_of(fields: dict[str, Array]) -> Columns:
    return Columns(np.arange(len(fields["timestamp"])), dict(fields), {}, {})


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


def test_names_of_attitudes() -> None:
    assert attitude_name("vehicle_local_position") == "vehicle_attitude"
    assert attitude_name("/fmu/out/vehicle_local_position_v1") == "/fmu/out/vehicle_attitude"
    assert attitude_name("/pose") == "/pose"
