"""An ATE from about as many pairs as the alignment needs says so before anything else."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from comparison_runs import here, write_run, write_runs

from trajeval_ros import Protocol, Trajectory, evaluate, simulate
from trajeval_ros.batch.comparison import run_plan
from trajeval_ros.batch.comparison_summary import summary_of
from trajeval_ros.batch.config import plan_of
from trajeval_ros.batch.summary_tables import matrices
from trajeval_ros.report.verdict_lines import verdict

FEW = "too few for an ATE"


def surveyed(count: int, every_s: float = 2.0) -> tuple[Trajectory, Trajectory]:
    """Return surveyed points of a flight, on stamps of its estimate, and the estimate."""
    truth = simulate(seed=2, duration_s=60.0).groundtruth
    estimate = truth[::10]  # 20 Hz
    points = estimate[np.arange(40, len(estimate), round(20 * every_s))[:count]]
    # Equal positions are a mistake of their own.
    return Trajectory(points.stamps, points.positions + [1.0, 2.0, 3.0]), estimate


@pytest.mark.parametrize(
    ("settings", "enough"),
    [
        ({"gauge": "se3"}, 6),
        ({"gauge": "sim3"}, 6),
        ({"gauge": "yaw"}, 4),
        ({"gauge": "translation"}, 2),
        ({"gauge": "none"}, 2),
    ],
)
def test_fewer_than_twice_what_the_alignment_needs_are_few(
    settings: dict[str, str], enough: int
) -> None:
    for count in (enough - 1, enough):
        points, estimate = surveyed(count)
        result = evaluate(points, estimate, Protocol(lengths=(), **settings))
        assert len(result.association) == count
        assert (FEW in verdict(result)[0]) == (count < enough)
        assert (FEW in result.warnings[0]) == (count < enough)


def test_a_first_state_aligns_by_itself() -> None:
    flight = simulate(seed=2, duration_s=30.0)
    for count in (1, 2):
        few = flight.estimate[100 : 100 + count]
        result = evaluate(flight.groundtruth, few, Protocol(align_states=1, lengths=()))
        assert (FEW in verdict(result)[0]) == (count < 2)
    assert (
        "1 pair, too few"
        in verdict(
            evaluate(flight.groundtruth, flight.estimate[100:101], Protocol(align_states=1))
        )[0]
    )


def test_the_warning_says_how_to_pair_sparse_groundtruth() -> None:
    points, estimate = surveyed(5)
    linear = Protocol(lengths=(), association="linear")
    assert "survey more points" in evaluate(points, estimate, linear).warnings[0]
    # Interpolating the estimate pairs the point at which it has no state.
    gone = estimate[~np.isin(estimate.stamps, points.stamps[1:2])]
    told = evaluate(points, gone, linear).warnings[0]
    assert "5 states, 2.0 s apart" in told
    assert "--association groundtruth-stamps" in told
    dense = simulate(seed=2, duration_s=30.0)
    told = evaluate(dense.groundtruth, dense.estimate[:5], Protocol(lengths=())).warnings[0]
    assert FEW in told
    assert "apart" not in told


@pytest.mark.slow
def test_tables_mark_what_is_from_few_pairs_and_do_not_rank_it(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is missing, the extra `compare`")
    config = write_runs(tmp_path, trials=1)
    write_run(tmp_path / "good" / "hall_trial0.txt", 1.01, count=5)
    run_plan(plan_of(config, {}), tmp_path, here)
    table = next(
        matrix for matrix in matrices(summary_of(tmp_path)) if matrix.name == "ate_position_m"
    )
    (good, bad) = (dict(zip(table.columns, cells, strict=True)) for _, cells in table.rows)
    assert "‡" in good["hall"].note
    assert not good["hall"].is_ranked
    assert "‡" not in good["yard"].note + bad["hall"].note
    assert good["yard"].is_ranked
    assert "‡ fewer than 6 pairs" in table.caption


@pytest.mark.slow
def test_surveyed_points_of_a_campus(recording: Callable[[str], Trajectory]) -> None:
    points, estimate = (recording(f"hilti_2021/Campus_2_{name}.txt") for name in ("prism", "svo2"))
    assert len(evaluate(points, estimate, Protocol(lengths=())).association) == 19
    result = evaluate(points, estimate, Protocol(lengths=(), association="linear"))
    assert len(result.association) == 3
    assert FEW in verdict(result)[0]
    assert "19 states, 18.7 s apart" in result.warnings[0]
