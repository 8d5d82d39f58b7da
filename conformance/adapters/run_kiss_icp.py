"""KISS-ICP's metrics: python adapters/run_kiss_icp.py > kiss_icp.json."""

from __future__ import annotations

import math
from importlib.metadata import version
from pathlib import Path

from common import Answers, has_equal_stamps, print_result
from kiss_icp.metrics import absolute_trajectory_error, sequence_error
from poses import matrices, rows


def answer(folder: Path, quantities: list[str]) -> Answers:
    """Return the numbers of one case."""
    if not has_equal_stamps(quantities):
        return {}  # it pairs by row
    sides = [matrices(rows(folder / f"{side}.txt")) for side in ("groundtruth", "estimate")]
    if quantities[0].startswith("kitti"):
        percent, degrees = sequence_error(*sides)
        return {"kitti.t_rel_percent": percent, "kitti.r_rel_deg_per_m": degrees}
    if quantities[0].startswith("relative"):
        return {}
    rotation, position = absolute_trajectory_error(*sides)
    return {
        "position_m.se3.rmse": position,
        "rotation_deg.se3.rmse": math.degrees(rotation),
    }


if __name__ == "__main__":
    print_result("KISS-ICP", version("kiss-icp"), answer)
