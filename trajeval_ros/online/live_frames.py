"""Conversion of live states to the point and the frames of the evaluation, as offline.

Gauge planar projects on the horizontal plane, a lever arm moves the estimate to the groundtruth's
point, and gauges with rotations about gravity only need frames with z up.
"""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry.arrays import Booleans, Floats
from trajeval_ros.geometry.frame_axes import between_own_axes
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis
from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.state_rows import (
    COVARIANCE,
    POSITION,
    QUATERNION,
    VELOCITY,
    WIDTH,
    Pairs,
    on_plane,
    states,
    turned_covariances,
    upright_rows,
)


def body_rows(rows: Floats, hand_eye: HandEye) -> Floats:
    """Return groundtruth states (N, 10) of the body from poses of the marker.

    A state without orientation cannot be converted; its position becomes NaN. Velocities are of
    the marker and are dropped if there is a lever arm.
    """
    moved, oriented = _moved(rows, hand_eye)
    body = hand_eye.of_body(_poses(rows[oriented]))
    moved[oriented, POSITION] = body.positions
    moved[oriented, QUATERNION] = body.quaternions
    return moved


def marker_rows(rows: Floats, hand_eye: HandEye, rotation_frame: str) -> Floats:
    """Return estimated states (N, 10) or (N, 46) with the marker's position, in metres.

    It is for groundtruth without orientations. A state without orientation and velocities are
    treated as in `body_rows`. Covariances become those of the marker's position.
    """
    if rotation_frame == "body":
        moved = marker_rows(turned_covariances(rows), hand_eye, "world")
        return turned_covariances(moved, to_body=True)
    moved, oriented = _moved(rows, hand_eye)
    poses = _poses(rows[oriented])
    if rows.shape[1] > WIDTH:
        covariances = rows[oriented, COVARIANCE].reshape(-1, 6, 6)
        poses = replace(poses, covariances=covariances)
    marker = hand_eye.of_marker(poses, 1.0)
    moved[oriented, POSITION] = marker.positions
    if marker.covariances is not None:
        moved[oriented, COVARIANCE] = marker.covariances.reshape(-1, 36)
    return moved


def _moved(rows: Floats, hand_eye: HandEye) -> tuple[Floats, Booleans]:
    """Return a copy with NaN for what cannot be converted, and the rows with an orientation."""
    moved: Floats = rows.copy()
    oriented: Booleans = np.logical_and.reduce(np.isfinite(rows[:, : QUATERNION.stop]), axis=1)
    moved[np.isnan(rows[:, QUATERNION.start]), POSITION] = np.nan
    if hand_eye.lever_m.any():
        moved[:, VELOCITY] = np.nan
    return moved, oriented


def _poses(rows: Floats) -> Trajectory:
    """Return the poses of rows (N, 10), all with orientations, as a trajectory."""
    stamps = np.zeros(len(rows), dtype=np.int64)
    return Trajectory(stamps, rows[:, POSITION], rows[:, QUATERNION])


class LiveFrames:
    """Converts states (N, 10) or (N, 46) of both sides, whose frames have up axes."""

    def __init__(self, settings: OnlineSettings) -> None:
        self.groundtruth_up = self.estimate_up = Z_UP
        if settings.up is not None:
            self.groundtruth_up, self.estimate_up = map(UpAxis, settings.up)
        self.gauge = settings.protocol.gauge  # the gauge of the alignment
        lever_m = settings.protocol.lever_m
        self._arm = None if lever_m is None else HandEye.of(None, np.array(lever_m))
        self._rotation_frame = settings.covariances.rotation_frame

    @property
    def vertical(self) -> UpAxis:
        """Up axis of the groundtruth in the frames of the evaluation."""
        return Z_UP if self.gauge.turns_about_gravity_only else self.groundtruth_up

    def of_point(self, rows: Floats) -> Floats:
        """Return groundtruth states as positions only, if there is a lever arm.

        They are of a point, also if messages have a constant orientation.
        """
        return rows if self._arm is None else states(rows[:, POSITION])

    def in_plane(self, rows: Floats) -> Floats:
        """Return groundtruth states projected on the horizontal plane, for gauge planar."""
        return on_plane(rows, self.groundtruth_up) if self.gauge is Gauge.PLANAR else rows

    def require_orientations(self, rows: Floats) -> None:
        """Refuse estimated states without orientations if there is a lever arm."""
        if self._arm is not None and np.isnan(rows[:, QUATERNION.start]).any():
            raise InputError(
                "the estimate has no orientations, so no lever arm can be applied to it"
            )

    def of_same_point(self, pairs: Pairs) -> Pairs:
        """Return pairs of the pairing for the groundtruth's point, in the plane if planar.

        The lever arm depends on the orientation at the pair's timestamp. Therefore it is applied
        after the interpolation of the estimate, and before the projection.
        """
        estimate = pairs.estimate
        if self._arm is not None:
            estimate = marker_rows(estimate, self._arm, self._rotation_frame)
        if self.gauge is Gauge.PLANAR:
            estimate = on_plane(estimate, self.estimate_up)
        return pairs._replace(estimate=estimate)

    def upright(self, pairs: Pairs) -> Pairs:
        """Return pairs in the frames of the evaluation, with covariances about their axes."""
        if self._rotation_frame == "body":
            pairs = pairs._replace(estimate=turned_covariances(pairs.estimate))
        if not self.gauge.turns_about_gravity_only:
            return pairs
        return pairs._replace(
            groundtruth=upright_rows(pairs.groundtruth, self.groundtruth_up),
            estimate=upright_rows(pairs.estimate, self.estimate_up),
        )

    def between_own_axes(self, alignment: Alignment) -> Alignment:
        """Return an alignment of the frames of the evaluation as one of the messages' frames."""
        if not self.gauge.turns_about_gravity_only:
            return alignment
        axes = self.groundtruth_up, self.estimate_up
        similarity = between_own_axes(alignment.similarity, *axes)
        return dataclasses.replace(alignment, similarity=similarity)

    def leaves_out_velocities_of(self, rows: Floats) -> bool:
        """Return whether states have velocities that are not evaluated because of a lever arm."""
        if self._arm is None or not self._arm.lever_m.any():
            return False
        return bool(np.nan_to_num(rows[:, VELOCITY]).any())
