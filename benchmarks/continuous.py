"""Times continuous groundtruth and likelihoods inside a process; prints the CPU seconds as JSON.

Usage: OPENBLAS_NUM_THREADS=1 python -m benchmarks.continuous WORK COUNT

WORK is a model, fitted to COUNT samples at 100 Hz and asked for 20 000 poses, or `likelihood`, of
COUNT poses.
"""

from __future__ import annotations

import json
import sys
import time

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.tum_pairs import estimate_of, flight
from trajeval_ros.continuous_time.continuous_trajectory import fit_trajectory
from trajeval_ros.continuous_time.samples import Belief, Noise
from trajeval_ros.geometry import se3
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.likelihood.marginal import generalised_absolute_error
from trajeval_ros.likelihood.relative_density import decomposed, stepwise, transports
from trajeval_ros.likelihood.residuals import Residuals

QUERIES = 20_000
LIKELIHOOD = "likelihood"
STEP_NS = 10_000_000


def continuous_s(model: str, count: int) -> dict[str, float]:
    """Fit a model and ask it."""
    random = np.random.default_rng(count)
    positions, attitudes = flight(random, 2 * count)
    noise = Noise()
    rotations = Rotation.from_rotvec(random.normal(scale=noise.rotation_rad, size=(count, 3)))
    groundtruth = Trajectory(
        np.arange(count, dtype=np.int64) * STEP_NS,
        positions[::2] + random.normal(scale=noise.position_m, size=(count, 3)),
        (attitudes[::2] * rotations).as_quat(),
    )
    asked = np.sort(random.integers(0, groundtruth.stamps[-1], QUERIES))
    start = time.process_time()
    fitted = fit_trajectory(groundtruth, model, noise)
    between = time.process_time()
    fitted.at(asked)
    return {"fit_s": between - start, "query_s": time.process_time() - between}


def likelihood_s(count: int) -> dict[str, float]:
    """Take both generalised errors."""
    random = np.random.default_rng(count)
    positions, attitudes = flight(random, count)
    moved, rotated = estimate_of(random, positions, attitudes)
    belief = Belief(
        se3.poses(attitudes.as_matrix(), positions),
        np.tile(np.diag([1e-4] * 3 + [1e-5] * 3), (count, 1, 1)),
    )
    estimate = se3.poses(rotated.as_matrix(), moved)
    residuals = Residuals(belief, estimate, Gauge.SE3)
    start = time.process_time()
    mode = generalised_absolute_error(residuals).mode.element
    between = time.process_time()
    decomposed(belief, stepwise(transports(belief.poses), residuals.at(mode)))
    return {"relative_s": time.process_time() - between, "absolute_s": between - start}


def main() -> None:
    """Do one work once."""
    work, count = sys.argv[1], int(sys.argv[2])
    result = likelihood_s(count) if work == LIKELIHOOD else continuous_s(work, count)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
