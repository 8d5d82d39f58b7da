"""`ros2 run trajeval_ros evaluator`: from start to finish."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from trajeval_ros.exceptions import SettingsError
from trajeval_ros.formatting.remarks import Level
from trajeval_ros.ros import parameters
from trajeval_ros.ros.lifetime import StopSignal, ros, use_one_heap
from trajeval_ros.ros.message_types import require_ros
from trajeval_ros.ros.status_topics import log
from trajeval_ros.viewer.stream import lower_priority

if TYPE_CHECKING:
    from rclpy.node import Node

    from trajeval_ros.ros.node import EvaluatorNode
    from trajeval_ros.ros.watching import WatchNode

# Period of serving services and the simulated clock. An executor rebuilds its wait set for every
# event. At the rate of /clock, this takes longer than the evaluation.
_SERVE_EVERY_S = 0.1
# Numbers of the window, paths and alarms are at most 0.5 s old; 0.1 s are for busy machines.
_REPORT_EVERY_S = 0.4
_REPORTS_SHARE = (
    0.1  # the cost is proportional to estimates and window, which may be the whole run
)
_SAVE_EVERY_S = 1.0


class PeriodicTask:
    """Periodic work, within a share of a core.

    Its cost is CPU time: on a busy machine the work takes longer, and is not done less often.
    """

    def __init__(
        self, do: Callable[[], object], period_s: Callable[[], float], most_share: float = 1.0
    ) -> None:
        self.next_at = time.monotonic()
        self._do, self._period_s, self._share = do, period_s, most_share

    def do_if_due(self, now: float) -> None:
        """Do it if it is due; missed periods are not repeated."""
        if now < self.next_at:
            return
        begin_s = time.thread_time()
        self._do()
        least_s = (time.thread_time() - begin_s) / self._share
        self.next_at = max(self.next_at + max(self._period_s(), least_s), now)


def evaluate_live(arguments: Sequence[str]) -> int:
    """Run the evaluator until SIGINT, SIGTERM or SIGHUP; returns the exit status."""
    require_ros()
    use_one_heap()
    with ros(arguments) as stop:
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node

        try:
            node = Node("evaluator")
        except Exception as error:  # rclpy's exceptions here have no common base class
            reason = " ".join(str(error).split())
            raise SettingsError(
                f"the node can't start: {reason}; use_sim_time must be true or false"
            ) from error
        work = _evaluator_or_watch(node)
        lower_priority()
        executor = SingleThreadedExecutor()  # other executors ignore callback groups
        executor.add_node(node)
        duties = [
            PeriodicTask(work.tick, lambda: work.tick_period_s),
            PeriodicTask(work.report, lambda: _REPORT_EVERY_S, _REPORTS_SHARE),
            PeriodicTask(work.publish_status, lambda: _REPORT_EVERY_S),
            PeriodicTask(work.save, lambda: _SAVE_EVERY_S),
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
    values = parameters.declare(node)
    for item in parameters.about_unknown(node):
        log(node, item, Level.WARNING)
    if values["groundtruth_topic"]:
        from trajeval_ros.ros.node import EvaluatorNode

        return EvaluatorNode(node, values)
    from trajeval_ros.ros.watching import WatchNode

    return WatchNode(node, values)


def _work(duties: Sequence[PeriodicTask], stop: StopSignal) -> None:
    while not stop.is_asked_for:
        for duty in duties:
            duty.do_if_due(time.monotonic())
        time.sleep(max(0.0, min(duty.next_at for duty in duties) - time.monotonic()))
