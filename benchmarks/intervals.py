"""Simulates how often the interval of the supported ATE covers the true one.

Flights whose truth is known, groundtruth with noise of several kinds and three dropouts, and
estimates of several sizes; prints the table of docs/probabilistic.md, and of which half of the
seeds. A cell is a motion, a kind of noise and its size.

Usage: python -m benchmarks.intervals [--flights 20] [--first-seed 0]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from trajeval_ros.continuous_time.continuous_trajectory import fit_trajectory
from trajeval_ros.continuous_time.samples import Noise
from trajeval_ros.geometry.arrays import Floats
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.likelihood.uncertain_ate import uncertain_ate
from trajeval_ros.metrics.alignment import align

Path = Callable[[Floats], Floats]

RATES_HZ = {"smooth": 2.0, "stop-and-go": 2.0, "walk": 5.0, "walk at 2 Hz": 2.0}
NOISES = ("white", "AR 0.5 s", "AR 2 s", "AR 10 s", "Student t3", "2 % outliers")
SIZES_M = (0.002, 0.02)
_DURATION_S, _ESTIMATE_STEP_S, _FINE_S = 55.0, 0.05, 0.002
_SPEED_MPS, _BRAKING_MPS2 = 2.0, 8.0
# Position rmse, metres, and whether it is a random walk instead of waves of 0.05 to 0.4 Hz.
ESTIMATES = ((0.01, False), (0.03, False), (0.1, False), (0.03, True))
_WAVE_HZ = np.array([[0.05, 0.09, 0.21, 0.43], [0.06, 0.11, 0.25, 0.39], [0.04, 0.12, 0.3, 0.5]])
_WAVE_M = np.array([[4.0, 2.0, 0.5, 0.12], [3.0, 2.0, 0.5, 0.15], [1.0, 0.4, 0.15, 0.05]])


@dataclass(frozen=True)
class Found:
    """One interval.

    Attributes:
        true_m: The ATE against the flight itself.
        interval_m: That of the evaluation, or None if it was withheld.
    """

    true_m: float
    interval_m: tuple[float, float] | None

    @property
    def covers(self) -> bool:
        """Whether the interval holds the true ATE."""
        assert self.interval_m is not None
        return self.interval_m[0] <= self.true_m <= self.interval_m[1]

    @property
    def width(self) -> float:
        """Of the interval, by the true ATE."""
        assert self.interval_m is not None
        return (self.interval_m[1] - self.interval_m[0]) / self.true_m


def flown(motion: str, noise: str, size_m: float, seed: int) -> list[Found]:
    """Return the intervals of all estimates of one flight."""
    random = np.random.default_rng([seed, *motion.encode(), *noise.encode(), int(1e4 * size_m)])
    path = _path(motion, random)
    slow = np.arange(0.0, _DURATION_S, 1.0 / RATES_HZ[motion])
    for begin in np.linspace(4.0, _DURATION_S - 14.0, 3) + random.uniform(0.0, 8.0, 3):
        length = random.uniform(1.0, 2.5)
        slow = slow[(slow < begin) | (slow > begin + length)]
    measured = path(slow) + _noise(noise, slow, size_m, random)
    groundtruth = Trajectory(_stamps(slow), measured)
    times = np.arange(0.013, slow[-1], _ESTIMATE_STEP_S)
    truth = path(times)
    fitted = fit_trajectory(groundtruth, noise=Noise(position_m=size_m))
    belief = fitted.at(_stamps(times))
    result = []
    for error_m, walks in ESTIMATES:
        estimate = truth + _errors(times, error_m, random, walks=walks)
        ate = uncertain_ate(
            times,
            belief.poses[:, :3, 3],
            belief.covariances[:, :3, :3],
            estimate,
            Gauge.SE3,
            fitted.samples,
        )
        aligned = align(Gauge.SE3, truth, estimate).similarity.positions(estimate)
        rmse = float(np.sqrt(np.square(aligned - truth).sum(axis=1).mean()))
        result.append(Found(rmse, ate.interval_m))
    return result


def cells() -> Iterator[tuple[str, str, float]]:
    """Yield motions, kinds of noise and sizes."""
    for motion in RATES_HZ:
        for noise in NOISES:
            for size_m in SIZES_M:
                yield motion, noise, size_m


def _stamps(times: Floats) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return np.round(1e9 * times).astype(np.int64)


def _path(motion: str, random: np.random.Generator) -> Path:
    """Return positions (N, 3), metres, as a function of times (N,), seconds."""
    if motion == "smooth":
        phases = random.uniform(0.0, 2.0 * np.pi, size=_WAVE_HZ.shape)

        def waves(times: Floats) -> Floats:
            angles = 2.0 * np.pi * _WAVE_HZ * times[:, None, None] + phases
            return np.asarray((_WAVE_M * np.sin(angles)).sum(axis=2))

        return waves
    fine = np.arange(0.0, _DURATION_S + 2.0, _FINE_S)
    positions = _stop_and_go(fine, random) if motion == "stop-and-go" else _walk(fine, random)

    def between(times: Floats) -> Floats:
        return np.column_stack([np.interp(times, fine, item) for item in positions.T])

    return between


def _stop_and_go(fine: Floats, random: np.random.Generator) -> Floats:
    """Straight lines in all directions, with stops, and hard edges between both."""
    velocities = np.zeros((len(fine), 3))
    ramp, start = _SPEED_MPS / _BRAKING_MPS2, random.uniform(0.0, 0.5)
    while start < fine[-1]:
        end = start + 2.0 * ramp + random.uniform(0.5, 1.5)
        speed = np.clip((fine - start) / ramp, 0.0, 1.0) * np.clip((end - fine) / ramp, 0.0, 1.0)
        yaw, pitch = random.uniform(0.0, 2.0 * np.pi), random.uniform(-0.3, 0.3)
        heading = [np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)]
        velocities += _SPEED_MPS * speed[:, None] * heading
        start = end + random.uniform(0.5, 1.5)
    return np.asarray(np.cumsum(velocities, axis=0) * _FINE_S)


def _walk(fine: Floats, random: np.random.Generator) -> Floats:
    """A person's: 1.8 steps a second move the sensor up and down, and to both sides."""
    yaw = np.cumsum(random.normal(scale=0.01, size=len(fine)))
    yaw = np.convolve(yaw, np.full(250, 1.0 / 250.0), mode="same")
    ahead = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(fine))])
    left = np.column_stack([-np.sin(yaw), np.cos(yaw), np.zeros(len(fine))])
    of_step, of_pair = random.uniform(0.0, 2.0 * np.pi, 2)
    positions = np.cumsum(1.2 * ahead, axis=0) * _FINE_S
    positions += 0.02 * np.sin(1.8 * np.pi * fine + of_pair)[:, None] * left
    positions[:, 2] += 0.03 * np.sin(3.6 * np.pi * fine + of_step)
    return np.asarray(positions)


def _noise(kind: str, times: Floats, size_m: float, random: np.random.Generator) -> Floats:
    """Return noise (N, 3) of that standard deviation; outliers come on top."""
    shape = (len(times), 3)
    if kind.startswith("AR"):
        seconds = float(kind.split()[1])
        values = random.normal(size=shape)
        for row, step in enumerate(np.diff(times), start=1):
            kept = np.exp(-step / seconds)
            values[row] = kept * values[row - 1] + np.sqrt(1.0 - kept**2) * values[row]
        return size_m * values
    if kind.startswith("Student"):
        return np.asarray(size_m * random.standard_t(3, size=shape) / np.sqrt(3.0))
    values = random.normal(scale=size_m, size=shape)
    if kind.endswith("outliers"):
        directions = random.normal(size=shape)
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        lengths = size_m * random.uniform(10.0, 40.0, (len(times), 1))
        values += (random.random((len(times), 1)) < 0.02) * lengths * directions
    return values


def _errors(times: Floats, size_m: float, random: np.random.Generator, *, walks: bool) -> Floats:
    if walks:
        errors = np.cumsum(random.normal(size=(len(times), 3)), axis=0)
    else:
        angles = 2.0 * np.pi * random.uniform(0.05, 0.4, (6, 3)) * times[:, None, None]
        errors = np.sin(angles + random.uniform(0.0, 2.0 * np.pi, (6, 3))).sum(axis=1)
    errors -= errors.mean(axis=0)
    return np.asarray(size_m * errors / np.sqrt(np.square(errors).sum(axis=1).mean()))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=20, help="Of each cell, 4 estimates each.")
    parser.add_argument("--first-seed", type=int, default=0, help="Others follow.")
    options = parser.parse_args()
    print("| motion | noise | covered, 2 mm | width | covered, 2 cm | width | withheld |")
    print("|---|---|---|---|---|---|---|")
    for motion in RATES_HZ:
        for noise in NOISES:
            columns, withheld = "", 0
            for size_m in SIZES_M:
                seeds = range(options.first_seed, options.first_seed + options.flights)
                result = [item for seed in seeds for item in flown(motion, noise, size_m, seed)]
                known = [item for item in result if item.interval_m is not None]
                withheld += len(result) - len(known)
                covered = 100.0 * np.mean([item.covers for item in known])
                columns += f" {covered:.0f} % | {np.median([item.width for item in known]):.2f} |"
            print(f"| {motion} | {noise} |{columns} {withheld} |", flush=True)


if __name__ == "__main__":
    main()
