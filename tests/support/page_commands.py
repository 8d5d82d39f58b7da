"""The commands on the pages of the documentation, and a folder with the files that they name."""

from __future__ import annotations

import dataclasses
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from comparison_runs import compare
from paths import ROOT, TESTS
from scipy.spatial.transform import Rotation
from waiting import PATIENCE_S

from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.write_bag import write_bag
from trajeval_ros.io.save_trajectories import save_trajectories
from trajeval_ros.io.sources import read_trajectory

PAIR = TESTS / "data/parity/pairs/drone_loop"
_BLOCK = re.compile(r"^( *)```(\w*)\n(.*?)^\1```", re.MULTILINE | re.DOTALL)

# Commands that no test types, by how they begin, and why.
NOT_RUN = {
    "git clone": "needs a network",
    "make": ".ci/run runs both",
    "trajeval demo": "tests/cli/test_demo.py runs it",
    "pip install": "needs a package index; tests/system/test_packaging.py installs the archives",
    "python3 -m venv": "makes an environment; tests/system/test_packaging.py does",
    "python3 -m colcon": ".ci/run builds with colcon",
    "rosdep": "needs apt; tests/system/test_packaging.py resolves the dependencies",
    "colcon": ".ci/run builds with colcon",
    "source": "needs an installed ROS 2",
    "ros2 launch": "needs ros2cli; tests/ros/test_launch_file.py runs the launch file",
    "ros2 run trajeval_ros evaluator": "tests/ros/test_pages.py runs the tutorial's",
    "ros2 run trajeval_ros replay": "tests/ros/test_pages.py runs the tutorial's",
    "ros2 topic": "needs ros2cli",
    "ros2 bag": "needs ros2cli",
    "rerun": "opens a window; tests/viewer/test_screen.py starts the viewer",
    "trajeval view": "opens a window; tests/viewer/test_screen.py starts the viewer",
    "trajeval finish live": "needs a live run; tests/ros/test_pages.py has one",
}


def pages() -> list[Path]:
    """Return all pages: README and what the site is made of."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def commands(text: str) -> Iterator[str]:
    """Yield the commands of the `console` blocks of a page, each as one line."""
    for _, kind, block in _BLOCK.findall(text):
        if kind == "console":
            yield from _commands_of(block)


def outputs(text: str) -> Iterator[tuple[list[str], list[str]]]:
    """Yield the commands of a `console` block and the lines of the `text` block after it."""
    for (_, kind, block), (_, next_kind, output) in pairwise(_BLOCK.findall(text)):
        if (kind, next_kind) == ("console", "text"):
            yield _commands_of(block), output.splitlines()


def _commands_of(block: str) -> list[str]:
    lines = block.replace("\\\n", " ").splitlines()
    typed = [line.strip()[2:] for line in lines if line.strip().startswith("$ ")]
    return [" ".join(item.split()) for item in typed]


def why_not_run(command: str) -> str | None:
    """Return why a command is not run by the tests of pages; None if it is."""
    return next((why for begin, why in NOT_RUN.items() if command.startswith(begin)), None)


def environment_with_programs(folder: Path, **more: str) -> dict[str, str]:
    """Return an environment in which `trajeval` and `ros2 run trajeval_ros` are those of here."""
    folder.mkdir()
    run = f'exec "{sys.executable}" -m trajeval_ros'
    for name, script in {
        "trajeval": f'{run} "$@"',
        "ros2": f'test "$1 $2" = "run trajeval_ros" || exit 127\nshift 2\n{run} "$@"',
    }.items():
        (folder / name).write_text(f"#!/bin/sh\n{script}\n")
        (folder / name).chmod(0o755)
    path = f"{folder}{os.pathsep}{os.environ['PATH']}"
    return {**os.environ, "PYTHONPATH": str(ROOT), **more, "PATH": path}


def typed(
    command: str, folder: Path, environment: dict[str, str], allowed: Sequence[int] = (0,)
) -> str:
    """Type a command, check how it ends, and return what it prints."""
    done = subprocess.run(
        ["bash", "-c", command],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode in allowed, f"{command}\n{done.stdout}{done.stderr}"
    return done.stdout + done.stderr


def _saved(folder: Path, trajectory: Trajectory, name: str, kind: str) -> None:
    """Save a trajectory under a name that says nothing of its format."""
    apart = folder / "apart"
    apart.mkdir()
    for save_trajectory in save_trajectories(apart, [trajectory], kind):
        save_trajectory.rename(folder / name)
    apart.rmdir()


def _bag(folder: Path, name: str, topics: list[tuple[str, Trajectory, str]]) -> None:
    messages = {topic: (states, kind) for topic, states, kind in topics}
    write_bag(folder / "bag", messages)
    (recorded,) = (folder / "bag").glob("*.mcap")
    recorded.rename(folder / name)
    shutil.rmtree(folder / "bag")


def make_files(folder: Path) -> None:
    """Write all files that commands on the pages name and no command before them makes."""
    truth, estimate = read_trajectory(PAIR / "gt.txt"), read_trajectory(PAIR / "est.txt")
    variances = np.tile(np.diag([0.05**2] * 3 + [0.01**2] * 3), (len(estimate), 1, 1))
    estimate = dataclasses.replace(estimate, covariances=variances)
    other = dataclasses.replace(
        estimate, stamps=estimate.stamps + 13_000_000, positions=estimate.positions * 1.01
    )
    for name in ("gt.txt", "groundtruth.txt", "mocap.txt", "rtk.txt", "truth.txt"):
        _saved(folder, truth, name, "tum")
    for name in ("gt.csv", "groundtruth.csv", "mav0/state_groundtruth_estimate0/data.csv"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        _saved(folder, truth, name, "euroc")
    assert truth.rotations is not None
    angles = truth.rotations.as_euler("xyz")
    microseconds = truth.stamps[:, None] / 1e3
    rows = np.column_stack([microseconds, truth.positions, angles])
    np.savetxt(folder / "mocap.csv", rows, fmt=["%.0f", *["%.9f"] * 6], delimiter=",")
    for name in ("vio.txt", "estimate.txt", "a.txt"):
        _saved(folder, estimate, name, "tum")
    for name in ("slam.txt", "b.txt"):
        _saved(folder, other, name, "tum")
    topics = [
        ("/mocap/pose", truth, "geometry_msgs/msg/PoseStamped"),
        ("/vio/odometry", estimate, "nav_msgs/msg/Odometry"),
        ("/slam/path", other, "nav_msgs/msg/Path"),
    ]
    _bag(folder, "run.mcap", topics)
    _bag(folder, "flight.mcap", topics)
    for algorithm, states in (("ours", estimate), ("baseline", other)):
        (folder / algorithm).mkdir()
        for sequence in ("MH_01", "MH_02"):
            for trial in range(2):
                # Identical trials count once.
                varied = dataclasses.replace(states, positions=states.positions + 1e-3 * trial)
                _saved(folder / algorithm, varied, f"{sequence}_{trial}.txt", "tum")
    (folder / "groundtruth").mkdir()
    for sequence in ("MH_01", "MH_02"):
        _saved(folder / "groundtruth", truth, f"{sequence}.txt", "tum")
    (folder / "euroc.yaml").write_text(
        "title: EuRoC\ngroundtruth: groundtruth/{sequence}.txt\nmodality: mono-inertial\nruns:\n"
        "  ours: ours/{sequence}_{trial}.txt\n  baseline: baseline/{sequence}_{trial}.txt\n"
    )
    listed = ["algorithm,sequence,groundtruth,estimate"]
    listed += [
        f"{item},MH_01,groundtruth/MH_01.txt,{item}/MH_01_0.txt" for item in ("ours", "baseline")
    ]
    (folder / "runs.csv").write_text("\n".join(listed))
    made = folder / "made"
    assert compare(folder / "euroc.yaml", "--quiet", output=made) == 0
    (made / "runs.parquet").rename(folder / "main.parquet")
    shutil.rmtree(made)
    (folder / "marker.yaml").write_text(
        "header: {frame_id: imu}\nchild_frame_id: marker\ntransform:\n"
        "  translation: {x: 0.1, y: -0.05, z: 0.2}\n  rotation: {x: 0, y: 0, z: 0, w: 1}\n"
    )
    rows = np.column_stack([truth.stamps * 1e-6, np.zeros(len(truth)), truth.positions[:, :2]])
    np.savetxt(folder / "odom.csv", np.column_stack([rows, np.zeros(len(truth))]), fmt="%.6f")
    matrices = np.zeros((50, 3, 4))
    matrices[:, :, :3] = Rotation.from_rotvec(
        np.outer(np.arange(50) * 0.01, [0.0, 1.0, 0.0])
    ).as_matrix()
    matrices[:, 2, 3] = np.arange(50)
    np.savetxt(folder / "00.txt", matrices.reshape(50, 12), fmt="%.6e")
    matrices[:, 2, 3] *= 1.01
    np.savetxt(folder / "odometry.txt", matrices.reshape(50, 12), fmt="%.6e")
    shutil.copytree(ROOT / "config", folder / "config")
