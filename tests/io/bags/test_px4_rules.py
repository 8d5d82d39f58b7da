"""Messages of PX4: frames, resets and names."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.io.test_ulog import COUNT, local_position, odometry
from trajeval_ros.io.bags.cdr_columns import Columns
from trajeval_ros.io.bags.declared_resets import declared_resets
from trajeval_ros.io.bags.px4_messages import (
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


@pytest.mark.parametrize(("frd", "kept"), [(14, "map_enu"), (15, "map_enu"), (16, "odom_flu")])
def test_the_more_frequent_frame_of_px4_is_kept(frd: int, kept: str) -> None:
    fields = odometry()
    fields["pose_frame"][:frd] = fields["velocity_frame"][:frd] = 2
    result = majority_frame(poses_of_px4(columns_of(fields), ODOMETRY, 0))
    assert {frame for _, frame, _ in result.frames} == {kept}
    count = COUNT - frd if kept == "map_enu" else frd
    assert (len(result.stamps), result.dropped["other_frame"]) == (count, COUNT - count)
    text = "; ".join(item.text for item in about_px4(result))
    assert f"converted from {'NED' if kept == 'map_enu' else 'FRD'}" in text


def test_resets_of_any_part_of_a_local_position_are_declared() -> None:
    local = local_position()
    for name, row in (("xy", 5), ("z", 9), ("heading", 14)):
        counter = np.zeros(COUNT, dtype=np.uint8)
        counter[row:] = 255
        local[f"{name}_reset_counter"] = counter
    result = declared_resets(poses_of_px4(columns_of(local), LOCAL_POSITION, 0))
    assert [item.stamp_ns for item in result] == [
        int(local["timestamp"][row]) * 1000 for row in (5, 9, 14)
    ]
    # Counters that change in opposite directions at once are a reset, too.
    local["z_reset_counter"] = local["xy_reset_counter"][::-1].copy()
    assert len(declared_resets(poses_of_px4(columns_of(local), LOCAL_POSITION, 0))) == 3


def test_names_of_attitudes() -> None:
    assert attitude_name("vehicle_local_position") == "vehicle_attitude"
    assert attitude_name("/fmu/out/vehicle_local_position_v1") == "/fmu/out/vehicle_attitude"
    assert attitude_name("/pose") == "/pose"
