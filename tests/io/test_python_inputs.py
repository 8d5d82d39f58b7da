"""`evaluate` of arrays, paths and tables, and trajectories from arrays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import trajeval_ros
from trajeval_ros import (
    PROTOCOLS,
    InputError,
    Trajectory,
    evaluate,
    read_trajectory,
    run,
    simulate,
)
from trajeval_ros.geometry import lie

FLIGHT = simulate(seed=5, duration_s=40.0)
SIDES = (FLIGHT.groundtruth, FLIGHT.estimate)
ATE = evaluate(*SIDES).ate["position_m"]


def matrices(trajectory: Trajectory) -> np.ndarray:
    result = np.tile(np.eye(4), (len(trajectory), 1, 1))
    assert trajectory.quaternions is not None
    result[:, :3, :3] = lie.to_matrix(trajectory.quaternions)
    result[:, :3, 3] = trajectory.positions
    return result


def rmse(*sides: object) -> float:
    result = evaluate(*sides).ate["position_m"]  # type: ignore[arg-type]
    assert result is not None
    return result.rmse


def test_matrices_of_any_form_and_both_kinds_of_times() -> None:
    assert ATE is not None
    by_stamps = [Trajectory.from_matrices(matrices(side), stamps=side.stamps) for side in SIDES]
    assert rmse(*by_stamps) == pytest.approx(ATE.rmse, rel=1e-9)
    by_seconds = [
        Trajectory.from_matrices(matrices(side)[:, :3].tolist(), seconds=side.stamps / 1e9)
        for side in SIDES
    ]
    assert rmse(*by_seconds) == pytest.approx(ATE.rmse, rel=1e-4)  # rounded to 0.2 us


def test_positions_and_quaternions_in_both_orders() -> None:
    assert ATE is not None
    made = []
    for side in SIDES:
        assert side.quaternions is not None
        wxyz = np.roll(side.quaternions, 1, axis=1)
        made.append(Trajectory.from_positions(side.positions, wxyz, stamps=side.stamps, wxyz=True))
    assert rmse(*made) == pytest.approx(ATE.rmse, rel=1e-9)
    assert made[0].quaternions is not None
    assert SIDES[0].quaternions is not None
    np.testing.assert_allclose(made[0].quaternions, SIDES[0].quaternions, rtol=0, atol=1e-12)
    bare = Trajectory.from_positions(SIDES[1].positions, stamps=SIDES[1].stamps, name="bare")
    assert bare.quaternions is None
    assert rmse(SIDES[0], bare) == pytest.approx(ATE.rmse, rel=1e-9)


def test_tables_of_pandas() -> None:
    pandas = pytest.importorskip("pandas", reason="pandas is missing")
    assert ATE is not None
    frames = []
    for side in SIDES:
        columns = dict(zip(["x", "y", "z"], side.positions.T, strict=True))
        assert side.quaternions is not None
        columns |= dict(zip(["qx", "qy", "qz", "qw"], side.quaternions.T, strict=True))
        frames.append(pandas.DataFrame({"timestamp": side.stamps, **columns}))
    assert rmse(*frames) == pytest.approx(ATE.rmse, rel=1e-9)
    dates = [frame.set_index(pandas.to_datetime(frame.pop("timestamp"))) for frame in frames]
    assert rmse(*dates) == pytest.approx(ATE.rmse, rel=1e-9)
    with pytest.raises(InputError, match="has the columns a, b; name the positions x, y and z"):
        Trajectory.from_pandas(pandas.DataFrame({"a": [1.0], "b": [2.0]}))
    with pytest.raises(InputError, match="only qx of qx, qy, qz and qw"):
        Trajectory.from_pandas(frames[0][["x", "y", "z", "qx"]])
    with pytest.raises(InputError, match="not DataFrame; for arrays and tables"):
        read_trajectory(frames[0])


def test_paths_and_arrays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert ATE is not None
    paths = []
    for name, side in zip(("gt", "est"), SIDES, strict=True):
        rows = np.column_stack([side.stamps / 1e9, side.positions, side.quaternions])
        np.savetxt(tmp_path / f"{name}.txt", rows, fmt="%.9f")
        paths.append(tmp_path / f"{name}.txt")
    assert rmse(*map(str, paths)) == pytest.approx(ATE.rmse, rel=1e-3)
    assert rmse(*map(np.loadtxt, paths)) == pytest.approx(ATE.rmse, rel=1e-3)
    # Arrays without times pair by row, whatever lies in the working directory.
    monkeypatch.chdir(tmp_path)
    np.savetxt("times.txt", np.arange(50.0))
    pairs = evaluate(*SIDES).association
    both = matrices(pairs.groundtruth), matrices(pairs.estimate)
    assert rmse(*both) == pytest.approx(ATE.rmse, rel=1e-9)


def test_run_takes_what_evaluate_takes() -> None:
    assert ATE is not None
    tables = [np.column_stack([side.stamps / 1e9, side.positions]) for side in SIDES]
    runs = run(tables[0], [SIDES[1], tables[1]]).runs
    assert [item.evaluation.estimate.name for item in runs] == [SIDES[1].name, "estimate 2"]
    for item in runs:
        result = item.evaluation.ate["position_m"]
        assert result is not None
        assert result.rmse == pytest.approx(ATE.rmse, rel=1e-3)  # rounded to 0.2 us


def test_pairs_by_row_are_said_and_have_no_duration() -> None:
    pairs = evaluate(*SIDES).association
    timed = Trajectory.from_positions(pairs.groundtruth.positions, stamps=pairs.groundtruth.stamps)
    bare = Trajectory.from_positions(pairs.estimate.positions)
    for sides, side in (((timed, bare), "estimate"), ((bare, timed), "groundtruth")):
        text = evaluate(*sides).warnings
        assert text[0].startswith(f"poses are paired by row, because the {side} has no timestamps")
        assert "in Python, with seconds=" in text[0]
    assert not any("by row" in warning for warning in evaluate(*SIDES).warnings)
    jumping = bare.positions.copy()
    jumping[len(bare) // 2] += 3.0
    both = bare, Trajectory.from_positions(jumping)
    (remark,) = (item for item in evaluate(*both).remarks if item.code == "discontinuities")
    assert remark.text.startswith("1 outlier of the estimate of up to ")
    row = int(remark.text.rpartition("at pair ")[2])
    assert abs(row - (len(bare) // 2 + 1)) <= 1
    short = Trajectory.from_positions(1e-3 * bare.positions, pairs.estimate.quaternions)
    (said_of_lengths,) = (
        warning for warning in evaluate(short, short).warnings if "no sub-" in warning
    )
    assert said_of_lengths.endswith(" m")
    assert " s, " not in repr(bare)
    assert " s, " in repr(timed)


def test_the_package_lists_its_own_names() -> None:
    assert {"import_module", "TYPE_CHECKING"}.isdisjoint(dir(trajeval_ros))


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (lambda: Trajectory.from_matrices(np.zeros((5, 3, 3))),
         r"matrices have shape \(5, 3, 3\), expected \(N, 4, 4\) or \(N, 3, 4\)"),
        (lambda: Trajectory.from_positions(np.zeros((5, 2)), seconds=np.arange(5.0)),
         r"positions have shape \(5, 2\), expected \(N, 3\)"),
        (lambda: Trajectory.from_positions(np.zeros((5, 3)), np.ones((4, 4))),
         r"quaternions have shape \(4, 4\), expected \(5, 4\)"),
        (lambda: Trajectory.from_positions(np.zeros((5, 3)), seconds=np.arange(4.0)),
         r"seconds have shape \(4,\), expected \(5,\)"),
        (lambda: Trajectory.from_positions(np.zeros((5, 3)), seconds=np.arange(5) + 10**18),
         "nanoseconds; convert them to seconds, or give integer nanoseconds with stamps="),
        (lambda: Trajectory.from_positions(np.zeros((5, 3)), seconds=np.arange(5) + 1.3e12),
         "up to 1.3e\\+12, which are probably milliseconds; convert"),
        (lambda: Trajectory.from_positions(np.zeros((5, 3)), seconds=np.arange(5) + 1.3e15),
         "probably microseconds"),
        (lambda: Trajectory.from_positions(np.zeros((5, 3)), stamps=1311868164 + np.arange(5)),
         "stamps= has 5 values within 4 ns, which are probably not nanoseconds; give times in"),
        (lambda: Trajectory.from_positions(np.zeros((5, 3)), stamps=np.arange(5.0)),
         "must be integer nanoseconds, not float64"),
        (lambda: Trajectory.from_positions(np.zeros((2, 3)), seconds=[0, 1], stamps=[0, 1]),
         "times are given twice"),
        (lambda: Trajectory.from_positions([[1, 2, 3], [1, 2]]), "not an array of real numbers"),
        (lambda: Trajectory.from_columns(np.arange(5), np.zeros((5, 3)), np.ones((4, 4))),
         r"quaternions have shape \(4, 4\), expected \(5, 4\)"),
        (lambda: evaluate({}, np.zeros((5, 7))), "the groundtruth is of type dict; give a Traj"),
        (lambda: evaluate(np.zeros((5, 9)), np.zeros((5, 9))), r"groundtruth has shape \(5, 9\)"),
        (lambda: evaluate(*SIDES, "evo"), r"protocol is of type str; give .* PROTOCOLS\['evo'\]"),
        (lambda: run(SIDES[0], SIDES[1].positions), "estimates are of type ndarray; give a list"),
        (lambda: run(SIDES[0], [{}]), "the estimate 1 is of type dict; give a Trajectory"),
        (lambda: evaluate(SIDES[0], SIDES[1].positions[:50]),
         "cannot be paired by row; give times .* seconds="),
        (lambda: evaluate(SIDES[0][:50], SIDES[1][:40], PROTOCOLS["kitti"]),
         "cannot be paired by row; pair them by time with --association linear"),
    ],
)  # fmt: skip
def test_wrong_arrays_are_named(made: object, message: str) -> None:
    assert callable(made)
    with pytest.raises(InputError, match=message):
        made()
