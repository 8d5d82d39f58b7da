"""trajeval_ros, by its Python interface: python adapters/run_trajeval.py > trajeval.json."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from common import Answers, absolute_alignments, print_result

from trajeval_ros import (
    AssociationRule,
    CovarianceRequest,
    Evaluation,
    Protocol,
    Request,
    Trajectory,
    TrajevalError,
    __version__,
    evaluate,
    read_trajectory,
    run,
)
from trajeval_ros.metrics.sub_trajectories import Selection

STATISTICS = ("rmse", "mean", "median", "max")
KITTI_LENGTHS = tuple(range(100, 900, 100))


def answer(folder: Path, quantities: list[str]) -> Answers:
    """Return the numbers of one case."""
    sides = [read_trajectory(folder / f"{side}.txt") for side in ("groundtruth", "estimate")]
    answers: Answers = {}
    for kind in absolute_alignments(quantities):
        answers.update(_absolute(*sides, kind))
    if quantities[0].startswith("relative"):
        answers = _relative(*sides)
    elif quantities[0].startswith("kitti"):
        selection = Selection("first-past", every=10)
        protocol = Protocol(
            gauge="none", re_form="se3", lengths=KITTI_LENGTHS, selection=selection
        )
        pooled = evaluate(*sides, protocol).pooled
        for name, metric in (
            ("t_rel_percent", "position_percent"),
            ("r_rel_deg_per_m", "rotation_deg_per_m"),
        ):
            answers[f"kitti.{name}"] = _number(pooled[metric], "mean")
    elif "nees.position.mean" in quantities:
        answers["nees.position.mean"] = _nees(*sides, folder / "covariance.txt")
    return {quantity: answers[quantity] for quantity in quantities if quantity in answers}


def _number(statistics: Any, name: str) -> Any:
    return "undetermined" if statistics is None else getattr(statistics, name)


def _absolute(groundtruth: Trajectory, estimate: Trajectory, kind: str) -> Answers:
    """Return the absolute errors by an alignment such as nearest:se3_first_10."""
    rule, _, name = kind.rpartition(":")
    gauge, _, states = name.partition("_first_")
    protocol = Protocol(
        gauge=gauge,
        align_states=int(states) if states else None,
        association=AssociationRule(rule or "linear", max_gap_s=0.5 if rule else 1e4),
        lengths=(),
    )
    prefix = f"{rule}:" if rule else ""
    names = [f"position_m.{name}", f"rotation_deg.{name}"]
    try:
        evaluation = evaluate(groundtruth, estimate, protocol)
    except TrajevalError:
        answers = {f"{prefix}{item}.{s}": "undetermined" for item in names for s in STATISTICS}
        return {**answers, f"{prefix}scale.{name}": "undetermined"}
    answers = {
        f"{prefix}{item}.{statistic}": _number(evaluation.ate[item.split(".")[0]], statistic)
        for item in names
        for statistic in STATISTICS
    }
    answers[f"{prefix}pairs"] = len(evaluation.association)
    answers[f"{prefix}scale.{name}"] = evaluation.alignment.similarity.scale
    return answers


def _relative(groundtruth: Trajectory, estimate: Trajectory) -> Answers:
    answers: Answers = {}
    for form in ("se3", "yaw", "tutorial_se3", "tutorial_yaw"):
        protocol = Protocol(
            gauge=form.removeprefix("tutorial_"),
            re_form="tutorial" if form.startswith("tutorial") else "gauge",
            lengths=("1s", "2m"),
            selection="first-past",
        )
        evaluation: Evaluation = evaluate(groundtruth, estimate, protocol)
        for length, segments in zip(("1s", "2m"), evaluation.relative or (), strict=True):
            for metric in ("position_m", "rotation_deg"):
                for statistic in ("rmse", "mean"):
                    answers[f"relative.{metric}.{form}.{length}.{statistic}"] = _number(
                        segments.statistics[metric], statistic
                    )
    return answers


def _nees(groundtruth: Trajectory, estimate: Trajectory, file: Path) -> float:
    """Return the mean NEES of the positions; the kit has no covariances of orientations."""
    xx, xy, xz, yy, yz, zz = np.loadtxt(file)[:, 1:].T
    covariances = np.tile(1e-4 * np.eye(6), (len(xx), 1, 1))
    covariances[:, :3, :3] = np.moveaxis(
        np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), 2, 0
    )
    request = Request(
        protocol=Protocol(gauge="none", lengths=()), covariances=CovarianceRequest("message")
    )
    outcome = run(groundtruth, [replace(estimate, covariances=covariances)], request)
    consistency = outcome.runs[0].consistency
    assert consistency is not None
    return 3.0 * consistency.per_pose.position.mean


if __name__ == "__main__":
    print_result("trajeval_ros", __version__, answer)
