"""Listens to the errors of the live node, and prints how old they are.

listen_errors.py SECONDS NAME ...

It begins with the first error of every estimate. The age of a stamped error is its receive time
minus the timestamp of the estimate. The age of the ATE is the time from one to the next.
"""

from __future__ import annotations

import json
import struct
import sys
import time

import numpy as np
import rclpy

from trajeval_ros.online.error_topics import VECTOR_TYPE
from trajeval_ros.ros.subscriptions import TopicInput

STAMP = struct.Struct("<iI")


def main() -> None:
    """Print one JSON object."""
    seconds, names = float(sys.argv[1]), sys.argv[2:]
    rclpy.init()
    node = rclpy.create_node("listener", start_parameter_services=False)
    errors = [
        TopicInput(node, f"/evaluator/{name}/stamped/position_error", [VECTOR_TYPE])
        for name in names
    ]
    ates = [TopicInput(node, f"/evaluator/{name}/stamped/ate", [VECTOR_TYPE]) for name in names]
    ages_s: list[float] = []
    received: list[list[int]] = [[] for _ in names]
    until = None
    while until is None or time.monotonic() < until:
        for error in (*errors, *ates):
            error.match()
        for error in errors:
            taken = error.take()
            for payload, when in zip(taken.payloads, taken.received, strict=True):
                sec, nanosec = STAMP.unpack_from(payload, 4)
                ages_s.append(1e-9 * (when - sec * 10**9 - nanosec))
        for times, ate in zip(received, ates, strict=True):
            times += ate.take().received
        if until is None and all(received):
            ages_s, received = [], [item[-1:] for item in received]
            until = time.monotonic() + seconds
        time.sleep(0.02)
    now = time.time_ns()
    periods_s = [1e-9 * np.diff([*item, now]).max() for item in received]
    p50, p95, most = np.percentile(ages_s, (50, 95, 100))
    result = {"p50_ms": 1e3 * p50, "p95_ms": 1e3 * p95, "max_ms": 1e3 * most}
    print(json.dumps({**result, "errors": len(ages_s), "oldest_ate_s": max(periods_s)}))
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
