"""One request gives the same numbers by command line, comparison, live run and Python."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from comparison_runs import compare
from live_runs import ESTIMATE, GROUNDTRUTH, Live
from ros_bags import ODOM, POSE, messages_of, write_messages
from ros_processes import assert_same
from strategies import make_pair

from trajeval_ros.cli.app import main
from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.io.requests.request_from import request_from
from trajeval_ros.io.results.result_json import result_of
from trajeval_ros.io.sources import read_trajectory
from trajeval_ros.pipeline.pipeline import run

HAND_EYE = """\
header: {frame_id: base_link}
child_frame_id: marker
transform:
  translation: {x: 0.1, y: -0.05, z: 0.2}
  rotation: {x: 0.0, y: 0.0, z: 0.7071067811865476, w: 0.7071067811865476}
"""
MARKED, HONEST = "marked", "honest"
REQUESTS: dict[str, tuple[str, dict[str, Any]]] = {
    "plain": (MARKED, {"modality": "stereo-inertial"}),
    "protocol": (MARKED, {"protocol": "rpg", "gauge": "se3", "align_states": "100"}),
    "calibrated": (
        MARKED,
        {"modality": "stereo-inertial", "time_offset": "auto", "hand_eye": "auto"},
    ),
    "known body": (MARKED, {"gauge": "yaw", "time_offset": "0.1", "hand_eye": "FILE"}),
    "covariances": (HONEST, {"gauge": "yaw", "align_states": "1", "covariance": "message",
                             "groundtruth_noise": "0.002,0.1"}),
    "integrity": (HONEST, {"gauge": "yaw", "align_states": "1", "covariance": "message",
                           "alert_limit": "0.5,2", "risk": 0.001}),
    "continuous": (HONEST, {"gauge": "yaw", "association": "continuous", "lengths": "none",
                            "groundtruth_noise": "0.002,0.1"}),
}  # fmt: skip


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a flight of a marker, and one with honest covariances."""
    folder = tmp_path_factory.mktemp("bags")
    marked, honest = str(folder / MARKED), str(folder / HONEST)
    assert main(["simulate", marked, "--marker", "--duration", "30"]) == 0
    assert main(["simulate", honest, "--profile", "euroc", "--duration", "10"]) == 0
    (folder / "marker.yaml").write_text(HAND_EYE)
    return folder


def options_of(words: dict[str, Any]) -> list[str]:
    """Return words as options; True is one without a value."""
    return [
        part
        for key, value in words.items()
        for part in (f"--{key.replace('_', '-')}", *([] if value is True else [str(value)]))
    ]


def words_of(name: str, folder: Path) -> dict[str, Any]:
    words = REQUESTS[name][1]
    return {key: str(folder / "marker.yaml") if value == "FILE" else value
            for key, value in words.items()}  # fmt: skip


def sources(bag: Path) -> tuple[str, str]:
    return f"{bag}:/groundtruth/pose", f"{bag}:/vio/odometry"


def without_name(result: dict[str, Any]) -> str:
    """Return a run as text; its name is chosen by whoever shows it."""
    assert result["estimate"].pop("name")
    if result["calibration"] is not None and result["calibration"]["estimated_from"] is not None:
        assert result["calibration"].pop("estimated_from")
    return json.dumps(result)


@pytest.mark.slow
@pytest.mark.parametrize("name", REQUESTS)
def test_command_line_comparison_and_python_give_the_same_bytes(
    bags: Path, tmp_path: Path, name: str
) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    from comparison_runs import here

    from trajeval_ros.batch.comparison import run_plan
    from trajeval_ros.batch.config import plan_of
    from trajeval_ros.batch.finished_comparison import RUNS
    from trajeval_ros.batch.records import RECORDS, RecordStore
    from trajeval_ros.batch.results_table import ResultsTable

    words = words_of(name, bags)
    truth, estimate = sources(bags / REQUESTS[name][0])
    options = options_of(words)
    file = tmp_path / "result.json"
    assert main(["evaluate", "-g", truth, "-e", estimate, *options, "--quiet", "--json", str(file)]
                ) == 0  # fmt: skip
    by_command = json.loads(file.read_text())["runs"][0]

    config = tmp_path / "runs.yaml"
    config.write_text(
        f"folder: {bags}\nsequences: [{REQUESTS[name][0]}]\n"
        'groundtruth: "{sequence}:/groundtruth/pose"\nruns: {vio: "{sequence}:/vio/odometry"}\n'
        + "".join(f"{key}: '{value}'\n" for key, value in words.items() if key in TEXTS)
        + "".join(f"{key}: {value}\n" for key, value in words.items() if key not in TEXTS)
    )
    progress = run_plan(plan_of(config, {}), tmp_path / "out", here)
    assert progress.failed == 0
    rows = ResultsTable(tmp_path / "out" / RUNS).select(["key"])
    (key,) = {row["key"] for row in rows}
    recorded = RecordStore(tmp_path / "out" / RECORDS).read(key)
    assert recorded is not None

    request = request_from(words)
    groundtruth = read_trajectory(truth, covariances=False)
    outcome = run(
        groundtruth, [read_trajectory(estimate, covariances=request.reads_covariances)], request
    )
    by_python = json.loads(json.dumps(result_of(outcome)["runs"][0]))

    asked = {"calibrated": "calibration", "known body": "calibration",
             "covariances": "consistency", "integrity": "integrity",
             "continuous": "probabilistic"}  # fmt: skip
    if name in asked:
        assert by_command[asked[name]] is not None
    expected = without_name(by_command)
    assert without_name(recorded.run) == expected
    assert without_name(by_python) == expected


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "metrics"),
    [
        ("calibrated", {"time_offset_s": 0.1, "parameters_applied": None}),
        ("covariances", {"pose_nees_per_dof": None}),
        (
            "integrity",
            {"horizontal_hazardous": 0.0, "horizontal_available": None, "heading_level_deg": None},
        ),
        ("continuous", {"nll_per_pose": None, "weighted_m": None}),
    ],
)
def test_comparison_tabulates_what_was_asked_for(
    bags: Path, tmp_path: Path, name: str, metrics: dict[str, float | None]
) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    words = words_of(name, bags)
    in_file = {key: words.pop(key) for key in ("alert_limit", "risk") if key in words}
    options = options_of({key: value for key, value in words.items() if key != "lengths"})
    config = tmp_path / "runs.yaml"
    config.write_text(
        "".join(f"{key}: {value}\n" for key, value in in_file.items())
        + f"folder: {bags}\nsequences: [{REQUESTS[name][0]}]\nlengths: none\n"
        'groundtruth: "{sequence}:/groundtruth/pose"\nruns: {vio: "{sequence}:/vio/odometry"}\n'
    )
    out = tmp_path / "out"
    assert compare(config, *options, "-q", output=out) == 0
    from trajeval_ros.batch.results_table import ResultsTable

    values = {row["metric"]: row["mean"] for row in ResultsTable(out / "runs.parquet").select(
        ("kind", "metric", "mean")) if row["kind"] not in ("ate", "re", "re.pooled")}  # fmt: skip
    for metric, expected in metrics.items():
        assert np.isfinite(values[metric])
        if expected is not None:
            assert values[metric] == pytest.approx(expected, abs=0.01)
    table = next(item for item in metrics if item != "parameters_applied")
    assert (out / f"{table}.csv").is_file()


TEXTS = ("lengths", "groundtruth_noise", "alert_limit", "gauge", "hand_eye")


@pytest.mark.slow
@pytest.mark.parametrize("hand_eye", ["FILE", "auto"])
def test_a_live_run_with_a_marker_is_evaluated_as_a_recorded_one(
    tmp_path: Path, hand_eye: str
) -> None:
    # Groundtruth at the estimate's stamps: then it makes no difference that the recorded marker
    # is moved before it is interpolated, and the live one after.
    pair = make_pair(5, 400, smooth=True)
    truth = pair.groundtruth
    estimate = dataclasses.replace(pair.groundtruth, positions=1.001 * truth.positions)
    quaternions = truth.quaternions
    assert quaternions is not None
    rotation = np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
    marker = HandEye(rotation, np.array([0.1, -0.05, 0.2]))
    moved = dataclasses.replace(
        truth,
        positions=truth.positions + lie.rotate(quaternions, marker.lever_m),
        quaternions=lie.multiply(quaternions, rotation),
    )
    feed = [*messages_of(moved, GROUNDTRUTH, POSE), *messages_of(estimate, ESTIMATE, ODOM)]
    feed.sort(key=lambda item: item[2])
    write_messages(tmp_path / "bag", feed)
    (tmp_path / "marker.yaml").write_text(HAND_EYE)
    asked = str(tmp_path / "marker.yaml") if hand_eye == "FILE" else hand_eye
    live = Live(tmp_path / "live", ODOM)
    live.feed(feed)
    live.end()
    by_live, by_bag = tmp_path / "live.json", tmp_path / "bag.json"
    assert live.finish("--hand-eye", asked, "--json", str(by_live)) == 0
    bag = tmp_path / "bag"
    sides = ["-g", f"{bag}:{GROUNDTRUTH}", "-e", f"{bag}:{ESTIMATE}"]
    assert main(["evaluate", *sides, "--gauge", "yaw",
                 "--lengths", "2,4", "--hand-eye", asked, "--quiet", "--json", str(by_bag)]
                ) == 0  # fmt: skip
    here, there = (json.loads(item.read_text())["runs"][0] for item in (by_live, by_bag))
    assert there["calibration"]["T_body_marker"] is not None
    assert there["ate"]["rotation_deg"]["rmse"] < 1.0
    for block in ("alignment", "ate", "re", "calibration"):
        assert_same(here[block], there[block])


def test_a_live_run_can_be_aligned_with_poses_afterwards(tmp_path: Path) -> None:
    live = Live(tmp_path / "live", ODOM)
    pair = make_pair(5, 80, smooth=True)
    feed = [
        *messages_of(pair.groundtruth, GROUNDTRUTH, POSE),
        *messages_of(pair.estimate, ESTIMATE, ODOM),
    ]
    feed.sort(key=lambda item: item[2])
    write_messages(tmp_path / "bag", feed)
    live.feed(feed)
    live.end()
    by_live, by_bag = tmp_path / "live.json", tmp_path / "bag.json"
    assert live.finish("--align-with", "poses", "--json", str(by_live)) == 0
    bag = tmp_path / "bag"
    sides = ["-g", f"{bag}:{GROUNDTRUTH}", "-e", f"{bag}:{ESTIMATE}"]
    assert main(["evaluate", *sides, "--gauge", "yaw",
                 "--lengths", "2,4", "--align-with", "poses", "--quiet", "--json", str(by_bag)]
                ) == 0  # fmt: skip
    here, there = (json.loads(item.read_text()) for item in (by_live, by_bag))
    assert here["provenance"]["settings"]["align_with"] == "poses"
    for block in ("alignment", "ate", "re"):
        assert_same(here["runs"][0][block], there["runs"][0][block])


def test_no_estimate_is_refused_in_a_sentence() -> None:
    with pytest.raises(InputError, match="no estimate given"):
        run(make_pair(5, 40, smooth=True).groundtruth, [])
