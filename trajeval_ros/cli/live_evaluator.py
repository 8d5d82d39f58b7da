"""`ros2 run trajeval_ros evaluator`: the live evaluator's command line."""

from __future__ import annotations

import typer

from trajeval_ros.ros.parameters import PARAMETERS

_LIST = "\n".join(
    f"* `{each.name}` ({each.default if each.default not in ('', ['']) else 'empty'}): "
    f"{each.description}{' May be set while it runs.' if each.is_live else ''}"
    for each in PARAMETERS
)
HELP = f"""Evaluate estimates against groundtruth while the robot moves.

All settings are ROS parameters:

    ros2 run trajeval_ros evaluator --ros-args -p groundtruth_topic:=/mocap/pose
        -p estimate_topics:=[/vio/odometry,/slam/path] -p modality:=stereo-inertial

    ros2 run trajeval_ros evaluator --ros-args --params-file evaluator.yaml -r /odom:=/vio/odometry

Parameters, with their defaults:

{_LIST}

It publishes errors, the alignment and aligned paths under `~/ESTIMATE/`, and `/diagnostics`. It
answers `~/save` and `~/reset`. It leaves pairs, result.json, errors.npz and figures in the output
folder. Ctrl-C ends it in order. After a crash, `trajeval finish FOLDER` evaluates what it left.
"""


def evaluator(context: typer.Context) -> None:
    """Run the node; the help is `HELP`."""
    from trajeval_ros.ros.message_types import require_ros
    from trajeval_ros.ros.run import evaluate_live

    require_ros()
    status = evaluate_live(context.obj or ())
    if status:
        raise typer.Exit(status)
