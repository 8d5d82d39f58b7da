"""Times an iteration of the visual-inertial estimator beside GTSAM's; prints JSON.

Both take Levenberg-Marquardt steps on the same measurements, in turns, on one thread; GTSAM with
its own factors and each of three orderings, of which the best counts. Runs in the environment of
`make oracles`.

Usage: OPENBLAS_NUM_THREADS=1 python -m benchmarks.estimators RUNS
"""

from __future__ import annotations

import json
import sys
import time
from importlib.metadata import version
from statistics import median
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, L, V, X

from trajeval_ros.papers.scene import IMU_RATE_HZ, PROFILES, Scene, make_scene
from trajeval_ros.papers.solver import GaugeHandling, solve
from trajeval_ros.papers.state import State
from trajeval_ros.simulation.motion import shape

KEYFRAMES = (10, 30, 100)
LANDMARKS = 500
# Keyframes before and after the one that a landmark is drawn from: all, or windows of 5 and 7.
TRACKS = {"dense": None, "windows of 7": 3, "windows of 5": 2}
_STEPS = 4
_PRIOR = 1e5


def main() -> None:
    """Time all sizes."""
    runs = int(sys.argv[1])
    rows = [
        compared(keyframes, name, track, runs)
        for keyframes in KEYFRAMES
        for name, track in TRACKS.items()
    ]
    print(json.dumps({"gtsam": version("gtsam"), "rows": rows}, indent=1))


def compared(keyframes: int, visibility: str, track: int | None, runs: int) -> dict[str, Any]:
    """Return milliseconds of CPU time per iteration of both."""
    scene = make_scene(
        shape("sine"), "random", PROFILES["paper"], 0,
        keyframes=keyframes, landmarks=LANDMARKS, track=track,
    )  # fmt: skip
    start = scene.disturbed(np.random.default_rng(2))
    graph, values = factor_graph(scene, start)
    orderings = {
        "colamd": gtsam.Ordering.ColamdNonlinearFactorGraph(graph),
        "metis": gtsam.Ordering.MetisNonlinearFactorGraph(graph),
        "landmarks first": landmarks_first(keyframes),
    }
    times: dict[str, list[float]] = {name: [] for name in ("ours", *orderings)}
    for _ in range(runs):
        times["ours"].append(ours_ms(scene, start))
        for name, ordering in orderings.items():
            times[name].append(gtsam_ms(graph, values, ordering))
    actual, *theirs = (median(item) for item in times.values())
    best = min(theirs)
    return {
        "keyframes": keyframes,
        "visibility": visibility,
        "observations": len(scene.pixels),
        "ours_ms": actual,
        "gtsam_ms": best,
        "ordering": list(orderings)[theirs.index(best)],
        "ratio": best / actual,
    }


def ours_ms(scene: Scene, start: State) -> float:
    """Return the time of one iteration of the free gauge."""
    problem = scene.measured(np.random.default_rng(1))
    begin = time.process_time()
    solution = solve(problem, start, GaugeHandling.PRIOR, _PRIOR, function_tolerance=1e-12)
    return 1e3 * (time.process_time() - begin) / solution.iterations


def gtsam_ms(graph: Any, values: Any, ordering: Any) -> float:
    """Return the time of one linear solve and what belongs to it.

    A solve that is refused raises the damping tenfold, one that is accepted lowers it, which is
    how they are counted.
    """
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setOrdering(ordering)
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters)
    solves, begin, damping = 0, time.process_time(), optimizer.lambda_()
    for _ in range(_STEPS):
        optimizer.iterate()
        solves += round(np.log10(optimizer.lambda_() / damping)) + 2
        damping = optimizer.lambda_()
    return 1e3 * (time.process_time() - begin) / solves


def landmarks_first(keyframes: int) -> Any:
    """Return the ordering that eliminates landmarks, then the motion in order of time."""
    ordering = gtsam.Ordering()
    for landmark in range(LANDMARKS):
        ordering.push_back(L(landmark))
    for keyframe in range(keyframes):
        ordering.push_back(X(keyframe))
        ordering.push_back(V(keyframe))
    ordering.push_back(B(0))
    return ordering


def factor_graph(scene: Scene, start: State) -> tuple[Any, Any]:
    """Return the measurements as GTSAM's own factors, and the initial values."""
    noise, camera = scene.profile.imu, scene.profile.camera
    generator = np.random.default_rng(1)
    pixels = scene.pixels + camera.noise_px * generator.standard_normal(scene.pixels.shape)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    intrinsics = gtsam.Cal3_S2(camera.focal_px, camera.focal_px, 0.0, *camera.centre)
    mount = gtsam.Pose3(gtsam.Rot3(scene.camera_in_body), np.zeros(3))
    white = gtsam.noiseModel.Isotropic.Sigma(2, camera.noise_px)
    sightings = zip(pixels, scene.keyframe_of, scene.landmark_of, strict=True)
    for pixel, keyframe, landmark in sightings:
        names = X(int(keyframe)), L(int(landmark))
        graph.add(gtsam.GenericProjectionFactorCal3_S2(pixel, white, *names, intrinsics, mount))
    parameters = gtsam.PreintegrationParams.MakeSharedU(9.81)
    parameters.setGyroscopeCovariance(noise.gyroscope**2 * np.eye(3))
    parameters.setAccelerometerCovariance(noise.accelerometer**2 * np.eye(3))
    parameters.setIntegrationCovariance(1e-12 * np.eye(3))
    no_bias = gtsam.imuBias.ConstantBias()
    for place, (rates, forces) in enumerate(
        zip(scene.angular_velocities, scene.accelerations, strict=True)
    ):
        measured = gtsam.PreintegratedImuMeasurements(parameters, no_bias)
        for rate, force in zip(rates, forces, strict=True):
            measured.integrateMeasurement(force, rate, 1.0 / IMU_RATE_HZ)
        motion = X(place), V(place), X(place + 1), V(place + 1)
        graph.add(gtsam.ImuFactor(*motion, B(0), measured))
    graph.add(
        gtsam.PriorFactorConstantBias(B(0), no_bias, gtsam.noiseModel.Isotropic.Sigma(6, 1e-9))
    )
    first = gtsam.Pose3(gtsam.Rot3(start.rotations[0]), start.positions[0])
    loose = gtsam.noiseModel.Diagonal.Precisions(
        np.array([1e-6, 1e-6, _PRIOR, _PRIOR, _PRIOR, _PRIOR])
    )
    graph.add(gtsam.PriorFactorPose3(X(0), first, loose))
    values.insert(B(0), no_bias)
    for place in range(len(start.positions)):
        pose = gtsam.Pose3(gtsam.Rot3(start.rotations[place]), start.positions[place])
        values.insert(X(place), pose)
        values.insert(V(place), start.velocities[place])
    for place, landmark in enumerate(start.landmarks):
        values.insert(L(place), landmark)
    return graph, values


if __name__ == "__main__":
    main()
