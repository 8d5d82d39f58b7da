"""Samples of a groundtruth for its continuous models."""

from __future__ import annotations

import numpy as np

from trajeval_ros.continuous_time.samples import Noise, Samples
from trajeval_ros.geometry import se3, so3
from trajeval_ros.geometry.arrays import Floats


def samples_at(
    seconds: Floats, positions: Floats | None = None, turns: Floats | None = None
) -> Samples:
    """Return samples at seconds (N,), of a straight and slow motion unless given."""
    line = np.outer(seconds, [1.0, 0.5, 0.0]) if positions is None else positions
    vectors = np.outer(seconds, [0.0, 0.0, 0.05]) if turns is None else turns
    poses = se3.poses(so3.exp(vectors), line)
    return Samples(0, np.asarray(seconds, dtype=float), poses, True, Noise(0.01, 0.02))
