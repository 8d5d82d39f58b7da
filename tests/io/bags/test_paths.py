"""Paths: the last one is the trajectory; paths that slide are merged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from damaged_bags import SECOND, definition, mcap_file
from hypothesis import given
from hypothesis import strategies as st
from made_bags import STORE, TYPES, header, pose_stamped

from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.sources import read_trajectory

PATH = "nav_msgs/msg/Path"
Window = tuple[int, int]  # number of the first pose, and number after the last one


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("paths")


def read_paths(folder: Path, windows: list[Window], log_times: list[int]) -> Trajectory:
    """Read messages with the poses of windows; x is 1000 times the message plus the pose."""
    messages = [
        TYPES[PATH](
            header(SECOND),
            [pose_stamped((100 + row) * SECOND, 1000.0 * number + row) for row in range(*window)],
        )
        for number, window in enumerate(windows)
    ]
    payloads = [bytes(STORE.serialize_cdr(message, PATH)) for message in messages]
    path = mcap_file(
        folder / "run.mcap",
        messages=payloads,
        schema=(PATH, "ros2msg", definition(PATH)),
        log_times=log_times,
    )
    return read_trajectory(f"{path}:/pose")


def newest(windows: list[Window], log_times: list[int]) -> dict[int, float]:
    """Return x by stamp, the latest message last."""
    return {
        (100 + row) * SECOND: 1000.0 * number + row
        for number in np.argsort(log_times, kind="stable").tolist()
        for row in range(*windows[number])
    }


@given(
    steps=st.lists(st.integers(0, 4), min_size=1, max_size=25),
    width=st.integers(1, 6),
)
def test_paths_that_slide_are_merged_others_are_not(
    steps: list[int], width: int, folder: Path
) -> None:
    begins = np.cumsum([0, *steps]).tolist()
    windows = [(begin, begin + width) for begin in begins]
    log_times = [number * SECOND for number in range(len(windows))]
    read = read_paths(folder, windows, log_times)
    slides = begins[-1] >= width
    expected = newest(windows if slides else windows[-1:], log_times if slides else [0])
    if not slides:
        expected = {stamp: x + 1000.0 * (len(windows) - 1) for stamp, x in expected.items()}
    assert read.stamps.tolist() == sorted(expected)
    assert read.positions[:, 0].tolist() == [expected[stamp] for stamp in sorted(expected)]
    codes = {remark.code for remark in read.reading.remarks}
    assert ("sliding_path" in codes) == slides


def test_versions_are_ordered_by_log_times_not_by_their_place(folder: Path) -> None:
    windows = [(0, 4), (8, 12), (2, 6), (4, 8)]
    log_times = [0, 30 * SECOND, 10 * SECOND, 20 * SECOND]
    read = read_paths(folder, windows, log_times)
    expected = newest(windows, log_times)
    assert dict(zip(read.stamps.tolist(), read.positions[:, 0].tolist(), strict=True)) == expected


def test_a_growing_path_is_its_last_message(folder: Path) -> None:
    windows = [(0, size) for size in (3, 6, 9)]
    read = read_paths(folder, windows, [0, SECOND, 2 * SECOND])
    assert read.positions[:, 0].tolist() == [2000.0 + row for row in range(9)]
