"""The gallery: figures, with the commands that made them, drawn again for each build."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import textwrap
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Picture:
    """A figure of the gallery.

    Attributes:
        title: Its heading.
        text: What it shows.
        command: The command that draws it, after those of the pictures before it.
        file: The figure, in the folder in which the commands run.
    """

    title: str
    text: str
    command: str
    file: str


PREPARE = (
    "trajeval simulate flight",
    "trajeval trajectory flight:/groundtruth/pose --end 45 --save-as tum --output before",
    "trajeval trajectory flight:/groundtruth/pose --start 48 --save-as tum --output after",
    "trajeval trajectory before/groundtruth_pose.txt after/groundtruth_pose.txt --merge --rate 2 "
    "--save-as tum --output slow",
    "trajeval simulate covariances --profile euroc --duration 60",
    "trajeval simulate drive --gnss rtk --duration 300",
)
_PAIR = "-g flight:/groundtruth/pose -e flight:/vio/odometry --modality stereo-inertial"
_EVALUATE = f"trajeval evaluate {_PAIR} --output result"
_COVARIANCES = (
    "trajeval evaluate -g covariances:/groundtruth/pose -e covariances:/vio/odometry "
    "--modality stereo-inertial --covariance covariances.npz --output consistency"
)
_TRAJECTORY = (
    "trajeval trajectory flight:/vio/odometry --reference flight:/groundtruth/pose --gauge yaw "
)
_GNSS = (
    "trajeval evaluate -g drive:/fix -e drive:/vio/odometry --modality stereo-inertial "
    "--lever-arm 0.4,0.2,1 --max-fix-sigma 0.05 --output gnss"
)
_INTEGRITY = (
    "trajeval evaluate -g covariances:/groundtruth/pose -e covariances:/vio/odometry --gauge yaw "
    "--align-states 1 --covariance message --alert-limit 0.5 --output integrity"
)
_CONTINUOUS = (
    "trajeval evaluate -g slow/before_groundtruth_pose.txt -e flight:/vio/odometry --modality "
    "stereo-inertial --association continuous --groundtruth-noise 0.02,1 --output uncertain"
)
PICTURES = (
    Picture("From above", "Both trajectories after alignment.", _EVALUATE,
            "result/trajectory_top.png"),
    Picture("From the side", "The same trajectories from the side.", _EVALUATE,
            "result/trajectory_side.png"),
    Picture("Errors over time", "Position and rotation error of every pair.", _EVALUATE,
            "result/absolute_error.png"),
    Picture("Relative errors", "Errors by length of the sub-trajectories.", _EVALUATE,
            "result/relative_error.png"),
    Picture("Path coloured by error", "The position error along the path.",
            f"{_TRAJECTORY}--plot xy --colour-by error --output coloured", "coloured/path_xy.png"),
    Picture("Three dimensions", "Both trajectories in 3-D.",
            f"{_TRAJECTORY}--plot 3d --output three", "three/path_3d.png"),
    Picture("Positions over time", "x, y and z of both trajectories.",
            f"{_TRAJECTORY}--plot xyz --output positions", "positions/xyz_over_time.png"),
    Picture("Angles over time", "Roll, pitch and yaw of both trajectories.",
            f"{_TRAJECTORY}--plot rpy --output angles", "angles/rpy_over_time.png"),
    Picture("Speed over time", "Mean speed between consecutive poses.",
            f"{_TRAJECTORY}--plot speed --output speed", "speed/speed_over_time.png"),
    Picture("Consistency", "Errors with their 3-sigma bands, and NEES.", _COVARIANCES,
            "consistency/consistency.png"),
    Picture("Uncertainty from above", "Covariance ellipses along the flight.", _COVARIANCES,
            "consistency/uncertainty_top.png"),
    Picture("Stanford diagram", "Protection levels and errors.", _INTEGRITY,
            "integrity/stanford.png"),
    Picture("Slow groundtruth", "Groundtruth at 2 Hz with a dropout, and its uncertainty.",
            _CONTINUOUS, "uncertain/groundtruth_uncertainty.png"),
    Picture("GNSS groundtruth", "A car with RTK fixes as groundtruth.", _GNSS,
            "gnss/trajectory_top.png"),
)  # fmt: skip

_WIDTH = 76  # of a line on the page
# A screenshot needs ROS 2 and a Vulkan driver, so it is the picture of README.
_RERUN = """
### A live run

A live run in Rerun's viewer. The command writes the screenshot to `demo_output/rerun.png`.

```console
$ trajeval demo demo_output
```

![A live run in Rerun: the estimate coloured by its position error](images/rerun.png)
"""


def draw(folder: Path) -> dict[str, bytes]:
    """Run all commands in a folder, and return the figures by their names on the page."""
    for command in dict.fromkeys([*PREPARE, *(picture.command for picture in PICTURES)]):
        program, *arguments = shlex.split(command)
        assert program == "trajeval"
        done = subprocess.run(
            [sys.executable, "-m", "trajeval_ros", *arguments],
            cwd=folder,
            env={**os.environ, "MPLBACKEND": "agg"},
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode != 0:
            raise RuntimeError(f"{command}\n{done.stdout}{done.stderr}")
    return {picture.file: (folder / picture.file).read_bytes() for picture in PICTURES}


def section() -> str:
    """Return the section of docs/figures.md that shows the figures of `draw`."""
    prepare = "\n".join(f"$ {_broken(item)}" for item in PREPARE)
    lines = [
        "## Gallery",
        "",
        "Figures with the commands that made them. The commands simulate all data. The first ones",
        "write the bags, and groundtruth at 2 Hz with a dropout of 3 s:",
        "",
        f"```console\n{prepare}\n```",
    ]
    for picture in PICTURES:
        lines += ["", f"### {picture.title}", "", picture.text, ""]
        lines += [f"```console\n$ {_broken(picture.command)}\n```"]
        lines += ["", f"![{picture.text}](gallery/{picture.file})"]
    return "\n".join([*lines, _RERUN])


def _broken(command: str) -> str:
    """Return a command in lines that fit on the page, which start with an option."""
    glued = re.sub(r" (?!-)", "\0", command)
    lines = textwrap.wrap(glued, _WIDTH, break_long_words=False, break_on_hyphens=False)
    return " \\\n      ".join(lines).replace("\0", " ")
