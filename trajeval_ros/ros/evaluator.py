"""`ros2 run trajeval_ros evaluator`: from start to finish."""

from __future__ import annotations

from collections.abc import Sequence

from trajeval_ros.ros.lifetime import ros

_LOOK_EVERY_S = 0.1


def evaluate_live(arguments: Sequence[str]) -> int:
    """Run the evaluator until SIGINT or SIGTERM; returns the exit status.

    Args:
        arguments: ROS arguments, from `--ros-args` on.

    Raises:
        SettingsError: ROS doesn't take the arguments, or a parameter means nothing.
        InputError: The output folder can't be made.
    """
    with ros(arguments) as stop:
        from rclpy.executors import SingleThreadedExecutor

        from trajeval_ros.ros.node import EvaluatorNode

        node = EvaluatorNode()
        executor = SingleThreadedExecutor()  # the other executors pass over callback groups
        executor.add_node(node)
        while not stop.is_asked_for:
            executor.spin_once(timeout_sec=_LOOK_EVERY_S)
        executor.shutdown()
        written = node.finish()
        node.destroy_node()
    return 0 if written else 2
