"""Simulated landmarks along a motion, and their observations (gauge paper, section IV-A)."""

from __future__ import annotations

import numpy as np

from trajeval_ros.exceptions import DegenerateGeometryError, SettingsError
from trajeval_ros.geometry.arrays import Booleans, Floats, Indices
from trajeval_ros.visual_inertial.camera import Camera

LAYOUTS = ("plane", "random")
# A landmark with one view has an unknown depth and adds a null direction. Two views are the
# minimum, but determine the depth poorly if the keyframes are close.
FEWEST_VIEWS = 3
_DEPTHS_M = (1.5, 7.0)
_FRONT_WALL_M, _SIDE_WALLS_M, _FLOOR_M, _FARTHEST_WALL_M = 4.0, 3.0, 1.5, 12.0
_SCATTER_M = 0.05
_MARGIN = 0.05
_ROUNDS = 100


def draw_landmarks(
    generator: np.random.Generator,
    layout: str,
    count: int,
    positions: Floats,
    cameras: Floats,
    camera: Camera,
    track: int,
) -> tuple[Floats, Indices, Indices, Floats]:
    """Draw landmarks that at least three keyframes see.

    Args:
        generator: Random number generator.
        layout: `plane`: on walls and a floor around the motion; `random`: anywhere in view.
        count: Number of landmarks K.
        positions: (N, 3) keyframe positions, metres.
        cameras: (N, 3, 3) rotations from the camera to the world.
        camera: Projection and field of view.
        track: Largest number of keyframes for which a landmark is tracked, before and after the
            keyframe that it was drawn from.

    Returns:
        Landmarks (K, 3), and of M observations the keyframe (M,), the landmark (M,) and the
        noise-free pixels (M, r), in order of landmarks.

    Raises:
        SettingsError: Unknown layout.
        DegenerateGeometryError: Too few landmarks are observed by several keyframes.
    """
    if layout not in LAYOUTS:
        raise SettingsError(
            f"unknown layout of landmarks {layout!r}; use one of {', '.join(LAYOUTS)}"
        )
    keyframes = len(positions)
    batches: list[tuple[Floats, Booleans, Indices]] = []
    kept = 0
    for _ in range(_ROUNDS):
        origin = generator.integers(0, keyframes, 4 * count)
        size = [camera.width, camera.height]
        pixels = generator.uniform(_MARGIN, 1.0 - _MARGIN, (4 * count, 2)) * size
        rays = np.einsum("nij,nj->ni", cameras[origin], camera.rays(pixels))
        if layout == "random":
            depths = generator.uniform(*_DEPTHS_M, 4 * count)
            points = positions[origin] + depths[:, None] * rays
        else:
            depths = _depths_of_walls(positions, cameras, origin, rays)
            points = positions[origin] + depths[:, None] * rays
            points += generator.normal(0.0, _SCATTER_M, points.shape)
        seen, near = _sightings(points, origin, positions, cameras, camera, track)
        good = (seen.sum(axis=1) >= FEWEST_VIEWS) & (depths < _FARTHEST_WALL_M)
        batches.append((points[good], seen[good], near[good]))
        kept += int(np.count_nonzero(good))
        if kept >= count:
            break
    else:
        raise DegenerateGeometryError(
            f"only {kept} of {count} landmarks are observed by {FEWEST_VIEWS} keyframes; use "
            "closer keyframes or a wider camera"
        )
    points, seen, near = (
        np.concatenate(columns)[:count] for columns in zip(*batches, strict=True)
    )
    landmark_of, place = np.nonzero(seen)
    keyframe_of = near[landmark_of, place]
    in_camera = _in_camera(points[landmark_of], positions[keyframe_of], cameras[keyframe_of])
    return points, keyframe_of, landmark_of, camera.pixels(in_camera)


def _sightings(
    points: Floats, origin: Indices, positions: Floats, cameras: Floats, camera: Camera, track: int
) -> tuple[Booleans, Indices]:
    """Return which keyframes of a point's track see it (mask), and these keyframes' indices."""
    keyframes = len(positions)
    span = min(2 * track + 1, keyframes)
    first = np.clip(origin - track, 0, keyframes - span)
    near = first[:, None] + np.arange(span)
    in_camera = _in_camera(points[:, None], positions[near], cameras[near])
    return camera.sees(in_camera) & (np.abs(near - origin[:, None]) <= track), near


def _in_camera(points: Floats, positions: Floats, cameras: Floats) -> Floats:
    moved: Floats = np.einsum("...ji,...j->...i", cameras, points - positions)
    return moved


def _depths_of_walls(positions: Floats, cameras: Floats, origin: Indices, rays: Floats) -> Floats:
    """Return the depths at which rays meet a wall ahead, at the sides, or the floor."""
    centre = positions.mean(axis=0)
    ahead = cameras[:, :, 2].mean(axis=0) * [1.0, 1.0, 0.0]
    ahead /= np.linalg.norm(ahead)
    left = np.cross([0.0, 0.0, 1.0], ahead)
    normals = np.stack([ahead, left, -left, [0.0, 0.0, -1.0]])
    distances = np.array(
        [
            ahead @ centre + _FRONT_WALL_M,
            left @ centre + _SIDE_WALLS_M,
            -left @ centre + _SIDE_WALLS_M,
            _FLOOR_M - positions[:, 2].min(),
        ]
    )
    towards = rays @ normals.T
    with np.errstate(divide="ignore", invalid="ignore"):
        depths = (distances - positions[origin] @ normals.T) / towards
    # Excludes walls that are parallel to the ray, behind the camera, or too close.
    depths[~(depths > 0.5)] = np.inf
    nearest: Floats = np.where(np.isfinite(depths), depths, _FARTHEST_WALL_M).min(axis=1)
    return nearest
