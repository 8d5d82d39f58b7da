"""A hall with boxes in it, and a spinning lidar that flies through it. Needs numpy and scipy only.

The lidar measures one column of points after the other. Its body moves during the sweep, so a
sweep is distorted by the motion, as that of a real lidar.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from trajeval_ros import Trajectory
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.simulation.drifting_odometry import simulate

PERIOD_S = 0.1  # of a sweep
RINGS, COLUMNS = 24, 420
LOWEST_DEG, HIGHEST_DEG = -25.0, 25.0
NEAREST_M, FARTHEST_M = 0.4, 60.0
RANGE_SIGMA_M = 0.01
START_S = 0.2  # of the first sweep, after the first pose
LONGEST_S = 119.0

_FLIGHT_S = 120.0
_BOXES, _CLEARANCE_M = 45, 0.7
_WALLS_M, _FLOOR_M, _CEILING_M = 4.0, 1.2, 1.5  # distance from the path


def _rays() -> Floats:
    """Return unit vectors in the frame of the body, (columns, rings, 3)."""
    elevation = np.radians(np.linspace(LOWEST_DEG, HIGHEST_DEG, RINGS))[None, :]
    azimuth = -np.linspace(0.0, 2.0 * np.pi, COLUMNS, endpoint=False)[:, None]
    parts = (
        np.cos(azimuth) * np.cos(elevation),
        np.sin(azimuth) * np.cos(elevation),
        np.zeros_like(azimuth) + np.sin(elevation),
    )
    return np.stack(parts, axis=-1)


@dataclass(frozen=True)
class Hall:
    """Boxes with axes parallel to those of the world, and the room around them."""

    low: Floats  # (B + 1, 3) smallest coordinates; those of the room are last
    high: Floats  # (B + 1, 3) largest coordinates

    @classmethod
    def around(cls, path: Floats) -> Hall:
        """Return a hall with a free path (N, 3)."""
        generator = np.random.default_rng(0)
        room_low = path.min(axis=0) - [_WALLS_M, _WALLS_M, _FLOOR_M]
        room_high = path.max(axis=0) + [_WALLS_M, _WALLS_M, _CEILING_M]
        boxes: list[tuple[Floats, Floats]] = []
        while len(boxes) < _BOXES:
            low, high = _box(generator, room_low, room_high)
            apart = np.maximum(low - path, path - high).clip(min=0.0)
            if (np.square(apart).sum(axis=1) > _CLEARANCE_M**2).all():
                boxes.append((low, high))
        boxes.append((room_low, room_high))
        return cls(*(np.array(corner) for corner in zip(*boxes, strict=True)))

    def ranges(self, origins: Floats, rays: Floats) -> Floats:
        """Return the distances (N,) to the next surface, from (N, 3) along unit rays (N, 3)."""
        origin, slope = origins.astype(np.float32), rays.astype(np.float32)
        slope[np.abs(slope) < 1e-9] = 1e-9
        inverse = 1.0 / slope
        # A ray is in a box while it is in the slabs of all three axes.
        enter = np.full((len(origin), len(self.low)), -np.inf, np.float32)
        leave = np.full_like(enter, np.inf)
        for axis in range(3):
            column, factor = origin[:, axis, None], inverse[:, axis, None]
            one = (self.low[None, :, axis].astype(np.float32) - column) * factor
            other = (self.high[None, :, axis].astype(np.float32) - column) * factor
            np.maximum(enter, np.minimum(one, other), out=enter)
            np.minimum(leave, np.maximum(one, other), out=leave)
        enter[~((enter > 0.0) & (enter < leave))] = np.inf
        return np.asarray(np.minimum(enter[:, :-1].min(axis=1), leave[:, -1]), dtype=float)


def _box(
    generator: np.random.Generator, room_low: Floats, room_high: Floats
) -> tuple[Floats, Floats]:
    """Return the corners of a pillar, a shelf on the floor or a duct below the ceiling."""
    kind = generator.choice(["pillar", "shelf", "duct"])
    if kind == "pillar":
        size = np.append(generator.uniform(0.3, 0.8, 2), np.inf)
    elif kind == "shelf":
        size = generator.uniform([0.5, 0.5, 0.4], [3.0, 1.2, 3.0])
    else:
        size = generator.uniform([0.4, 0.4, 0.2], [6.0, 0.8, 0.8])
    size[:2] = generator.permutation(size[:2])
    size = np.minimum(size, room_high - room_low)
    low = generator.uniform(room_low, np.maximum(room_low, room_high - size))
    low[2] = room_high[2] - size[2] if kind == "duct" else room_low[2]
    return low, low + size


class Flight:
    """What the lidar measures during a flight.

    Attributes:
        groundtruth: The true trajectory, 200 poses per second.
        hall: The hall around it.
    """

    def __init__(self) -> None:
        self.groundtruth: Trajectory = simulate(0, _FLIGHT_S).groundtruth
        self.hall = Hall.around(self.groundtruth.positions[::20])
        self._seconds = (self.groundtruth.stamps - self.groundtruth.stamps[0]) * 1e-9
        self._turns = Slerp(self._seconds, Rotation.from_quat(self.groundtruth.quaternions))
        self._rays = _rays()

    def sweep(self, number: int) -> tuple[int, Floats, Floats]:
        """Return a sweep of the lidar; the same number gives the same points.

        Returns:
            Timestamp of its beginning in ns, points (N, 3) in the frame of the body at the time
            of each point in metres, and these times (N,) in seconds after the beginning.
        """
        begin_s = START_S + number * PERIOD_S
        after = np.arange(COLUMNS) * (PERIOD_S / COLUMNS)
        at = begin_s + after
        positions = [np.interp(at, self._seconds, item) for item in self.groundtruth.positions.T]
        origins = np.repeat(np.stack(positions, axis=1), RINGS, axis=0)
        rays = np.einsum("cij,crj->cri", self._turns(at).as_matrix(), self._rays).reshape(-1, 3)
        ranges = self.hall.ranges(origins, rays)
        ranges += np.random.default_rng(number).normal(0.0, RANGE_SIGMA_M, len(ranges))
        seen = (ranges > NEAREST_M) & (ranges < FARTHEST_M)
        points = self._rays.reshape(-1, 3)[seen] * ranges[seen, None]
        stamp = int(self.groundtruth.stamps[0]) + round(begin_s * 1e9)
        return stamp, points, np.repeat(after, RINGS)[seen]
