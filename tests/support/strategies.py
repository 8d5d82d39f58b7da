"""Random trajectories and gauge elements, drawn by hypothesis as seeds of numpy's generator."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from trajeval_ros.geometry import se3
from trajeval_ros.geometry.gauge import Gauge, Similarity
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.evaluation import Evaluation
from trajeval_ros.metrics.statistics import Statistics

Array = NDArray[np.float64]
START = 1_403_636_580_838_555_574

# How far rotations may be apart that are one but for rounding: each normalised, or taken from a
# matrix, to 8 u of its components, and multiplied, which adds 4 u; an angle is twice the vector.
SAME_ROTATION_RAD = 20.0 * float(np.finfo(np.float64).eps)

seeds = st.integers(0, 2**32 - 1)
gauges = st.sampled_from(list(Gauge))


@dataclass(frozen=True)
class Pair:
    """A groundtruth and an estimate of it."""

    groundtruth: Trajectory
    estimate: Trajectory


def make_groundtruth(seed: int, count: int = 120, *, smooth: bool = True) -> Trajectory:
    """Return a 3-D motion some metres wide, with all columns, at about 10 Hz."""
    random = np.random.default_rng(seed)
    steps = random.integers(80_000_000, 120_000_000, size=count)
    stamps = START + np.cumsum(steps).astype(np.int64)
    seconds = (stamps - stamps[0]) * 1e-9
    if smooth:
        rates = random.uniform(0.4, 1.6, size=(3, 3))
        phases = random.uniform(0.0, 2.0 * np.pi, size=(3, 3))
        sizes = random.uniform(1.0, 4.0, size=(3, 3))
        angles = seconds[:, None, None] * rates + phases
        positions = (sizes * np.sin(angles)).sum(axis=2)
        velocities = (sizes * rates * np.cos(angles)).sum(axis=2)
        rotations = 1.5 * np.sin(seconds[:, None] * rates[0] + phases[0])
    else:
        positions = np.cumsum(random.normal(scale=0.6, size=(count, 3)), axis=0)
        velocities = random.normal(size=(count, 3))
        rotations = random.normal(size=(count, 3))
    return Trajectory(
        stamps=stamps,
        positions=positions + random.normal(scale=5.0, size=3),
        quaternions=(
            Rotation.from_rotvec(rotations) * Rotation.random(random_state=seed % 2**31)
        ).as_quat(),
        velocities=velocities,
        gyroscope_biases=random.normal(scale=0.01, size=(count, 3)),
        accelerometer_biases=random.normal(scale=0.1, size=(count, 3)),
    )


def make_estimate(groundtruth: Trajectory, seed: int, *, error_m: float = 0.1) -> Trajectory:
    """Return every other state with drift, noise and stamps of its own, in the same frame."""
    random = np.random.default_rng(seed)
    truth = groundtruth[1:-1:2]
    count = len(truth)
    drift = np.cumsum(random.normal(scale=error_m / 5.0, size=(count, 3)), axis=0)
    noise = random.normal(scale=error_m, size=(count, 3))
    rotations = random.normal(scale=0.02, size=(count, 3)) + random.normal(scale=0.03, size=3)
    assert truth.rotations is not None
    assert truth.velocities is not None
    assert truth.gyroscope_biases is not None
    assert truth.accelerometer_biases is not None
    variances = random.uniform(0.5, 2.0, size=(count, 6)) * error_m**2
    return Trajectory(
        stamps=truth.stamps + random.integers(-9_000_000, 9_000_000, size=count),
        positions=truth.positions + drift + noise,
        quaternions=(Rotation.from_rotvec(rotations) * truth.rotations).as_quat(),
        velocities=truth.velocities + random.normal(scale=0.05, size=(count, 3)),
        gyroscope_biases=truth.gyroscope_biases + random.normal(scale=1e-3, size=(count, 3)),
        accelerometer_biases=truth.accelerometer_biases
        + random.normal(scale=1e-2, size=(count, 3)),
        covariances=np.einsum("ni,ij->nij", variances, np.eye(6)),
    )


def make_pair(seed: int, count: int, smooth: bool) -> Pair:
    groundtruth = make_groundtruth(seed, count, smooth=smooth)
    return Pair(groundtruth, make_estimate(groundtruth, seed + 1))


def pairs(min_count: int = 80, max_count: int = 160) -> st.SearchStrategy[Pair]:
    """Non-degenerate pairs, of smooth motions or random walks."""
    return st.builds(make_pair, seeds, st.integers(min_count, max_count), st.booleans())


def random_poses(seed: int, count: int = 8) -> Array:
    """Return poses (count, 4, 4) of all directions, some metres from the origin."""
    twists = np.random.default_rng(seed).normal(size=(count, 6))
    return se3.exp(twists * [3.0, 3.0, 3.0, 0.8, 0.8, 0.8])


def make_element(gauge: Gauge, seed: int, *, reach_m: float = 100.0) -> Similarity:
    """Return a random element of the gauge's group."""
    random = np.random.default_rng(seed)
    rotation, translation, scale = np.eye(3), np.zeros(3), 1.0
    if gauge.has_translation:
        translation = random.uniform(-reach_m, reach_m, size=3)
    if gauge.yaw_only:
        angle = random.uniform(-np.pi, np.pi)
        rotation = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()
    elif gauge.has_so3:
        rotation = Rotation.random(random_state=seed % 2**31).as_matrix()
    if gauge.has_scale:
        scale = float(np.exp(random.uniform(-1.5, 1.5)))
    return Similarity(rotation, translation, scale)


def as_matrix(element: Similarity) -> Array:
    """Return a gauge element as a matrix (4, 4)."""
    return se3.poses(element.linear, element.translation)


def moved(trajectory: Trajectory, element: Similarity) -> Trajectory:
    """Return the states moved, with covariances of the size that they had."""
    return dataclasses.replace(element.trajectory(trajectory), covariances=trajectory.covariances)


def along_line(along: Array, direction: list[float], *, noise_m: float = 0.0) -> Trajectory:
    """Return states at the distances `along` a straight line, ten a second, facing ahead."""
    random = np.random.default_rng(0)
    unit = np.asarray(direction, dtype=np.float64) / np.linalg.norm(direction)
    count = len(along)
    return Trajectory(
        stamps=START + np.arange(count, dtype=np.int64) * 100_000_000,
        positions=np.outer(along, unit) + random.normal(scale=1.0, size=(count, 3)) * noise_m,
        quaternions=Rotation.identity(count).as_quat(),
        velocities=np.outer(10.0 * np.gradient(along), unit),
    )


def all_statistics(evaluation: Evaluation) -> dict[str, Statistics | None]:
    """Return every statistic of an evaluation under a name of its own."""
    named: dict[str, Statistics | None] = dict(evaluation.ate)
    for segments in evaluation.relative or ():
        for metric, statistics in segments.statistics.items():
            named[f"{segments.length}: {metric}"] = statistics
    named.update({f"all lengths: {name}": item for name, item in evaluation.pooled.items()})
    return named


def assert_same_numbers(
    first: Evaluation, second: Evaluation, relative: float = 1e-9, absolute: float = 1e-12
) -> None:
    """Assert that two evaluations agree in all statistics, relative to each metric's size."""
    actual, theirs = all_statistics(first), all_statistics(second)
    assert actual.keys() == theirs.keys()
    for name, mine in actual.items():
        other = theirs[name]
        assert (mine is None) == (other is None), name
        if mine is None or other is None:
            continue
        assert mine.count == other.count, name
        tolerance = absolute + relative * max(mine.rmse, other.rmse)
        for field in dataclasses.fields(Statistics):
            a, b = getattr(mine, field.name), getattr(other, field.name)
            assert abs(a - b) <= tolerance, (name, field.name, a, b)
