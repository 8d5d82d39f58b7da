"""Signals of two estimates of one robot: relative motions, independent of gauge and body frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trajeval_ros.calibration.hand_eye import closest_rotation
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices
from trajeval_ros.watchdog.recent import (
    POSE_WIDTH,
    POSITION,
    QUATERNION,
    SINCE,
    TIME,
    Recent,
    interpolated,
    lengths,
    only,
    window_begins,
)
from trajeval_ros.watchdog.rotations_over_time import angles_deg, between, slerp_at
from trajeval_ros.watchdog.signals import PAIR, WINDOWS_S, Signals, finite, source_words
from trajeval_ros.watchdog.turning_axis import only_axis

_CALIBRATION_S = 2.0
_PASSES = 10
_TRIM = 4.0  # residuals above this multiple of their median are outliers
_LEAST_M, _LEAST_RAD = 1e-3, 1e-3
# Without rotation the lever arm is not observable: least median angle in 2 s, rad.
_LEAST_TURN = 0.1
_FEWEST = 20
_SCALE_S = 10.0
_OTHER_POSITION, _OTHER_QUATERNION = slice(9, 12), slice(12, 16)
_PATH, _OTHER_PATH = 16, 17
_WIDTH = 18


@dataclass(frozen=True)
class BodyDifference:
    """The pose of the second estimate's body in the body of the estimate, and its scale.

    Attributes:
        rotation: Rotation from the axes of the second body to the axes of the body (4,), xyzw.
        lever_m: Origin of the second body in the body (3,), metres.
        scale: Metres of the estimate per metre of the second estimate.
    """

    rotation: Floats
    lever_m: Floats
    scale: float


class PairSignals:
    """Compares relative motions of an estimate and its partner.

    Attributes:
        notices: Findings at the start, one sentence each.
        usable: Whether the two can be compared.
    """

    def __init__(self, source: str, period_s: float, armed_s: float) -> None:
        """Create it; the body difference is estimated once the partner reaches the arming.

        Args:
            source: The second estimate, `pair` or `pair.NAME`; NAME is appended to signals.
            period_s: Usual time between states of the estimate.
            armed_s: Time of arming; later data are not used for the body difference.
        """
        self._source, self._suffix = source, source.removeprefix(PAIR)
        self.notices: list[str] = []
        self.usable = True
        self._armed_s = armed_s
        self._least_path_m = _SCALE_S / period_s * 0.05
        self._body: BodyDifference | None = None
        self._states = Recent(POSE_WIDTH)
        self._partner = Recent(POSE_WIDTH)
        self._rows = Recent(_WIDTH)
        self._done = -np.inf

    def add_partner(self, rows: Floats) -> Signals:
        """Add states of the partner (N, 9); return the signals at states that it covers."""
        if not self.usable:
            return {}
        self._partner.remember(rows)
        return self._advance()

    def add(self, rows: Floats) -> Signals:
        """Add states (N, 9 or more); return the signals at states that the partner covers."""
        if not self.usable:
            return {}
        self._states.remember(rows[:, :POSE_WIDTH])
        return self._advance()

    def _advance(self) -> Signals:
        states, partner = self._states.rows, self._partner.rows
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
        self._partner.forget(self._done - 60.0)
        if self._body is None:
            if self._done < self._armed_s:
                return {}
            old = 0
            if not self._find_body():
                return {}
        self._add_paths(old)
        signals = self._signals(old)
        self._rows.forget(self._done - WINDOWS_S[-1] - 2.0 * _SCALE_S)
        return signals

    def _find_body(self) -> bool:
        """Estimate the body difference from the data before arming; return whether it worked."""
        rows = self._rows.rows
        rows = rows[rows[:, TIME] < self._armed_s]
        if len(rows) >= _FEWEST:
            begins, known = window_begins(rows, 0, _CALIBRATION_S)
            ends = np.flatnonzero(known)
            if len(ends) >= _FEWEST:
                self._body = body_difference(*_motions(rows, begins[ends], ends))
                return True
        self.usable = False
        self.notices.append(
            f"too little data of the {source_words(self._source)} during the motion before "
            "arming: it is not compared"
        )
        return False

    def _add_paths(self, first: int) -> None:
        """Fill in the running sums of the displacements in 1 s of both, for the scale signal."""
        rows = self._rows.rows
        assert self._body is not None
        begins, known = window_begins(rows, first, 1.0)
        for column, position, scale in (
            (_PATH, POSITION, 1.0),
            (_OTHER_PATH, _OTHER_POSITION, self._body.scale),
        ):
            chords = lengths(rows[first:, position] - rows[begins, position])
            before = rows[first - 1, column] if first else 0.0
            rows[first:, column] = before + scale * np.cumsum(np.where(known, chords, 0.0))

    def _signals(self, first: int) -> Signals:
        rows, body = self._rows.rows, self._body
        assert body is not None
        times = rows[first:, TIME]
        signals = {}
        for window_s in WINDOWS_S:
            begins, known = window_begins(rows, first, window_s)
            turn, step, other_turn, other_step = _motions(
                rows, begins, np.arange(first, len(rows))
            )
            angle = np.degrees(np.abs(lie.angle(turn) - lie.angle(other_turn)))
            expected = lie.multiply(
                lie.multiply(body.rotation, other_turn), lie.conjugate(body.rotation)
            )
            moved = body.scale * lie.rotate(body.rotation, other_step) + body.lever_m
            moved -= lie.rotate(turn, np.broadcast_to(body.lever_m, moved.shape))
            for stem, values in (
                ("pair_m", lengths(step - moved)),
                ("pair_deg", angles_deg(between(expected, turn))),
                ("pair_angle_deg", angle),
            ):
                signals[f"{stem}_{window_s:g}s{self._suffix}"] = finite(times, only(values, known))
        begins, known = window_begins(rows, first, _SCALE_S)
        own, other = (rows[first:, each] - rows[begins, each] for each in (_PATH, _OTHER_PATH))
        enough = np.minimum(own, other) > self._least_path_m
        ratio = np.abs(np.log(np.maximum(own, 1e-9) / np.maximum(other, 1e-9)))
        signals[f"pair_scale{self._suffix}"] = finite(
            times, only(np.where(enough, ratio, 0.0), known)
        )
        return signals


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
    rows[:, _OTHER_POSITION] = interpolated(partner[:, TIME], partner[:, POSITION], times)
    rows[:, _OTHER_QUATERNION] = slerp_at(partner[:, TIME], partner[:, QUATERNION], times)
    return rows


def _motions(rows: Floats, begins: Indices, ends: Indices) -> tuple[Floats, ...]:
    """Return rotations (N, 4) and displacements (N, 3) of both estimates, in the first body.

    The first body is the body frame at the start of the motion.
    """
    found = []
    for position, quaternion in (
        (POSITION, QUATERNION),
        (_OTHER_POSITION, _OTHER_QUATERNION),
    ):
        start = rows[begins, quaternion]
        found.append(between(start, rows[ends, quaternion]))
        moved = rows[ends, position] - rows[begins, position]
        found.append(lie.rotate(lie.conjugate(start), moved))
    return tuple(found)


def body_difference(
    turns: Floats, steps: Floats, other_turns: Floats, other_steps: Floats
) -> BodyDifference:
    """Estimate the body difference from relative motions, by trimmed least squares.

    Rotations determine the rotation X between the bodies: A X = X B. Displacements determine the
    lever arm l and the scale s: t_A = s X t_B + (I - R_A) l. If the robot rotates about only one
    axis, displacements also determine X about this axis.

    Args:
        turns: Rotations A of the estimate, (N, 4), xyzw.
        steps: Displacements t_A of the estimate, (N, 3), metres.
        other_turns: Rotations B of the second estimate, (N, 4), xyzw.
        other_steps: Displacements t_B of the second estimate, (N, 3), in its scale.
    """
    a, b = lie.rotation_vector(turns), lie.rotation_vector(other_turns)
    left = np.eye(3) - lie.to_matrix(turns)
    # Angles do not depend on the body difference. If they differ, one of the two is an outlier.
    off_angle = np.abs(lengths(a) - lengths(b))
    kept: Booleans = off_angle < _TRIM * np.median(off_angle) + _LEAST_RAD
    sees_lever = float(np.median(lengths(a))) > _LEAST_TURN
    one_axis = only_axis(a[kept], b[kept]) is not None
    rotation, lever, scale = np.eye(3), np.zeros(3), 1.0
    for _ in range(_PASSES):
        targets, vectors = a[kept], b[kept]
        if one_axis:
            # Metres and radians have equal weights: only displacements determine the rotation
            # about the axis.
            moved = steps - left @ lever
            targets = np.concatenate([targets, moved[kept]])
            vectors = np.concatenate([vectors, scale * other_steps[kept]])
        rotation = closest_rotation(targets, vectors)
        along = other_steps @ rotation.T
        design = np.concatenate([left if sees_lever else 0.0 * left, along[:, :, None]], axis=2)
        solution = np.linalg.lstsq(
            design[kept].reshape(-1, 4), steps[kept].reshape(-1), rcond=1e-3
        )[0]
        lever, scale = solution[:3], float(solution[3])
        off = lengths(steps - design @ solution)
        off_turn = lengths(a - b @ rotation.T)
        kept = (off < _TRIM * np.median(off) + _LEAST_M) & (
            off_turn < _TRIM * np.median(off_turn) + _LEAST_RAD
        )
    return BodyDifference(lie.from_matrix(rotation), lever, scale)
