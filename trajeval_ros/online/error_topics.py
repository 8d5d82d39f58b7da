"""The topics of an estimate's results below `/evaluator/NAME/`, live and recorded.

The node publishes them during the run; `trajeval evaluate --mcap` writes them afterwards.
docs/topics.md describes their content.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from trajeval_ros.formatting.remarks import Level
from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.metrics.stream_health import StreamHealth
from trajeval_ros.online.pair_errors import PairErrors
from trajeval_ros.online.reports import Snapshot, Update

NODE = "evaluator"
ROBOT = "robot"  # hardware of a status without a namespace
VECTOR_TYPE = "geometry_msgs/msg/Vector3Stamped"
NUMBER_TYPE = "std_msgs/msg/Float64"
ALIGNMENT, ALIGNMENT_TYPE = "alignment", "geometry_msgs/msg/TransformStamped"
ALIGNED_PATH, GROUNDTRUTH_PATH = "aligned_path", "groundtruth_path"
DIAGNOSTICS, DIAGNOSTICS_TYPE = "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"
# As diagnostic_msgs/DiagnosticStatus has them.
# STALE (3) is for aggregators, of statuses that do not arrive.
DIAGNOSTIC_LEVELS = {Level.NOTE: 0, Level.WARNING: 1, Level.ERROR: 2}
ATE = "stamped/ate"  # of the window; see `by_part`
PARTS = ("position", "rotation")  # m and deg
# Of the window's newest pair, live only, by part of the pose.
PROTECTION_LEVELS = {
    "horizontal": "protection_level",
    "vertical": "protection_level_vertical",
    "heading": "protection_level_heading",
}
AVAILABLE_ERROR = "available/stamped/position_error"  # live only, at 100 Hz
NEES_NUMBERS = ("nees", "nees_position", "nees_rotation")  # of the window, live only

# Of every pair, with its timestamp.
VECTORS: Mapping[str, Callable[[PairErrors], Floats | None]] = {
    "stamped/position_error": lambda errors: errors.position,
    "stamped/rotation_error": lambda errors: errors.rotation_vector_deg,
    "stamped/velocity_error": lambda errors: errors.velocity,
    "stamped/attitude_error": lambda errors: errors.attitude_deg,
    "stamped/heading_error": lambda errors: errors.along_cross_vertical,
}
# Of every pair in a recording, of the newest pair live.
NUMBERS: Mapping[str, Callable[[PairErrors], Floats | None]] = {
    "position_error": lambda errors: errors.position_m,
    "rotation_error": lambda errors: errors.rotation_deg,
    "yaw_error": lambda errors: errors.yaw_deg,
    "tilt_error": lambda errors: errors.tilt_deg,
}


def relative_error_topic(length: str) -> str:
    """Return the topic of the relative errors of a length; a topic cannot start with a digit."""
    return f"stamped/relative_error/length_{length.replace('.', '_').replace('%', '_percent')}"


def vectors_of(errors: PairErrors, topic: str, offset_ns: int) -> tuple[Stamps, Floats]:
    """Return stamps (K,) and vectors (K, 3) of the pairs that have such an error."""
    vectors = VECTORS[topic](errors)
    if vectors is None:
        return errors.stamps[:0], np.zeros((0, 3))
    rows = np.flatnonzero(np.isfinite(vectors).all(axis=1))
    return errors.stamps[rows] - offset_ns, vectors[rows]


def by_part(topic: str, position_m: Any, rotation_deg: Any | None) -> dict[str, Floats]:
    """Return N ATE or relative errors as vectors (N, 3) by topic: the number is x.

    One topic is of the position, metres, the other one of the rotation, degrees, which may be
    unavailable (None). No standard message has just a number and a timestamp.
    """
    vectors = {}
    for part, numbers in zip(PARTS, (position_m, rotation_deg), strict=True):
        if numbers is not None:
            column = np.atleast_1d(numbers)[:, None]
            vectors[f"{topic}/{part}"] = np.pad(column, ((0, 0), (0, 2)))
    return vectors


def window_ate(snapshot: Snapshot) -> dict[str, Floats]:
    """Return vectors (1, 3) of the window's ATE by topic; empty without an alignment."""
    rotation = snapshot.ate.get("rotation_deg")
    if snapshot.window_position_rmse_m is None:
        return {}
    return by_part(
        ATE, snapshot.window_position_rmse_m, None if rotation is None else rotation.rmse
    )


def nees_numbers(snapshot: Snapshot) -> dict[str, float | None]:
    """Return the values of `NEES_NUMBERS`; empty without a consistency test."""
    nees = snapshot.nees
    if nees is None:
        return {}
    means = nees.mean, nees.position.mean, nees.rotation.mean
    return dict(zip(NEES_NUMBERS, means, strict=True))


def integrity_numbers(snapshot: Snapshot) -> dict[str, float]:
    """Return the newest protection levels, m and deg; empty if integrity is not configured."""
    integrity = snapshot.integrity
    parts = () if integrity is None else integrity.parts
    return {PROTECTION_LEVELS[part.part]: float(part.levels[-1]) for part in parts}


# Of messages of a topic, live only; by field of `StreamHealth`.
STREAM_NUMBERS = {
    "rate": "rate_hz",
    "jitter": "jitter_s",
    "largest_gap": "largest_gap_s",
    "arrival": "arrival_p95_s",
}


def stream_values(health: StreamHealth, side: str = "") -> dict[str, float | int | None]:
    """Return the health of the messages of a side by name, for a status message."""
    return {
        f"{side}rate [Hz]": health.rate_hz,
        f"{side}jitter [s]": health.jitter_s,
        f"{side}largest gap [s]": health.largest_gap_s,
        f"{side}arrival after stamp, p50 [s]": health.arrival_p50_s,
        f"{side}arrival after stamp, p95 [s]": health.arrival_p95_s,
        f"{side}arrival after stamp, max [s]": health.arrival_max_s,
        f"{side}messages from the future": health.from_future,
    }


def status_values(snapshot: Snapshot, newest: Update) -> dict[str, Any]:
    """Return the values of a status message by name; None if not available."""
    alignment, rotation = snapshot.alignment, snapshot.ate.get("rotation_deg")
    coverage = snapshot.coverage
    return {
        "pairs": snapshot.pairs,
        "window pairs": snapshot.window_pairs,
        "position error [m]": newest.position_m,
        "rotation error [deg]": newest.rotation_deg,
        "ATE position, window [m]": snapshot.window_position_rmse_m,
        "ATE rotation, window [deg]": None if rotation is None else rotation.rmse,
        "ATE position, whole run [m]": snapshot.position_rmse_m,
        "NEES, window": None if snapshot.nees is None else snapshot.nees.mean,
        **{
            f"RE {length}, mean [m]": errors.position_m
            for length, errors in snapshot.relative.items()
            if errors.count
        },
        "alignment": None if alignment is None else f"{alignment.states_used} states",
        "scale": None if alignment is None else alignment.similarity.scale,
        "estimate coverage": snapshot.estimate_coverage,
        "groundtruth coverage": None if coverage is None else coverage.covered,
        "groundtruth from first to last pair": None if coverage is None else coverage.span,
        "longest gap": None
        if coverage is None or coverage.longest_gap is None
        else str(coverage.longest_gap),
    }


def status_texts(values: Mapping[str, Any]) -> dict[str, str]:
    """Return the values of a status message as texts, without those that are None."""
    return {
        name: f"{value:.6g}" if isinstance(value, float) else str(value)
        for name, value in values.items()
        if value is not None
    }
