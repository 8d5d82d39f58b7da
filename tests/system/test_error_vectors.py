"""Errors axis by axis, and the files that hold them with the aligned poses."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from strategies import make_pair

from trajeval_ros import Trajectory, run, simulate, write_result
from trajeval_ros.cli.app import main
from trajeval_ros.formatting.install_command import pyarrow_command
from trajeval_ros.geometry.up_axis import UpAxis
from trajeval_ros.io.results import error_archive
from trajeval_ros.metrics.evaluation import evaluate
from trajeval_ros.metrics.protocol import Protocol
from trajeval_ros.pipeline.outcome import Outcome
from trajeval_ros.pipeline.request import Request

GAUGES = ["none", "translation", "yaw", "se3", "sim3"]


@given(
    seed=st.integers(0, 500), gauge=st.sampled_from(GAUGES), form=st.sampled_from(["plain", "evo"])
)
def test_vectors_are_as_long_as_the_errors(seed: int, gauge: str, form: str) -> None:
    pair = make_pair(seed, 40, smooth=True)
    result = evaluate(pair.groundtruth, pair.estimate, Protocol(gauge=gauge, ate_form=form))
    assume(
        not result.withheld
    )  # the rotation errors of one seed, which positions determine poorly
    vectors, absolute = result.error_vectors, result.absolute
    for item in (vectors.position_world_m, vectors.position_body_m):
        np.testing.assert_allclose(np.linalg.norm(item, axis=1), absolute.position_m, atol=1e-12)
    for item in (vectors.rotation_world_deg, vectors.rotation_body_deg):
        np.testing.assert_allclose(np.linalg.norm(item, axis=1), absolute.rotation_deg, atol=1e-9)


def test_the_tutorials_form_has_vectors_of_its_own() -> None:
    pair = make_pair(5, 60, smooth=True)
    result = evaluate(pair.groundtruth, pair.estimate, Protocol(gauge="se3", ate_form="tutorial"))
    position = result.error_vectors.position_world_m
    np.testing.assert_allclose(np.linalg.norm(position, axis=1), result.absolute.position_m)


@given(seed=st.integers(0, 500))
def test_aligned_poses_and_errors_give_the_groundtruth(seed: int) -> None:
    pair = make_pair(seed, 40, smooth=True)
    result = evaluate(pair.groundtruth, pair.estimate, Protocol(gauge="yaw"))
    assume(not result.withheld)
    vectors, truth, aligned = result.error_vectors, result.association.groundtruth, result.aligned
    np.testing.assert_allclose(
        aligned.positions + vectors.position_world_m, truth.positions, atol=1e-12
    )
    assert truth.rotations is not None
    assert aligned.rotations is not None
    world = Rotation.from_rotvec(vectors.rotation_world_deg, degrees=True) * aligned.rotations
    body = aligned.rotations * Rotation.from_rotvec(vectors.rotation_body_deg, degrees=True)
    for item in (world, body):
        assert (item * truth.rotations.inv()).magnitude().max() < 1e-12
    np.testing.assert_allclose(
        truth.rotations.apply(vectors.position_body_m), vectors.position_world_m, atol=1e-12
    )


def test_an_error_along_one_axis_is_on_that_axis() -> None:
    # 0.1 m behind and turned left by 2 deg, on the way to the east and then to the north.
    stamps = np.arange(4, dtype=np.int64) * 10**9
    positions = np.array([[0.0, 0, 0], [5, 0, 0], [5, 5, 0], [5, 10, 0]])
    heading = Rotation.from_rotvec([[0, 0, angle] for angle in (0, 0, 90, 90)], degrees=True)
    truth = Trajectory.from_columns(stamps, positions, heading.as_quat())
    behind = positions - 0.1 * heading.apply([1.0, 0, 0])
    rotated = heading * Rotation.from_euler("z", 2.0, degrees=True)
    estimate = Trajectory.from_columns(stamps, behind, rotated.as_quat())
    protocol = Protocol(gauge="none", lengths=())
    vectors = evaluate(truth, estimate, protocol).error_vectors
    np.testing.assert_allclose(vectors.position_body_m, [[0.1, 0, 0]] * 4, atol=1e-12)
    world = [[0.1, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0.1, 0]]
    np.testing.assert_allclose(vectors.position_world_m, world, atol=1e-12)
    np.testing.assert_allclose(vectors.rotation_body_deg, [[0, 0, -2.0]] * 4, atol=1e-9)


def test_what_is_missing_is_left_out() -> None:
    pair = make_pair(3, 60, smooth=True)
    protocol = Protocol(gauge="se3", lengths=())
    points = dataclasses.replace(pair.groundtruth, quaternions=None)
    vectors = evaluate(points, pair.estimate, protocol).error_vectors
    assert vectors.position_body_m is None
    assert vectors.rotation_world_deg is None
    turnless = dataclasses.replace(pair.estimate, quaternions=None)
    vectors = evaluate(pair.groundtruth, turnless, protocol).error_vectors
    assert vectors.position_body_m is not None
    assert vectors.rotation_body_deg is None


def test_columns_are_along_the_groundtruths_own_axes() -> None:
    flight = simulate(seed=1, duration_s=20.0)
    up = UpAxis("-y")
    rotation = Rotation.from_matrix(up.matrix.T)

    def rotated_copy(trajectory: Trajectory) -> Trajectory:
        assert trajectory.rotations is not None
        return dataclasses.replace(
            trajectory,
            positions=rotation.apply(trajectory.positions),
            quaternions=(rotation * trajectory.rotations).as_quat(),
            velocities=None,
            covariances=None,
            up=up,
        )

    request = Request(Protocol(gauge="yaw", lengths=()))
    upright = run(flight.groundtruth, [flight.estimate], request)
    camera = run(rotated_copy(flight.groundtruth), [rotated_copy(flight.estimate)], request)
    expected = upright.runs[0].evaluation.to_columns()
    result = camera.runs[0].evaluation.to_columns()
    for name in ("aligned_positions", "position_world_m", "rotation_world_deg"):
        np.testing.assert_allclose(result[name], rotation.apply(expected[name]), atol=1e-9)
    for name in ("position_body_m", "rotation_body_deg", "position_m"):
        np.testing.assert_allclose(result[name], expected[name], atol=1e-9)
    same = Rotation.from_quat(result["aligned_quaternions"]).inv() * (
        rotation * Rotation.from_quat(expected["aligned_quaternions"])
    )
    assert same.magnitude().max() < 1e-9


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    flight = simulate(seed=1, duration_s=20.0)
    first = dataclasses.replace(flight.estimate, name="first")
    points = dataclasses.replace(flight.estimate[::2], quaternions=None, name="points")
    return run(flight.groundtruth, [first, points], Request(Protocol(gauge="se3", lengths=(4,))))


def test_the_table_has_a_row_for_each_pair(outcome: Outcome, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is missing")
    write_result(outcome, tmp_path)
    table = parquet.read_table(tmp_path / "errors.parquet")
    assert table.schema.metadata[b"trajeval.schema"] == b"trajeval-error-table/1"
    names = np.array(table["estimate"].to_pylist())
    with np.load(tmp_path / "errors.npz") as archive:
        for item in outcome.runs:
            name = item.estimate.name
            rows = table.filter(names == name)
            assert len(rows) == len(item.evaluation.association)
            for column, parts in (
                ("stamps", ("stamps",)),
                ("position_m", ("position_m",)),
                ("position_world_m", [f"position_world_m_{axis}" for axis in "xyz"]),
                ("position_body_m", [f"position_body_m_{axis}" for axis in "xyz"]),
                ("aligned_positions", [f"aligned_positions_{axis}" for axis in "xyz"]),
            ):
                result = np.column_stack([rows[part].to_numpy() for part in parts])
                np.testing.assert_array_equal(
                    result, archive[f"{name}.{column}"].reshape(result.shape)
                )
        assert "points.rotation_world_deg" not in archive
        yaw = table["rotation_world_deg_yaw"].to_pylist()
        assert [value for value in yaw if value is not None] == archive[
            "first.rotation_world_deg"
        ][:, 2].tolist()
        assert yaw.count(None) == len(outcome.runs[1].evaluation.association)
        w = table.filter(names == "first")["aligned_quaternions_w"].to_numpy()
        np.testing.assert_array_equal(w, archive["first.aligned_quaternions"][:, 3])


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_without_pyarrow_there_is_no_table_and_a_hint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    flight = simulate(seed=1, duration_s=20.0)
    for name, item in (("g", flight.groundtruth), ("e", flight.estimate)):
        rows = np.column_stack([item.stamps / 1e9, item.positions, item.quaternions])
        np.savetxt(tmp_path / f"{name}.txt", rows, fmt="%.9f")
    folder = tmp_path / "out"
    sources = ["-g", str(tmp_path / "g.txt"), "-e", str(tmp_path / "e.txt")]
    assert main(["evaluate", *sources, "--output", str(folder)]) == 0
    assert (folder / "errors.parquet").exists()
    # Not sys.modules: Rerun imports pyarrow, too.
    monkeypatch.setattr(error_archive, "have_pyarrow", lambda: False)
    assert main(["evaluate", *sources, "--output", str(folder)]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert f"errors.parquet needs pyarrow, install it: {pyarrow_command()}" in text
    assert not (folder / "errors.parquet").exists()
    assert json.loads((folder / "result.json").read_text())["schema"] == "trajeval/3"
    with np.load(folder / "errors.npz") as archive:
        assert archive["e.aligned_quaternions"].shape[1] == 4


def test_a_missing_pyarrow_is_noticed(
    outcome: Outcome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    write_result(outcome, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["errors.npz", "result.json"]
