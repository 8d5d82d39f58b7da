"""The content of a pair file of a live run."""

from __future__ import annotations

from typing import Any

import numpy as np

from trajeval_ros.io.live.pair_file import FORMAT

COUNT = 200
STEP_NS = 50_000_000
SETTINGS = {"gauge": "yaw", "lengths": "2,4"}
COUNTS = {
    "poses": COUNT,
    "states": COUNT,
    "duration_s": 9.95,
    "up": {"name": "z", "origin": "assumed"},
    "notes": [],
}
STATE: dict[str, Any] = {
    "settings": SETTINGS,
    "groundtruth": {
        **COUNTS,
        "path_length_m": 20.0,
        "time_without_gaps_ns": STEP_NS * COUNT,
        "frame": "map",
        "child_frame": "marker",
        "dropped": {},
    },
    "live": {"messages_lost": 0, "clock": {"status": "unobservable"}},
    "warnings": [],
    "estimate": {**COUNTS, "frame": "odom", "child_frame": "base_link"},
    "dropped": {},
    "aligned_by": None,
}
DESCRIPTION = {"format": FORMAT, "groundtruth": "/truth", "estimate": "/vio", "place": 0}


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
