"""Tests of one side: velocities against positions, and intervals between poses."""

from __future__ import annotations

import numpy as np

from trajeval_ros.diagnosis.evidence import Examined, Seen, Value
from trajeval_ros.diagnosis.motion_track import MotionTrack
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.thinning import evenly
from trajeval_ros.metrics.statistics import median

_RATES = 1500
_FEWEST = 30
_LONGEST_S = 0.6
_SLOW_HZ = 4.0


def velocities(truth: MotionTrack, estimate: MotionTrack) -> Examined:
    """Compare velocities, as read and rotated to the world, with the rate of the positions.

    Args:
        truth: Groundtruth in order of time.
        estimate: Estimate in order of time.
    """
    seen: list[Seen] = []
    scores: dict[str, float] = {}
    for side, track in (("estimate", estimate), ("groundtruth", truth)):
        if track.velocities is None or track.quaternions is None or len(track) < _FEWEST:
            continue
        rows = evenly(len(track) - 2, _RATES) + 1
        time = track.seconds[rows + 1] - track.seconds[rows - 1]
        rows, time = rows[time < _LONGEST_S], time[time < _LONGEST_S]
        if len(rows) < _FEWEST:
            continue
        moving = (track.positions[rows + 1] - track.positions[rows - 1]) / time[:, None]
        total = float(np.sum(moving**2))
        given = track.velocities[rows]
        turned = lie.rotate(track.quaternions[rows], given)
        if not total > 0.0:
            continue
        as_world = float(np.sum((given - moving) ** 2)) / total
        as_body = float(np.sum((turned - moving) ** 2)) / total
        scores |= {f"{side} as world": as_world, f"{side} as body": as_body}
        if as_world > 0.25 and as_body < 0.2 * as_world and as_body < 0.1:
            values: dict[str, Value] = {
                "side": side,
                "off_percent": 100.0 * np.sqrt(as_world),
                "turned_percent": 100.0 * np.sqrt(as_body),
            }
            seen.append(Seen("twist_body", 1.0 - as_body / as_world, values))
    why_not = "" if scores else "no side has both velocities and orientations"
    return Examined("velocities", scores, tuple(seen), why_not)


def rhythm(truth: MotionTrack, estimate: MotionTrack) -> Examined:
    """Test whether the estimate has only keyframes: few, at irregular times.

    Args:
        truth: Groundtruth in order of time.
        estimate: Estimate in order of time.
    """
    if len(estimate) < 6:
        return Examined("keyframes", why_not="too few poses")
    rate_hz = (len(estimate) - 1) / max(estimate.span_s, 1e-9)
    if rate_hz >= _SLOW_HZ:
        return Examined("keyframes", {"rate_hz": rate_hz})
    steps_s = np.diff(estimate.seconds)
    usual_s = median(steps_s)
    low, high = np.quantile(steps_s, [0.1, 0.9])
    spread = float(high - low) / usual_s
    scores = {"rate_hz": rate_hz, "spread": spread}
    if spread > 0.5 and usual_s > 4.0 * truth.usual_step_s:
        return Examined("keyframes", scores, (Seen("keyframes", 0.0, {"rate_hz": rate_hz}),))
    return Examined("keyframes", scores)
