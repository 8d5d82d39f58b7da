"""`ros2 run trajeval_ros evaluator` on machines with only the ROS packages.

Ubuntu's package of typer is too old or missing. This program does not import typer, because it has
only ROS arguments and `--help`.
"""

from __future__ import annotations

from collections.abc import Sequence

from trajeval_ros.cli.exit_status import exit_status
from trajeval_ros.exceptions import SettingsError

_ROS_ARGUMENTS = "--ros-args"


def evaluator_main(arguments: Sequence[str]) -> int:
    """Run the live evaluator and return its exit status."""
    return exit_status(lambda: _run(arguments))


def split_ros_arguments(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the arguments before `--ros-args`, and the ROS arguments from there on."""
    words = list(arguments)
    cut = words.index(_ROS_ARGUMENTS) if _ROS_ARGUMENTS in words else len(words)
    return words[:cut], words[cut:]


def _run(arguments: Sequence[str]) -> int:
    from trajeval_ros.ros.evaluator_help import HELP
    from trajeval_ros.ros.run import evaluate_live

    words, ros_arguments = split_ros_arguments(arguments)
    if words in (["--help"], ["-h"]):
        print(HELP)
        return 0
    if words:
        raise SettingsError(
            f"evaluator: unknown argument {' '.join(words)}; give all settings as ROS parameters, "
            "as in --ros-args -p groundtruth_topic:=/mocap/pose (see evaluator --help)"
        )
    return evaluate_live(ros_arguments)
