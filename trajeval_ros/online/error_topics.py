"""What is told about an estimate by topic, below `/evaluator/NAME/`: live and recorded alike.

The node publishes it as it goes, `trajeval evaluate --mcap` writes it at the end. docs/topics.md
says what each topic holds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from trajeval_ros.geometry.arrays import Floats, Stamps
from trajeval_ros.online.pair_errors import PairErrors
from trajeval_ros.online.reports import Snapshot, Update

NODE = "evaluator"
VECTOR_TYPE = "geometry_msgs/msg/Vector3Stamped"
NUMBER_TYPE = "std_msgs/msg/Float64"
ALIGNMENT, ALIGNMENT_TYPE = "alignment", "geometry_msgs/msg/TransformStamped"
ALIGNED_PATH, GROUNDTRUTH_PATH = "aligned_path", "groundtruth_path"
DIAGNOSTICS, DIAGNOSTICS_TYPE = "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"
WINDOW_NUMBERS = ("ate_position", "ate_rotation")
# Of the window's newest pair, live alone: by part of the pose.
PROTECTION_LEVELS = {
    "horizontal": "protection_level",
    "vertical": "protection_level_vertical",
    "heading": "protection_level_heading",
}
NEES_NUMBERS = ("nees", "nees_position", "nees_rotation")  # of the window, live alone

# Of each pair, with its stamp.
VECTORS: Mapping[str, Callable[[PairErrors], Floats | None]] = {
    "stamped/position_error": lambda errors: errors.position,
    "stamped/rotation_error": lambda errors: errors.rotation_vector_deg,
    "stamped/velocity_error": lambda errors: errors.velocity,
    "stamped/attitude_error": lambda errors: errors.attitude_deg,
    "stamped/heading_error": lambda errors: errors.along_cross_vertical,
}
# Of each pair recorded, of the newest one live.
NUMBERS: Mapping[str, Callable[[PairErrors], Floats | None]] = {
    "position_error": lambda errors: errors.position_m,
    "rotation_error": lambda errors: errors.rotation_deg,
    "yaw_error": lambda errors: errors.yaw_deg,
    "tilt_error": lambda errors: errors.tilt_deg,
}
_BY_UP = {"stamped/attitude_error", "stamped/heading_error", "yaw_error", "tilt_error"}


def relative_error_topic(length: str) -> str:
    """Return the topic of the relative errors of a length; no name can begin with a digit."""
    return f"relative_error/length_{length.replace('.', '_').replace('%', '_percent')}"


def vectors_of(
    errors: PairErrors, topic: str, offset_ns: int, *, knows_up: bool
) -> tuple[Stamps, Floats]:
    """Return stamps (K,) and vectors (K, 3) of those of N pairs that have any.

    Args:
        errors: Of the pairs.
        topic: One of `VECTORS`.
        offset_ns: What was added to the estimate's stamps, which are told as they were.
        knows_up: False withholds what depends on the up axis.
    """
    vectors = None if topic in _BY_UP and not knows_up else VECTORS[topic](errors)
    if vectors is None:
        return errors.stamps[:0], np.zeros((0, 3))
    rows = np.flatnonzero(np.isfinite(vectors).all(axis=1))
    return errors.stamps[rows] - offset_ns, vectors[rows]


def numbers_of(errors: PairErrors, topic: str, *, knows_up: bool) -> Floats | None:
    """Return the numbers (N,) of N pairs for one of `NUMBERS`; None if they can't be had."""
    return None if topic in _BY_UP and not knows_up else NUMBERS[topic](errors)


def window_numbers(snapshot: Snapshot) -> dict[str, float | None]:
    """Return the numbers of `WINDOW_NUMBERS`; None for what can't be had."""
    rotation = snapshot.ate.get("rotation_deg")
    found = (snapshot.window_position_rmse_m, None if rotation is None else rotation.rmse)
    return dict(zip(WINDOW_NUMBERS, found, strict=True))


def nees_numbers(snapshot: Snapshot) -> dict[str, float | None]:
    """Return the numbers of `NEES_NUMBERS`; empty where covariances can't be judged."""
    nees = snapshot.nees
    if nees is None:
        return {}
    means = nees.mean, nees.position.mean, nees.rotation.mean
    return dict(zip(NEES_NUMBERS, means, strict=True))


def integrity_numbers(snapshot: Snapshot) -> dict[str, float]:
    """Return the newest protection levels, m and deg; empty where nobody asked for any."""
    found = snapshot.integrity
    parts = () if found is None else found.parts
    return {PROTECTION_LEVELS[each.part]: float(each.levels[-1]) for each in parts}


def status_values(snapshot: Snapshot, newest: Update) -> dict[str, Any]:
    """Return what a status says of an evaluation, by name; None for what can't be had.

    Args:
        snapshot: The evaluation.
        newest: Of its newest pair.
    """
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
    """Return values of a status as texts, without those that are None."""
    return {
        name: f"{value:.6g}" if isinstance(value, float) else str(value)
        for name, value in values.items()
        if value is not None
    }
