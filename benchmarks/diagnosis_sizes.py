"""Mistakes of known sizes on real recordings: tilts, rates, offsets, heights, inverse poses."""

from __future__ import annotations

import numpy as np

from benchmarks.diagnosis_mistakes import (
    CAMERA,
    Make,
    Mistake,
    change,
    in_axes,
    inverse,
    quaternions_of,
    shifted,
)
from benchmarks.diagnosis_runs import Pair
from trajeval_ros.geometry import lie


def _about(axis: list[float], degrees: float) -> np.ndarray:
    return np.asarray(lie.from_rotation_vector(np.radians(degrees) * np.array(axis)))


def _world(degrees: float) -> Make:
    return in_axes(lie.to_matrix(_about([0.6, -0.8, 0.0], degrees)), "estimate")


def _body(pair: Pair, side: str, quaternion: np.ndarray) -> Pair:
    rotated = lie.multiply(quaternions_of(getattr(pair, side)), quaternion)
    return change(pair, side, quaternions=rotated)


def _rate(ppm: float) -> Make:
    def make(pair: Pair) -> Pair:
        stamps = pair.estimate.stamps
        later = np.rint(1e-6 * ppm * (stamps - stamps[0])).astype(np.int64)
        return change(pair, "estimate", stamps=stamps + later)

    return make


def _no_height(pair: Pair) -> Pair:
    return change(pair, "estimate", positions=pair.estimate.positions * [1.0, 1.0, 0.0])


def _inverse_camera(side: str) -> Make:
    """Return what gives the estimate the body axes of a camera, and inverts a side."""
    return lambda pair: inverse(side)(_body(pair, "estimate", lie.from_matrix(CAMERA.T)))


_OFFSET = ("small_clock_offset", "clock_offset")
SIZES: dict[str, Mistake] = {
    **{f"world {deg:g} deg": Mistake(_world(deg), ("tilted",), "yaw") for deg in (4.0, 8.0, 11.0)},
    "500 ppm": Mistake(_rate(500.0), ("clock_drift",)),
    **{f"{ms:g} ms": Mistake(shifted(1e-3 * ms), _OFFSET) for ms in (40.0, -100.0, 200.0)},
    "z = 0": Mistake(_no_height, ("flat",), "yaw"),
    "inverse, estimate of a camera": Mistake(_inverse_camera("estimate"), ("inverse",)),
    "inverse, groundtruth, camera": Mistake(_inverse_camera("truth"), ("inverse",)),
    "body 40 deg": Mistake(
        lambda pair: _body(pair, "estimate", _about([0.6, 0.0, 0.8], 40.0)), ("body",)
    ),
}
