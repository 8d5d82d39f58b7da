"""How trajectories were read: data by row, remarks and counts."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from trajeval_ros import Trajectory
from trajeval_ros.cli.app import main
from trajeval_ros.formatting.remarks import Level, damaged, note, remark_json, remark_of, warning
from trajeval_ros.geometry.source_info import SourceInfo

COUNT = 6
ROWS = SourceInfo(
    "poses.txt",
    frame_numbers=np.arange(COUNT),
    matrices=np.arange(9.0 * COUNT).reshape(COUNT, 3, 3),
    dropped={"not_finite": 1},
    remarks=(note("format", "format: KITTI"),),
)


def made(reading: SourceInfo) -> Trajectory:
    return Trajectory(np.arange(COUNT), np.zeros((COUNT, 3)), reading=reading)


def test_a_trajectory_has_at_most_12_fields() -> None:
    assert len(dataclasses.fields(Trajectory)) == 12


@pytest.mark.parametrize("rows", [slice(1, 3), np.array([1, 2]), np.arange(COUNT) % 5 == 1])
def test_a_part_has_its_own_rows(rows: slice | np.ndarray) -> None:
    part = made(ROWS)[rows].reading
    assert part.frame_numbers is not None
    assert part.matrices is not None
    np.testing.assert_array_equal(part.frame_numbers, np.arange(COUNT)[rows])
    np.testing.assert_array_equal(part.matrices[:, 0, 0], 9.0 * np.arange(COUNT)[rows])
    assert (part.source, part.dropped, part.remarks) == (ROWS.source, ROWS.dropped, ROWS.remarks)


def test_invalid_rows_are_dropped_from_the_reading_too() -> None:
    positions = np.zeros((COUNT, 3))
    positions[2] = np.nan
    read = Trajectory.from_columns(np.arange(COUNT), positions, reading=ROWS).reading
    assert read.frame_numbers is not None
    assert read.frame_numbers.tolist() == [0, 1, 3, 4, 5]
    assert read.dropped == {"not_finite": 2}


@pytest.mark.parametrize(
    "reading", [SourceInfo(frame_numbers=np.arange(2)), SourceInfo(matrices=np.zeros((COUNT, 3)))]
)
def test_rows_of_another_shape_are_refused(reading: SourceInfo) -> None:
    with pytest.raises(ValueError, match="has shape"):
        made(reading)


def test_states_at_other_times_have_no_data_by_row() -> None:
    moved = made(ROWS).moved_to(np.arange(2), positions=np.zeros((2, 3))).reading
    assert moved.frame_numbers is moved.matrices is moved.fixes is None
    assert moved.remarks == ROWS.remarks
    assert ROWS.without("matrices").frame_numbers is ROWS.frame_numbers
    assert made(SourceInfo("x")).reading.without().source == "x"


def test_remarks_have_levels() -> None:
    read = ROWS.remarked(warning("w", "one"), damaged("two"))
    assert read.messages(Level.WARNING) == ("one",)
    assert read.messages(Level.ERROR) == ("two",)
    assert read.format == "KITTI"
    assert [remark_of(remark_json(remark)) for remark in read.remarks] == list(read.remarks)


def test_results_have_the_remarks_of_inputs_and_runs(tmp_path: Path) -> None:
    path, result = tmp_path / "poses.txt", tmp_path / "result.json"
    rows = [f"{1e9 + 0.1 * i:.1f} {i} {i * i / 99} 0 0 0 0 1" for i in range(100)]
    rows.insert(50, "1000000004.9 500 0 0 0 0 0 1")
    path.write_text("\n".join(rows))
    given = ["-g", str(path), "-e", str(path), "--quiet", "--json", str(result)]
    assert main(["evaluate", *given]) == 0
    outcome = json.loads(result.read_text())
    of_input = {remark["code"]: remark["level"] for remark in outcome["groundtruth"]["remarks"]}
    assert of_input["format"] == "note"
    assert of_input["conflicting_states"] == "warning"
    assert outcome["runs"][0]["estimate"]["remarks"][0]["text"] == "format: TUM"
    of_run = {remark["code"]: remark["level"] for remark in outcome["runs"][0]["remarks"]}
    assert of_run["conflicting_states"] == "warning"
