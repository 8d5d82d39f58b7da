"""A smooth motion of the body: quintic B-splines of position and quaternion over time.

Three shapes of the gauge paper, section IV-A, or the motion of any recorded trajectory.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_lsq_spline
from scipy.spatial.transform import Rotation

from trajeval_ros.exceptions import InputError, SettingsError, require_one_of
from trajeval_ros.formatting.numbers import counted
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.trajectory import Trajectory

# Columns: the camera's right, down and forward in a body whose x is forward, y left and z up.
_FORWARD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
SHAPES = ("sine", "arc", "rec")
SPEED_MPS = 2.0
_DEGREE = 5
_WAYPOINTS = 201
# Few knots, since they round the corners of the rectangle.
_INNER_KNOTS = {"sine": 100, "arc": 100, "rec": 8}
# Smooths the noise of recorded groundtruth; a vehicle's attitude doesn't change faster.
_RECORDED_KNOT_STEP_S = 0.1
# Two knot steps. With noise of 1 mm, the spline errs by 2 cm in a gap of three steps, and by
# metres in a gap of five.
_LONGEST_GAP_S = 0.2
# The direction of a slower motion, and thus the camera's, would be determined by noise.
_SLOWEST_MPS = 0.01


@dataclass(frozen=True, eq=False)
class Motion:
    """Position and attitude of the body as functions of time, with exact derivatives."""

    position: BSpline  # spline of (3,), metres, in a world whose z is up
    quaternion: BSpline  # spline of (4,) xyzw, not of unit length between waypoints
    duration_s: float  # the splines are defined from 0 to this time
    camera_in_body: Floats  # (3, 3), columns are the camera's right, down and forward in the body
    name: str  # name in outputs

    def positions(self, times: Floats) -> Floats:
        """Return positions (N, 3), metres."""
        return np.asarray(self.position(times))

    def velocities(self, times: Floats) -> Floats:
        """Return velocities (N, 3), m/s, in the world."""
        return np.asarray(self.position(times, 1))

    def accelerations(self, times: Floats) -> Floats:
        """Return accelerations (N, 3), m/s^2, in the world, without gravity."""
        return np.asarray(self.position(times, 2))

    def rotations(self, times: Floats) -> Floats:
        """Return rotation matrices (N, 3, 3) from the body to the world."""
        return np.asarray(Rotation.from_quat(self.quaternion(times)).as_matrix())

    def angular_velocities(self, times: Floats) -> Floats:
        """Return angular velocities (N, 3), rad/s, in the body: twice the vector of q* dq/dt."""
        quaternion, rate = self.quaternion(times), self.quaternion(times, 1)
        product = lie.multiply(lie.conjugate(quaternion), rate)[..., :3]
        # The length of q only adds to the scalar part; the vector part scales with its square.
        rotated: Floats = 2.0 * product / np.sum(quaternion**2, axis=-1, keepdims=True)
        return rotated


def shape(name: str, length_m: float = 5.0) -> Motion:
    """Return one of the paper's shapes, flown at 2 m/s on average.

    They are `sine` (camera 60 degrees to the side), `arc` (100 degrees of a circle, camera
    inwards) and `rec` (most of a rectangle, camera slowly swinging).
    """
    require_one_of(name, SHAPES, "shape")
    s = np.linspace(0.0, 1.0, _WAYPOINTS)
    phase = 2.0 * np.pi * s
    if name == "sine":
        points = [s, 0.12 * np.sin(1.5 * phase), 0.05 * np.sin(phase + 0.4)]
        angles = [
            60.0 + 12.0 * np.sin(phase),
            6.0 * np.sin(phase + 1.0),
            8.0 * np.sin(1.5 * phase),
        ]
    elif name == "arc":
        along = np.radians(100.0 * s)
        points = [np.sin(along), 1.0 - np.cos(along), 0.08 * np.sin(phase)]
        angles = [90.0 + 100.0 * s, 5.0 * np.sin(phase), 6.0 * np.sin(phase + 0.7)]
    else:
        corners = np.array([[0.0, 0.0], [1.5, 0.0], [1.5, 1.0], [0.0, 1.0], [0.0, 0.0]])
        travelled = [0.0, 1.5, 2.5, 4.0, 5.0]
        x, y = (np.interp(4.0 * s, travelled, corners[:, axis]) for axis in range(2))
        points = [x, y, 0.1 * np.sin(phase)]
        angles = [20.0 + 25.0 * np.sin(phase), 6.0 * np.sin(phase), 5.0 * np.cos(phase)]
    positions = np.stack(points, axis=1)
    path_m = np.linalg.norm(np.diff(positions, axis=0), axis=1).sum()
    positions *= length_m / path_m
    attitudes = Rotation.from_euler("ZYX", np.stack(angles, axis=1), degrees=True)
    duration_s = length_m / SPEED_MPS
    times = s * duration_s
    quaternions = np.asarray(attitudes.as_quat())
    return _fitted(times, positions, quaternions, _INNER_KNOTS[name], _FORWARD, name)


def recorded(trajectory: Trajectory, start_s: float, duration_s: float) -> Motion:
    """Return the motion of a recorded trajectory, from `start_s` after its first state on.

    The camera looks horizontally, towards where the body mostly travels, whichever way the
    recorded body's axes point.
    """
    if not (0.0 <= start_s < np.inf and 0.0 < duration_s < np.inf):
        raise SettingsError(
            f"a motion can't start at {start_s:g} s and last {duration_s:g} s; give a start of "
            "at least 0 s and a duration greater than 0 s"
        )
    seconds = trajectory.seconds - trajectory.seconds[0] - start_s
    part = trajectory[(seconds >= 0.0) & (seconds <= duration_s)]
    quaternions = part.quaternions
    times = seconds[(seconds >= 0.0) & (seconds <= duration_s)]
    inner = int(duration_s / _RECORDED_KNOT_STEP_S)
    fewest = max(2 * inner, inner + _DEGREE + 1)
    name = trajectory.name or "the trajectory"
    if quaternions is None or len(part) < fewest or times[-1] < 0.98 * duration_s:
        raise InputError(
            f"no motion of {duration_s:g} s from {start_s:g} s in {name}: orientations and "
            f"{fewest} states are required, found {counted(len(part), 'state')}"
        )
    gaps = np.diff(times, prepend=0.0)
    if gaps.max() > _LONGEST_GAP_S:
        before_s = start_s + times[gaps.argmax()] - gaps.max()
        raise InputError(
            f"no motion of {duration_s:g} s from {start_s:g} s in {name}: gap of "
            f"{gaps.max():.2f} s at {before_s:.2f} s, limit {_LONGEST_GAP_S:g} s; choose "
            "another part"
        )
    fitted = _fitted(
        times - times[0], part.positions, quaternions, inner, _FORWARD, trajectory.name
    )
    rotations = fitted.rotations(np.linspace(0.0, fitted.duration_s, 200))
    velocities = fitted.velocities(np.linspace(0.0, fitted.duration_s, 200))
    up = rotations[:, 2].mean(axis=0)
    up /= np.linalg.norm(up)
    ahead = np.einsum("nij,ni->j", rotations, velocities)
    ahead -= up * (up @ ahead)
    in_body = np.einsum("nij,ni->nj", rotations, velocities)
    speed_mps = np.linalg.norm(np.cross(in_body, up), axis=1).mean()
    if speed_mps < _SLOWEST_MPS:
        raise InputError(
            f"no motion of {duration_s:g} s from {start_s:g} s in {name}: the body is too slow, "
            f"{speed_mps:.3f} m/s; choose another part"
        )
    ahead /= np.linalg.norm(ahead)
    camera = np.stack([np.cross(ahead, up), -up, ahead], axis=1)
    return Motion(fitted.position, fitted.quaternion, fitted.duration_s, camera, fitted.name)


def _fitted(
    times: Floats, positions: Floats, quaternions: Floats, inner: int, camera: Floats, name: str
) -> Motion:
    """Return the least-squares splines through waypoints."""
    # q and -q are the same rotation: make the signs continuous for the spline.
    flips = np.sign(np.einsum("ni,ni->n", quaternions[:-1], quaternions[1:]))
    signs = np.concatenate([[1.0], np.cumprod(np.where(flips == 0.0, 1.0, flips))])
    duration_s = float(times[-1])
    knots = np.concatenate(
        [
            np.zeros(_DEGREE + 1),
            np.linspace(0.0, duration_s, inner + 2)[1:-1],
            np.full(_DEGREE + 1, duration_s),
        ]
    )
    position = make_lsq_spline(times, positions, knots, _DEGREE)
    quaternion = make_lsq_spline(times, quaternions * signs[:, None], knots, _DEGREE)
    return Motion(position, quaternion, duration_s, camera, name)
