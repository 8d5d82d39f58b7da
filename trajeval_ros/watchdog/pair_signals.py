"""Signals of two estimates of one robot: relative motions, independent of gauge and body frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.calibration.hand_eye import closest_rotation
from trajeval_ros.geometry import lie, so3
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices, lengths
from trajeval_ros.geometry.interpolation import columns_at, slerp_at
from trajeval_ros.geometry.so3 import skew
from trajeval_ros.watchdog.judging import judged
from trajeval_ros.watchdog.rotations_over_time import between
from trajeval_ros.watchdog.row_buffer import (
    POSE_WIDTH,
    POSITION,
    QUATERNION,
    SINCE,
    TIME,
    Comparison,
    RowBuffer,
    only,
    window_begins,
)
from trajeval_ros.watchdog.signals import PAIR, Signals, finite, source_words

_WINDOWS_S = (5.0, 20.0)
_CALIBRATION_S = 2.0
_PASSES = 10
_TRIM = 4.0  # residuals above this multiple of their median are outliers
_LEAST_M, _LEAST_RAD = 1e-3, 1e-3
# Standard deviations of the prior: a lever arm on a robot, and any scale within a few octaves.
_LEVER_M, _LOG_SCALE = 0.5, 1.0
_MEDIAN_LENGTH = 1.538  # of a normal vector of three components with unit standard deviation
_MOST_LOG_STEP = 0.5
_FEWEST = 20
_SPEED_S = 1.0
_OTHER_POSITION, _OTHER_QUATERNION, _PATH = slice(9, 12), slice(12, 16), 16
_WIDTH = 17


@dataclass(frozen=True, eq=False)
class BodyDifference:
    """The pose of the second estimate's body in the body of the estimate, and its scale."""

    # Rotation from the axes of the second body to the axes of the body (4,), xyzw.
    rotation: Floats
    lever_m: Floats  # origin of the second body in the body (3,), metres
    scale: float  # metres of the estimate per metre of the second estimate
    # (7, 7), covariance of rotation (rad, in the body), lever arm and log scale
    covariance: Floats


class PairSignals(Comparison):
    """Compares relative motions of an estimate and its partner."""

    def __init__(self, source: str, period_s: float, armed_s: float) -> None:
        """Create it; data until `armed_s` determine the body difference.

        `source` is `pair` or `pair.NAME`, and NAME is appended to signals. `period_s` is the usual
        time between states of the estimate.
        """
        super().__init__(POSE_WIDTH)
        self._source, self._suffix = source, source.removeprefix(PAIR)
        self._armed_s, self._period_s = armed_s, period_s
        self._body: BodyDifference | None = None
        self._rows = RowBuffer(_WIDTH)
        self._done = -np.inf

    def _advance(self) -> Signals:
        states, partner = self._states.rows, self._other.rows
        if not len(states) or len(partner) < 2:
            return {}
        first = int(np.searchsorted(states[:, TIME], self._done, side="right"))
        ready = int(np.searchsorted(states[:, TIME], partner[-1, TIME], side="right"))
        if first >= ready:
            return {}
        self._done = float(states[ready - 1, TIME])
        old = len(self._rows.rows)
        self._rows.append(_matched(states[first:ready], partner))
        self._states.forget(self._done)
        self._other.forget(self._done - 60.0)
        if self._body is None:
            if self._done < self._armed_s:
                return {}
            old = 0
            if not self._find_body():
                return {}
        self._add_path(old)
        signals = self._signals(old)
        self._rows.forget(self._done - 2.0 * _WINDOWS_S[-1])
        return signals

    def _find_body(self) -> bool:
        """Estimate the body difference from the data before arming; return whether it worked."""
        rows = self._rows.rows
        rows = rows[rows[:, TIME] < self._armed_s]
        if len(rows) >= _FEWEST:
            begins, known = window_begins(rows, 0, _CALIBRATION_S)
            ends = np.flatnonzero(known)
            if len(ends) >= _FEWEST:
                # Windows of 2 s that end at every state are not independent.
                overlap = self._period_s / _CALIBRATION_S
                self._body = body_difference(*_motions(rows, begins[ends], ends), overlap=overlap)
                return True
        return self._refuse(
            f"too little data of the {source_words(self._source)} during the motion before "
            "arming: it is not compared"
        )

    def _add_path(self, first: int) -> None:
        """Fill in the path length, m, by the second estimate's displacements in 1 s."""
        rows = self._rows.rows
        assert self._body is not None
        begins, known = window_begins(rows, first, _SPEED_S)
        motions = _motions(rows, begins, np.arange(first, len(rows)))
        moved = lengths(_predicted(self._body, *motions)[1])
        before = rows[first - 1, _PATH] if first else 0.0
        share = self._period_s / _SPEED_S
        rows[first:, _PATH] = before + share * np.cumsum(np.where(known, moved, 0.0))

    def _signals(self, first: int) -> Signals:
        rows, body = self._rows.rows, self._body
        assert body is not None
        times, ends = rows[first:, TIME], np.arange(first, len(rows))
        signals = {}
        for window_s in _WINDOWS_S:
            begins, known = window_begins(rows, first, window_s)
            motions = _motions(rows, begins, ends)
            rotation, step = motions[:2]
            expected, moved = _predicted(body, *motions)
            jacobian = _displacement_jacobian(body, rotation, motions[3])
            floor_m, floor_rad = 0.01 + 0.005 * window_s, np.radians(0.1 + 0.02 * window_s)
            off_m = judged(step - moved, jacobian, body.covariance, floor_m)
            path_m = rows[first:, _PATH] - rows[begins, _PATH]
            back = np.swapaxes(lie.to_matrix(expected), 1, 2) - np.eye(3)
            off_turn = lie.rotation_vector(between(expected, rotation))
            off_rad = judged(off_turn, back, body.covariance[:3, :3], floor_rad)
            for stem, values in (
                ("pair_percent", 100.0 * off_m / (1.0 + path_m)),
                ("pair_deg", np.degrees(off_rad)),
            ):
                signals[f"{stem}_{window_s:g}s{self._suffix}"] = finite(times, only(values, known))
        return signals


def _predicted(
    body: BodyDifference, turns: Floats, _: Floats, other_turns: Floats, other_steps: Floats
) -> tuple[Floats, Floats]:
    """Return rotations (N, 4) and displacements (N, 3) by the second estimate's motions."""
    expected = lie.multiply(lie.multiply(body.rotation, other_turns), lie.conjugate(body.rotation))
    moved = body.scale * lie.rotate(body.rotation, other_steps) + body.lever_m
    moved -= lie.rotate(turns, np.broadcast_to(body.lever_m, moved.shape))
    return expected, moved


def _displacement_jacobian(body: BodyDifference, turns: Floats, other_steps: Floats) -> Floats:
    """Return the derivatives (N, 3, 7) of predicted displacements by the body difference."""
    along = body.scale * lie.rotate(body.rotation, other_steps)
    left = np.eye(3) - lie.to_matrix(turns)
    return np.concatenate([-skew(along), left, along[:, :, None]], axis=2)


def _matched(states: Floats, partner: Floats) -> Floats:
    """Return states (N, 9) with the partner's interpolated poses, (M, 18), outside its gaps."""
    times = states[:, TIME]
    after = np.searchsorted(partner[:, TIME], times)
    inside = (after > 0) | (times == partner[0, TIME])
    since = np.maximum(states[:, SINCE], partner[np.minimum(after, len(partner) - 1), SINCE])
    kept = inside & (times >= since)
    states, since, times = states[kept], since[kept], times[kept]
    rows = np.zeros((len(states), _WIDTH))
    rows[:, :POSE_WIDTH], rows[:, SINCE] = states, since
    rows[:, _OTHER_POSITION] = columns_at(partner[:, TIME], partner[:, POSITION], times)
    rows[:, _OTHER_QUATERNION] = slerp_at(partner[:, TIME], partner[:, QUATERNION], times)
    return rows


def _motions(
    rows: Floats, begins: Indices, ends: Indices
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return rotations (N, 4) and displacements (N, 3) of both estimates, in the first body.

    The first body is the body frame at the start of the motion.
    """

    def of(position: slice, quaternion: slice) -> tuple[Floats, Floats]:
        start = rows[begins, quaternion]
        moved = rows[ends, position] - rows[begins, position]
        return between(start, rows[ends, quaternion]), lie.rotate(lie.conjugate(start), moved)

    return *of(POSITION, QUATERNION), *of(_OTHER_POSITION, _OTHER_QUATERNION)


def body_difference(
    turns: Floats, steps: Floats, other_turns: Floats, other_steps: Floats, overlap: float = 1.0
) -> BodyDifference:
    """Estimate the body difference and its covariance by one weighted, trimmed least squares.

    Rotations A X = X B and displacements t_A = s X t_B + (I - R_A) l determine rotation X, lever
    arm l and scale s. Both are weighted by the medians of their residuals. A prior covers what the
    motion does not determine. The method is Gauss-Newton. Rotations are (N, 4), xyzw, and
    displacements (N, 3). `overlap` is the number of independent motions divided by N.
    """
    a, b = lie.rotation_vector(turns), lie.rotation_vector(other_turns)
    left = np.eye(3) - lie.to_matrix(turns)
    # Angles do not depend on the body difference. If they differ, one of the two is an outlier.
    off_angle = np.abs(lengths(a) - lengths(b))
    kept: Booleans = off_angle < _TRIM * np.median(off_angle) + _LEAST_RAD
    moved_m, other_m = (float(np.median(lengths(item[kept]))) for item in (steps, other_steps))
    scale = moved_m / max(other_m, 1e-9)
    rotation = closest_rotation(
        np.concatenate([a[kept], steps[kept]]),
        np.concatenate([b[kept], scale * other_steps[kept]]),
    )
    lever, covariance = np.zeros(3), np.eye(7)
    weak = np.diag([1e-9] * 3 + [_LEVER_M**-2] * 3 + [_LOG_SCALE**-2])
    for _ in range(_PASSES):
        rotated, along = b @ rotation.T, scale * other_steps @ rotation.T
        off_turn, off = a - rotated, steps - along - left @ lever
        sizes, turn_sizes = lengths(off), lengths(off_turn)
        kept = (sizes < _TRIM * np.median(sizes) + _LEAST_M) & (
            turn_sizes < _TRIM * np.median(turn_sizes) + _LEAST_RAD
        )
        sigma_rad = max(float(np.median(turn_sizes)) / _MEDIAN_LENGTH, _LEAST_RAD)
        sigma_m = max(float(np.median(sizes)) / _MEDIAN_LENGTH, _LEAST_M)
        by_turn = np.concatenate([-skew(rotated), np.zeros((len(a), 3, 4))], axis=2) / sigma_rad
        by_step = np.concatenate([-skew(along), left, along[:, :, None]], axis=2) / sigma_m
        jacobian = np.concatenate([by_turn, by_step], axis=1)[kept].reshape(-1, 7)
        residual = np.concatenate([off_turn / sigma_rad, off / sigma_m], axis=1)[kept].ravel()
        gradient = overlap * jacobian.T @ residual
        gradient[3:6] -= lever / _LEVER_M**2
        covariance = np.linalg.inv(overlap * jacobian.T @ jacobian + weak)
        step = covariance @ gradient
        rotation = so3.exp(step[:3]) @ rotation
        lever = lever + step[3:6]
        scale *= float(np.exp(np.clip(step[6], -_MOST_LOG_STEP, _MOST_LOG_STEP)))
    return BodyDifference(lie.from_matrix(rotation), lever, scale, covariance)
