"""Help text of `ros2 run trajeval_ros evaluator --help`."""

from __future__ import annotations

from trajeval_ros.ros.parameter_table import PARAMETERS, SERVICES

_LIST = "\n".join(
    f"* `{parameter.name}` "
    f"({parameter.default if parameter.default not in ('', ['']) else 'empty'}): "
    f"{parameter.description}{' Can be set during the run.' if parameter.is_live else ''}"
    for parameter in PARAMETERS
)
HELP = f"""Evaluates estimates against groundtruth, live on the robot.

All settings are ROS parameters:

    ros2 run trajeval_ros evaluator --ros-args \\
        -p groundtruth_topic:=/mocap/pose \\
        -p estimate_topics:=[/vio/odometry,/slam/path] \\
        -p modality:=stereo-inertial

    ros2 run trajeval_ros evaluator --ros-args \\
        --params-file evaluator.yaml -r /odom:=/vio/odometry

Parameters and defaults:

{_LIST}

The node publishes errors, the alignment and aligned paths in `~/ESTIMATE/`, and `/diagnostics`.
Its services are {", ".join(f"`{name}`" for name in SERVICES)}. It writes states,
result.json, errors.npz and figures to the output folder. Stop it with Ctrl-C. After a crash, run
`trajeval finish FOLDER`.
"""
