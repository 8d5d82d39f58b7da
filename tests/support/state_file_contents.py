"""The content of the files of a live run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from state_rows import trajectory

from trajeval_ros.io.live.state_file import GROUNDTRUTH, StateWriter

COUNT = 200
STEP_NS = 50_000_000
SIDE = {
    "up": {"name": "z", "origin": "assumed"},
    "notes": [],
    "dropped": {},
    "resets": [],
}
STATE: dict[str, Any] = {
    "settings": {"gauge": "yaw", "lengths": ["2m", "4m"]},
    "time_offset_s": 0.0,
    "aligned_by": None,
    "until_ns": None,
    "groundtruth": {**SIDE, "frame": "map", "child_frame": "marker"},
    "estimate": {**SIDE, "frame": "odom", "child_frame": "base_link"},
    "live": {"messages_lost": 0, "clock": {"status": "unobservable"}},
    "hand_eye": None,
    "fixes": None,
    "warnings": [],
}
DESCRIPTION = {"source": "/vio", "name": "vio", "place": 0}


def columns() -> tuple[Any, Any, Any]:
    """Return stamps and states of a flight, and of an estimate of it."""
    stamps = 1_700_000_000_000_000_000 + STEP_NS * np.arange(COUNT)
    time = STEP_NS * 1e-9 * np.arange(COUNT)
    truth = np.full((COUNT, 10), np.nan)
    truth[:, :3] = np.column_stack([2.0 * time, np.sin(time), np.cos(time)])
    truth[:, 3:7] = np.column_stack([0 * time, 0 * time, np.sin(time / 9), np.cos(time / 9)])
    estimate = truth.copy()
    estimate[:, :3] += 0.05 * np.random.default_rng(1).normal(size=(COUNT, 3))
    return stamps, truth, estimate


def write_groundtruth(folder: Path) -> None:
    """Write the groundtruth's file, unless the folder has one."""
    if not (folder / GROUNDTRUTH).exists():
        stamps, truth, _ = columns()
        writer = StateWriter(folder / GROUNDTRUTH, {"source": "/truth", "name": "truth"})
        writer.append(trajectory(stamps, truth))
        writer.close()


def write_estimate(
    path: Path,
    state: dict[str, Any] | None = None,
    at: int = COUNT,
    place: int = 0,
) -> Path:
    """Write the files of both sides, the estimate's with the counts after `at` states."""
    write_groundtruth(path.parent)
    stamps, _, estimate = columns()
    description = {**DESCRIPTION, "name": path.stem, "place": place}
    writer = StateWriter(path, description)
    writer.append(trajectory(stamps[:at], estimate[:at]))
    writer.describe(STATE if state is None else state)
    writer.append(trajectory(stamps[at:], estimate[at:]))
    writer.close()
    return path
