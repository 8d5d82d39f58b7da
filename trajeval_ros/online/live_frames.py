"""Conversion of live states to the point and the frames of the evaluation, as offline.

Gauge planar projects on the horizontal plane, a lever arm moves the estimate to the groundtruth's
point, and gauges with rotations about gravity only need frames with z up.
"""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np

from trajeval_ros.exceptions import InputError
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.frame_axes import between_own_axes, upright
from trajeval_ros.geometry.gauge import Gauge, Similarity
from trajeval_ros.geometry.marker import HandEye
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.geometry.up_axis import Z_UP, UpAxis
from trajeval_ros.metrics.alignment import Alignment
from trajeval_ros.metrics.evaluation import on_plane
from trajeval_ros.online.live_settings import OnlineSettings
from trajeval_ros.online.pairing import PairedStates


class LiveFrames:
    """Converts states of both sides, whose frames have up axes: those given, or of the blocks."""

    def __init__(self, settings: OnlineSettings) -> None:
        self._given_up = settings.up
        self.groundtruth_up = self.estimate_up = Z_UP
        if settings.up is not None:
            self.groundtruth_up, self.estimate_up = map(UpAxis, settings.up)
        self.gauge = settings.protocol.gauge  # the gauge of the alignment
        lever_m = settings.protocol.lever_m
        self._arm = None if lever_m is None else HandEye.of(None, np.array(lever_m))
        self._rotation_frame = settings.covariances.rotation_frame

    def of_groundtruth(self, block: Trajectory) -> Trajectory:
        """Return groundtruth states as they are paired.

        If there is a lever arm, they are of a point, also if messages have a constant orientation.
        For gauge planar they are projected on the horizontal plane.
        """
        if self._given_up is None:
            self.groundtruth_up = block.up
        block = _with_up(block, self.groundtruth_up)
        if self._arm is not None:
            block = replace(block, quaternions=None, velocities=None)
        return in_plane(block) if self.gauge is Gauge.PLANAR else block

    def of_estimate(self, block: Trajectory) -> Trajectory:
        """Return estimated states as they are paired.

        Raises:
            InputError: There is a lever arm, and the states have no orientations.
        """
        if self._given_up is None:
            self.estimate_up = block.up
        if self._arm is not None and block.quaternions is None and len(block):
            raise InputError(
                "the estimate has no orientations, so no lever arm can be applied to it"
            )
        return _with_up(block, self.estimate_up)

    def of_same_point(self, pairs: PairedStates) -> PairedStates:
        """Return pairs of the pairing for the groundtruth's point, in the plane if planar.

        The lever arm depends on the orientation at the pair's timestamp. Therefore it is applied
        after the interpolation of the estimate, and before the projection.
        """
        estimate = pairs.estimate
        if self._arm is not None:
            estimate = at_marker(estimate, self._arm, self._rotation_frame)
        if self.gauge is Gauge.PLANAR:
            estimate = in_plane(estimate)
        return PairedStates(pairs.groundtruth, estimate)

    def upright(self, pairs: PairedStates) -> PairedStates:
        """Return pairs in the frames of the evaluation, with covariances about their axes."""
        groundtruth, estimate = pairs.groundtruth, pairs.estimate
        if self._rotation_frame == "body":
            estimate = _rotated_covariances(estimate)
        if self.gauge.yaw_only:
            groundtruth, estimate = upright(groundtruth), upright(estimate)
        return PairedStates(groundtruth, estimate)

    def between_own_axes(self, alignment: Alignment) -> Alignment:
        """Return an alignment of the frames of the evaluation as one of the messages' frames."""
        axes = self.groundtruth_up, self.estimate_up
        if not self.gauge.yaw_only or all(up.name == "z" for up in axes):
            return alignment
        similarity = between_own_axes(alignment.similarity, *axes)
        return dataclasses.replace(alignment, similarity=similarity)


def _with_up(block: Trajectory, up: UpAxis) -> Trajectory:
    return block if block.up == up else replace(block, up=up)


def in_plane(states: Trajectory) -> Trajectory:
    """Return states projected on the horizontal plane of their frame; covariances are kept."""
    if states.up.name == "z":
        return on_plane(states)
    flat = on_plane(upright(states))
    back = Similarity(states.up.matrix.T, np.zeros(3)).trajectory(flat)
    return replace(
        back, up=states.up, covariances=states.covariances, reading=states.reading.without()
    )


def at_marker(estimate: Trajectory, hand_eye: HandEye, rotation_frame: str) -> Trajectory:
    """Return estimated states with the marker's position and its covariances."""
    if rotation_frame != "body":
        return hand_eye.of_marker(estimate, 1.0)
    moved = hand_eye.of_marker(_rotated_covariances(estimate), 1.0)
    return _rotated_covariances(moved, to_body=True)


def _rotated_covariances(states: Trajectory, *, to_body: bool = False) -> Trajectory:
    """Return states with rotation covariances converted from body axes to world axes."""
    if states.covariances is None or states.quaternions is None:
        return states
    from trajeval_ros.geometry.covariance_frames import world_from_body_rotations

    rotations = lie.to_matrix(states.quaternions)
    if to_body:
        rotations = rotations.swapaxes(1, 2)
    return replace(states, covariances=world_from_body_rotations(states.covariances, rotations))
