"""Listens to the errors of the live node, and prints how old they are.

listen_errors.py SECONDS NAME ...

It begins with the first error of every estimate. The age of a stamped error is its reception minus
the timestamp of the estimate. The age of the ATE is the time from one to the next.
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
        TopicInput(node, f"/evaluator/{each}/stamped/position_error", [VECTOR_TYPE])
        for each in names
    ]
    ates = [TopicInput(node, f"/evaluator/{each}/stamped/ate", [VECTOR_TYPE]) for each in names]
    ages_s: list[float] = []
    received: list[list[int]] = [[] for _ in names]
    until = None
    while until is None or time.monotonic() < until:
        for each in (*errors, *ates):
            each.match()
        for each in errors:
            taken = each.take()
            for payload, when in zip(taken.payloads, taken.received, strict=True):
                sec, nanosec = STAMP.unpack_from(payload, 4)
                ages_s.append(1e-9 * (when - sec * 10**9 - nanosec))
        for times, each in zip(received, ates, strict=True):
            times += each.take().received
        if until is None and all(received):
            ages_s, received = [], [each[-1:] for each in received]
            until = time.monotonic() + seconds
        time.sleep(0.02)
    now = time.time_ns()
    periods_s = [1e-9 * np.diff([*each, now]).max() for each in received]
    p50, p95, most = np.percentile(ages_s, (50, 95, 100))
    found = {"p50_ms": 1e3 * p50, "p95_ms": 1e3 * p95, "max_ms": 1e3 * most}
    print(json.dumps({**found, "errors": len(ages_s), "oldest_ate_s": max(periods_s)}))
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
