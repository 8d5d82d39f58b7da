"""What a live run has recorded, as its evaluation pairs it."""

from __future__ import annotations

from pathlib import Path

from trajeval_ros.io.live.live_folder import evaluate_folder
from trajeval_ros.metrics.association import Association


def pairs_of(folder: Path, name: str = "vio") -> Association:
    """Return the pairs of an estimate in the folder of a live run."""
    [run] = [run for run in evaluate_folder(folder).runs if run.estimate.name == name]
    return run.evaluation.association
