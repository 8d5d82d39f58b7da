"""Times the visual-inertial estimator on one BLAS thread; prints milliseconds as JSON.

Usage: OPENBLAS_NUM_THREADS=1 python -m benchmarks.visual_inertial RUNS
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from statistics import median

import numpy as np

from trajeval_ros.papers.flight import Sampler
from trajeval_ros.papers.gauge_trials import fixed_covariance, free_covariance
from trajeval_ros.papers.scene import PROFILES, make_scene
from trajeval_ros.papers.solver import GaugeHandling, solve
from trajeval_ros.simulation.motion import shape

SIZES = ((10, 50), (10, 500), (30, 500), (100, 500))
LONG_KEYFRAMES, LONG_LANDMARKS, LONG_TRACK, LONG_M = 1000, 10_000, 8, 500.0


def milliseconds(work: Callable[[], object]) -> float:
    """Return the CPU time of a piece of work."""
    start = time.process_time()
    work()
    return 1e3 * (time.process_time() - start)


def solves(keyframes: int, landmarks: int, runs: int) -> dict[str, float]:
    """Time one solve in the free gauge, and covariances at its end."""
    scene = make_scene(
        shape("sine"), "random", PROFILES["paper"], 0, keyframes=keyframes, landmarks=landmarks
    )
    problem = scene.measured(np.random.default_rng(1))
    start = scene.disturbed(np.random.default_rng(2))
    solution = solve(problem, start, GaugeHandling.FREE)
    return {
        "observations": len(problem.pixels),
        "iterations": solution.iterations,
        "solve_ms": median(
            milliseconds(lambda: solve(problem, start, GaugeHandling.FREE)) for _ in range(runs)
        ),
        "fixed_covariance_ms": milliseconds(lambda: fixed_covariance(problem, solution.state)),
        "free_covariance_ms": milliseconds(lambda: free_covariance(problem, solution.state)),
    }


def long_run() -> dict[str, float]:
    """Time the sampler on a long run."""
    scene = make_scene(
        shape("sine", LONG_M), "random", PROFILES["paper"], 0,
        keyframes=LONG_KEYFRAMES, landmarks=LONG_LANDMARKS, track=LONG_TRACK,
    )  # fmt: skip
    sampler = Sampler(scene)
    return {
        "observations": len(scene.pixels),
        "sampler_ms": milliseconds(lambda: Sampler(scene)),
        "draw_ms": milliseconds(lambda: sampler.draw(np.random.default_rng(0))),
    }


def main() -> None:
    """Time all sizes."""
    runs = int(sys.argv[1])
    outcome = {f"N={n} K={k}": solves(n, k, runs) for n, k in SIZES}
    print(json.dumps({**outcome, f"N={LONG_KEYFRAMES}": long_run()}, indent=1))


if __name__ == "__main__":
    main()
