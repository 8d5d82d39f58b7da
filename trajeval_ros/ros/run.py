"""`ros2 run trajeval_ros evaluator`: from start to finish."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from trajeval_ros.ros import parameters
from trajeval_ros.ros.lifetime import StopSignal, ros
from trajeval_ros.ros.message_types import require_ros
from trajeval_ros.ros.node_log import log
from trajeval_ros.viewer.stream import give_way

if TYPE_CHECKING:
    from rclpy.node import Node

    from trajeval_ros.ros.node import EvaluatorNode
    from trajeval_ros.ros.watch_node import WatchNode

# Period of serving services and the simulated clock. An executor rebuilds its wait set for every
# event. At the rate of /clock, this takes longer than the evaluation.
_SERVE_EVERY_S = 0.1
_REPORT_EVERY_S = 0.5
_TELL_EVERY_S = 1.0


class PeriodicTask:
    """Periodic work."""

    def __init__(self, do: Callable[[], object], period_s: Callable[[], float]) -> None:
        """Create it.

        Args:
            do: The work.
            period_s: Returns the time until the next call, seconds.
        """
        self.next_at = time.monotonic()
        self._do, self._period_s = do, period_s

    def do_if_due(self, now: float) -> None:
        """Do it if it is due; missed periods are not repeated."""
        if now >= self.next_at:
            self._do()
            self.next_at = max(self.next_at + self._period_s(), now)


def evaluate_live(arguments: Sequence[str]) -> int:
    """Run the evaluator until SIGINT, SIGTERM or SIGHUP; returns the exit status.

    Args:
        arguments: ROS arguments, from `--ros-args` on.

    Raises:
        SettingsError: ROS rejects the arguments, or a parameter is invalid.
        InputError: ROS can't be imported, or the output folder can't be made.
    """
    require_ros()
    with ros(arguments) as stop:
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node

        node = Node("evaluator")
        work = _evaluator_or_watch(node)
        give_way()
        executor = SingleThreadedExecutor()  # other executors ignore callback groups
        executor.add_node(node)
        duties = [
            PeriodicTask(work.tick, lambda: work.tick_period_s),
            PeriodicTask(work.report, lambda: _REPORT_EVERY_S),
            PeriodicTask(work.tell, lambda: _TELL_EVERY_S),
            PeriodicTask(lambda: executor.spin_once(timeout_sec=0.0), lambda: _SERVE_EVERY_S),
        ]
        try:
            _work(duties, stop)
        finally:  # results are written also after an exception
            executor.shutdown()
            written = work.finish()
            node.destroy_node()
    return 0 if written else 2


def _evaluator_or_watch(node: Node) -> EvaluatorNode | WatchNode:
    """Return the evaluator, or the watch if there is no groundtruth topic."""
    values = parameters.declare(node)
    for each in parameters.about_unknown(node):
        log(node, each, warn=True)
    if values["groundtruth_topic"]:
        from trajeval_ros.ros.node import EvaluatorNode

        return EvaluatorNode(node, values)
    from trajeval_ros.ros.watch_node import WatchNode

    return WatchNode(node, values)


def _work(duties: Sequence[PeriodicTask], stop: StopSignal) -> None:
    while not stop.is_asked_for:
        for each in duties:
            each.do_if_due(time.monotonic())
        time.sleep(max(0.0, min(each.next_at for each in duties) - time.monotonic()))
