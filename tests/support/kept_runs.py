"""Runs of which outputs are kept: a flight and a drive as bags, and estimates as text."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from trajeval_ros.cli.app import main
from trajeval_ros.io.text.text_writer import write_tum
from trajeval_ros.simulation.drifting_odometry import simulate


def write_runs(folder: Path) -> None:
    """Write them: `run`, `drive`, `truth.txt`, and `a.txt` to `d.txt`, which ends early."""
    short = ["--duration", "40", "--seed", "3"]
    assert main(["simulate", str(folder / "run"), *short]) == 0
    assert main(["simulate", str(folder / "drive"), *short, "--gnss", "rtk"]) == 0
    vi = ["--duration", "12", "--profile", "stereo"]
    assert main(["simulate", str(folder / "vi"), *vi]) == 0
    flight = simulate(3, 40.0)
    write_tum(folder / "truth.txt", flight.groundtruth[::4])
    for place, name in enumerate("abcd"):
        walk = np.random.default_rng(place).normal(size=flight.estimate.positions.shape)
        moved = flight.estimate.positions + 3e-3 * place * walk.cumsum(axis=0)
        estimate = dataclasses.replace(flight.estimate, positions=moved)
        write_tum(folder / f"{name}.txt", estimate[: len(moved) // 2] if name == "d" else estimate)
