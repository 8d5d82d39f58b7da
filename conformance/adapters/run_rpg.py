"""The formulas of rpg_trajectory_evaluation: python adapters/run_rpg.py > rpg.json.

Written from the definitions of commit 8c8ceec, because the toolbox is no package. Its relative
errors select other sub-trajectories than this kit, so they are left out.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from common import Answers, absolute_alignments, print_result
from numpy.typing import NDArray
from poses import matrices

Floats = NDArray[np.float64]
LIMIT_S = 0.02
KINDS = ("none", "yaw", "se3", "sim3")


def answer(folder: Path, quantities: list[str]) -> Answers:
    """Return the numbers of one case."""
    tables = [np.loadtxt(folder / f"{side}.txt", ndmin=2) for side in ("groundtruth", "estimate")]
    rows = associated(*(table[:, 0] for table in tables))
    truth, estimate = (matrices(table[places]) for table, places in zip(tables, rows, strict=True))
    answers: Answers = {"pairs": len(truth), "nearest:pairs": len(truth)}
    for kind in absolute_alignments(quantities):
        rule, _, alignment = kind.rpartition(":")
        name, _, first = alignment.partition("_first_")
        if rule == "linear" or name not in KINDS:
            continue
        prefix = f"{rule}:" if rule else ""
        s, R, t = aligned(name, int(first or len(truth)), truth, estimate)
        positions = truth[:, :3, 3] - (s * estimate[:, :3, 3] @ R.T + t)
        rotations = R @ estimate[:, :3, :3] @ truth[:, :3, :3].transpose(0, 2, 1)
        for metric, errors in (
            ("position_m", np.linalg.norm(positions, axis=1)),
            ("rotation_deg", np.degrees(angles(rotations))),
        ):
            for statistic, value in (
                ("rmse", np.sqrt(np.mean(errors**2))),
                ("mean", np.mean(errors)),
                ("median", np.median(errors)),
                ("max", np.max(errors)),
            ):
                answers[f"{prefix}{metric}.{alignment}.{statistic}"] = float(value)
        answers[f"{prefix}scale.{alignment}"] = float(s)
    return {quantity: answers[quantity] for quantity in quantities if quantity in answers}


def associated(truth: Floats, estimate: Floats) -> tuple[list[int], list[int]]:
    """Return the rows of pairs one to one, the smallest differences of float64 seconds first."""
    candidates = sorted(
        (difference, i, j)
        for i, stamp in enumerate(truth)
        for j, difference in enumerate(abs(estimate - stamp))
        if difference < LIMIT_S
    )
    pairs: dict[int, int] = {}
    used: set[int] = set()
    for _, i, j in candidates:
        if j not in pairs and i not in used:
            pairs[j] = i
            used.add(i)
    places = sorted(pairs)
    return [pairs[j] for j in places], places


def aligned(kind: str, states: int, truth: Floats, estimate: Floats) -> Any:
    """Return s, R, t of p = s R e + t by the first states; by the pose if there is one."""
    p, q = truth[:states, :3, 3], estimate[:states, :3, 3]
    s, R = 1.0, np.eye(3)
    if kind == "none":
        return s, R, np.zeros(3)
    mean_p, mean_q = p.mean(axis=0), q.mean(axis=0)
    K = (p - mean_p).T @ (q - mean_q) / len(p)
    if states == 1 and kind != "sim3":
        K = truth[0, :3, :3] @ estimate[0, :3, :3].T
    if kind == "yaw":
        yaw = np.arctan2(K[1, 0] - K[0, 1], K[0, 0] + K[1, 1])
        R[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    elif states == 1 and kind == "se3":
        R = K
    else:
        U, D, V = np.linalg.svd(K)
        S = np.diag([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(V))])
        R = U @ S @ V
        if kind == "sim3":
            with np.errstate(invalid="ignore"):  # no scale without motion
                s = np.trace(np.diag(D) @ S) / np.mean(np.sum((q - mean_q) ** 2, axis=1))
    return s, R, mean_p - s * R @ mean_q


def angles(rotations: Floats) -> Floats:
    """Return the lengths of the logarithms of rotation matrices, rad."""
    traces = np.trace(rotations, axis1=1, axis2=2)
    axial = (rotations - rotations.transpose(0, 2, 1))[:, [2, 0, 1], [1, 2, 0]]
    sines = np.linalg.norm(axial, axis=1) / 2.0
    theta = np.arccos(np.clip((traces - 1.0) / 2.0, -1.0, 1.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        general = theta / np.sin(theta) * sines
    # An arc cosine has too few digits of small angles, and a sine of angles near pi.
    return np.select([traces > 3.0 - 1e-7, abs(traces + 1.0) < 1e-10], [sines, np.pi], general)


if __name__ == "__main__":
    print_result("rpg's formulas", "8c8ceec", answer)
