"""What a small evaluation imports: scipy alone would take longer than all the rest."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from strategies import make_pair

from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.io.bags.write_bag import ODOMETRY, write_bag

ROOT = Path(__file__).resolve().parent.parent


def write_tum(path: Path, trajectory: Trajectory) -> Path:
    columns = [trajectory.stamps * 1e-9, trajectory.positions, trajectory.quaternions]
    np.savetxt(path, np.column_stack(columns), fmt="%.9f")
    return path


def write_kitti(path: Path, trajectory: Trajectory) -> Path:
    assert trajectory.rotations is not None
    matrices = np.dstack([trajectory.rotations.as_matrix(), trajectory.positions])
    np.savetxt(path, matrices.reshape(-1, 12))
    return path


@pytest.mark.parametrize(
    ("files", "options"),
    [
        ("tum", ["--modality", "stereo-inertial"]),
        ("tum", ["--modality", "mono"]),
        ("tum", ["--gauge", "yaw", "--align-states", "1", "--ate-form", "tutorial"]),
        ("tum", ["--protocol", "rpg", "--gauge", "se3"]),
        ("tum", ["--protocol", "evo", "--gauge", "se3"]),
        ("kitti", ["--protocol", "kitti"]),
        ("bag", ["--gauge", "planar"]),
    ],
)
def test_a_plain_evaluation_never_imports_scipy(
    files: str, options: list[str], tmp_path: Path
) -> None:
    pair = make_pair(5, 400, smooth=True)
    if files == "bag":
        topics = {"/truth": (pair.groundtruth, ODOMETRY), "/odom": (pair.estimate, ODOMETRY)}
        write_bag(tmp_path / "bag", topics)
        sources = [f"{tmp_path / 'bag'}:/truth", f"{tmp_path / 'bag'}:/odom"]
    elif files == "kitti":
        truth, estimate = pair.groundtruth[1:-1:2], pair.estimate
        sources = [
            str(write_kitti(tmp_path / f"{name}.txt", each))
            for name, each in (("truth", truth), ("estimate", estimate))
        ]
    else:
        sources = [
            str(write_tum(tmp_path / f"{name}.txt", each))
            for name, each in (("truth", pair.groundtruth), ("estimate", pair.estimate))
        ]
    arguments = ["evaluate", "-g", sources[0], "-e", sources[1], *options]
    arguments += ["--json", str(tmp_path / "result.json")]
    code = (
        "import sys; from trajeval_ros.cli.app import main; "
        f"status = main({arguments!r}); "
        "loaded = {name for name in sys.modules if name.split('.')[0] == 'scipy'}; "
        "sys.exit(', '.join(sorted(loaded)) or status)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
