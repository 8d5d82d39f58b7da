"""PyPose's metrics: python adapters/run_pypose.py > pypose.json."""

from __future__ import annotations

import warnings
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pypose
import torch
from common import Answers, absolute_alignments, print_result
from poses import rows
from pypose.metric import ape, rpe

STATISTICS = {"rmse": "RMSE", "mean": "Mean", "median": "Median", "max": "Max"}
TYPES = {"position_m": "translation", "rotation_deg": "degree"}
OPTIONS: dict[str, dict[str, Any]] = {
    "none": {},
    "se3": {"align": True},
    "sim3": {"align": True, "scale": True},
    "se3_first_1": {"origin": True},
    "se3_first_10": {"align": True, "nposes": 10},
    "nearest:none": {"diff": 0.02},
    "nearest:se3": {"diff": 0.02, "align": True},
}


def answer(folder: Path, quantities: list[str]) -> Answers:
    """Return the numbers of one case."""
    answers: Answers = {}
    calls: list[tuple[str, Any, dict[str, Any]]] = [
        (kind, ape, OPTIONS[kind]) for kind in absolute_alignments(quantities) & OPTIONS.keys()
    ]
    if quantities[0].startswith("relative"):
        # 1 s are 16 steps of these cases.
        calls = [("relative", rpe, {"associate": "frame", "delta": 16.0, "all": True})]
    for kind, function, options in calls:
        for metric, name in TYPES.items():
            rule, _, alignment = kind.rpartition(":")
            quantity = f"{rule}:{metric}.{alignment}" if rule else f"{metric}.{alignment}"
            if kind == "relative":
                quantity = f"relative.{metric}.se3.1s"
            try:
                found = function(*_sides(folder), etype=name, **options)
            except Exception as error:  # whatever it raises is its answer
                found = dict.fromkeys(STATISTICS.values(), f"{type(error).__name__}: {error}")
            for statistic, key in STATISTICS.items():
                value = found[key]
                answers[f"{quantity}.{statistic}"] = (
                    value if isinstance(value, str) else float(value)
                )
    return {quantity: answers[quantity] for quantity in quantities if quantity in answers}


def _sides(folder: Path) -> list[Any]:
    """Return timestamps and poses of both sides; the metrics change their arguments."""
    sides: list[Any] = []
    for side in ("groundtruth", "estimate"):
        table = torch.tensor(rows(folder / f"{side}.txt"))
        poses = pypose.SE3(table[:, 1:])
        poses[:, 3:] = poses[:, 3:] / poses[:, 3:].norm(dim=1, keepdim=True)
        sides += [table[:, 0].clone(), poses]
    return sides


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    print_result("PyPose", version("pypose"), answer)
