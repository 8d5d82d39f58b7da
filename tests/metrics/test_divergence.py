"""When a divergence is named, and what is none."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from benchmarks.diagnosis_runs import simulated
from trajeval_ros.geometry import lie
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.association import associate
from trajeval_ros.metrics.discontinuities.divergence import Divergence
from trajeval_ros.metrics.discontinuities.events import DIVERGED, ESTIMATE, Loss

AT_S, PERIOD_S = 60.0, 0.1  # begin of a fault, and time between pairs
ACROSS = np.array([0.6, 0.0, 0.8])


def curve(duration_s: float, speed_mps: float) -> tuple[np.ndarray, np.ndarray]:
    """Return seconds (N,) and poses (N, 7) of a body that looks where it goes."""
    seconds = np.arange(0.0, duration_s, PERIOD_S)
    heading, climb = 0.3 * seconds, 0.2 * np.sin(0.5 * seconds)
    rotations = Rotation.from_euler("ZY", np.column_stack([heading, climb]))
    steps = speed_mps * PERIOD_S * rotations.apply([1.0, 0.0, 0.0])
    return seconds, np.hstack([np.cumsum(steps, axis=0), rotations.as_quat()])


def seen_from(poses: np.ndarray, rotation: Rotation, scale: float) -> np.ndarray:
    """Return poses in another frame and unit."""
    rotated = rotation * Rotation.from_quat(poses[:, 3:])
    return np.hstack([scale * rotation.apply(poses[:, :3]), rotated.as_quat()])


def events_of(
    seconds: np.ndarray, true: np.ndarray, own: np.ndarray, size: int = 5
) -> tuple[list[Loss], list[float]]:
    """Return the events of pairs that come in batches, and when they were named, seconds."""
    divergence, named = Divergence(), list[float]()
    stamps = np.rint(1e9 * seconds).astype(np.int64) + 7 * 10**18
    for begin in range(0, len(stamps), size):
        rows = slice(begin, begin + size)
        divergence.add(stamps[rows], true[rows], own[rows])
        named += [seconds[rows][-1]] * (len(divergence.events) - len(named))
    return divergence.events, named


@pytest.mark.slow
@given(
    mps2=st.sampled_from([0.1, 0.3, 1.0, 3.0]),
    speed_mps=st.floats(0.3, 3.0),
    noise_m=st.floats(0.0, 0.01),
    scale=st.floats(0.05, 12.0),
    seed=st.integers(0, 1000),
    oriented=st.booleans(),
)
def test_a_divergence_is_named_soon(
    mps2: float, speed_mps: float, noise_m: float, scale: float, seed: int, *, oriented: bool
) -> None:
    """0.1 m/s^2 before 15 s and 1 m/s^2 within 3 s: where speeds differ by 1.5 and 3 m/s."""
    seconds, true = curve(AT_S + 20.0, speed_mps)
    own = true.copy()
    own[:, :3] += np.random.default_rng(seed).normal(0.0, noise_m, (len(own), 3))
    own[:, :3] += np.outer(0.5 * mps2 * np.maximum(seconds - AT_S, 0.0) ** 2, ACROSS)
    own = seen_from(own, Rotation.random(random_state=seed), scale)
    if not oriented:
        true[:, 3:] = own[:, 3:] = math.nan
    (event,), (named_s,) = events_of(seconds, true, own)
    assert (event.kind, event.side, event.is_over) == (DIVERGED, ESTIMATE, False)
    begin_s = event.t_ns / 1e9 - 7e9
    within_s = {0.1: 15.0, 0.3: 8.0, 1.0: 3.0, 3.0: 3.0}[mps2] + 3.0 * (not oriented)
    assert AT_S - 1.0 <= begin_s < named_s <= AT_S + within_s
    path_m = speed_mps * event.s
    assert event.m == pytest.approx(path_m, rel=0.05, abs=0.6 * speed_mps)
    moved_m = np.linalg.norm(np.diff(own[seconds >= begin_s, :3], axis=0), axis=1).sum() / scale
    assert event.moved_m == pytest.approx(moved_m, rel=0.15, abs=0.3 * speed_mps)


@pytest.mark.parametrize("seed", [0, 8, 15])
def test_a_slow_divergence_of_noisy_poses_is_named_at_changing_speed(seed: int) -> None:
    """It is not learned as usual while it is too small to be named."""
    random = np.random.default_rng(seed)
    seconds, true = curve(AT_S + 30.0, 1.0)
    phases, rates = random.uniform(0.0, 6.0, (6, 3)), random.uniform(0.3, 1.2, (6, 3))
    true[:, :3] = 4.0 * np.sin(seconds[:, None, None] * rates + phases).sum(axis=1)
    own = true.copy()
    own[:, :3] += random.normal(0.0, 0.01, (len(own), 3))
    own[:, :3] += np.outer(0.05 * np.maximum(seconds - AT_S, 0.0) ** 2, ACROSS)
    _, (named_s, *_) = events_of(seconds, true, own)
    assert AT_S < named_s < AT_S + 15.0


@pytest.mark.parametrize("noise_m", [0.001, 0.003])
def test_an_estimate_that_holds_with_noise_diverges(noise_m: float) -> None:
    seconds, true = curve(AT_S + 20.0, 1.0)
    held, random = true.copy(), np.random.default_rng(3)
    held[seconds >= AT_S] = held[seconds.searchsorted(AT_S)]
    held[:, :3] += random.normal(0.0, noise_m, (len(held), 3))
    (event,), (named_s,) = events_of(seconds, true, held)
    assert named_s < AT_S + 3.0
    assert event.moved_m < 0.2 * event.m


@pytest.mark.parametrize("seed", range(5))
def test_the_noise_of_a_car_that_stops_is_no_divergence(seed: int) -> None:
    """Ratios to the distance are learned while it drives; at rest noise exceeds them."""
    seconds, true = curve(3.0 * AT_S, 8.0)
    speed = np.clip(np.abs((seconds - 10.0) % 45.0 - 30.0) - 5.0, 0.0, 4.0) / 4.0
    path_s = np.cumsum(speed) * PERIOD_S
    true = true[np.minimum(np.rint(path_s / PERIOD_S).astype(int), len(true) - 1)]
    true[:, :3] = np.column_stack(
        [8.0 * np.sin(0.3 * path_s) / 0.3, 8.0 * np.cos(0.3 * path_s) / 0.3, 0.0 * path_s]
    )
    own, random = true.copy(), np.random.default_rng(seed)
    for side in (true, own):
        side[:, :3] += random.normal(0.0, 0.02, (len(side), 3))
    events, _ = events_of(seconds, true, own)
    assert not events


def test_a_scale_that_grows_is_a_divergence() -> None:
    seconds, true = curve(AT_S + 20.0, 1.5)
    begin = int(seconds.searchsorted(AT_S))
    own = true.copy()
    grows = 1.0 + 0.05 * (seconds[begin:] - AT_S)
    own[begin:, :3] = own[begin, :3] + grows[:, None] * (own[begin:, :3] - own[begin, :3])
    _, (named_s,) = events_of(seconds, true, own)
    assert AT_S < named_s < AT_S + 10.0


@pytest.mark.slow
@given(
    size=st.integers(20, 400),
    mps2=st.sampled_from([0.3, 3.0]),
    lasts_s=st.floats(2.0, 15.0),
    seed=st.integers(0, 100),
)
def test_it_ends_and_does_not_depend_on_batches(
    size: int, mps2: float, lasts_s: float, seed: int
) -> None:
    seconds, true = curve(AT_S + 40.0, 1.0)
    own, since_s = true.copy(), np.clip(seconds - AT_S, 0.0, lasts_s)
    own[:, :3] += np.outer(0.5 * mps2 * since_s**2, ACROSS)
    own[:, :3] += np.random.default_rng(seed).normal(0.0, 0.003, (len(own), 3))
    one, whole = (events_of(seconds, true, own, item)[0] for item in (size, len(own)))
    if mps2 * lasts_s > 3.0:
        assert len(whole) == 1
    for event in whole:
        # Six displacements of 0.5 s that agree end it.
        assert event.is_over
        assert event.end_ns / 1e9 - 7e9 == pytest.approx(AT_S + lasts_s + 3.25, abs=0.8)
    # Products of small and of large batches round differently: some units in the last place.
    for first, second in zip(one, whole, strict=True):
        motions = {
            name: pytest.approx(getattr(second, name), rel=1e-9) for name in ("m", "moved_m")
        }
        assert dataclasses.asdict(first) == dataclasses.asdict(second) | motions


@pytest.mark.slow
@given(
    size_m=st.floats(0.1, 100.0),
    count=st.integers(1, 3),
    angle=st.floats(-math.pi, math.pi),
    oriented=st.booleans(),
)
def test_outliers_steps_and_other_frames_are_no_divergence(
    size_m: float, count: int, angle: float, *, oriented: bool
) -> None:
    """Also not a restart, after which the estimate has another frame."""
    seconds, true = curve(AT_S + 30.0, 1.0)
    begin = int(seconds.searchsorted(AT_S))
    outlier, restarted = true.copy(), true.copy()
    outlier[begin : begin + count, :3] += size_m * ACROSS
    restarted[begin:] = seen_from(true[begin:], Rotation.from_euler("Z", angle), 1.0)
    restarted[begin:, :3] += size_m * ACROSS
    for own in (outlier, restarted):
        if not oriented:
            true[:, 3:] = own[:, 3:] = math.nan
        assert events_of(seconds, true, own, 50)[0] == []


def _at_rest(side: Trajectory, rest_s: float) -> Trajectory:
    """Return a side that rests for a time before it moves."""
    seconds = (side.stamps - side.stamps[0]) / 1e9
    rows = np.searchsorted(seconds, np.maximum(seconds - rest_s, 0.0))
    noise = np.random.default_rng(2).normal(0.0, 0.002, side.positions.shape)
    assert side.quaternions is not None
    positions, quaternions = side.positions[rows] + noise, side.quaternions[rows]
    return dataclasses.replace(side, positions=positions, quaternions=quaternions)


@pytest.mark.slow
@pytest.mark.parametrize("drift", ["walk", "heavy"])
@pytest.mark.parametrize("kind", ["drone", "handheld", "car", "robot"])
def test_healthy_runs_do_not_diverge(kind: str, drift: str) -> None:
    """With a lever arm, a scale, an offset, slow or noisy groundtruth, and at rest."""
    pair = simulated(71_000, kind, drift, 300.0)
    true, own = pair.truth, pair.estimate
    assert own.quaternions is not None
    random, lever = np.random.default_rng(1), np.tile([0.3, 0.1, -0.05], (len(own), 1))
    arm = lie.rotate(own.quaternions, lever)
    noise = random.normal(0.0, 0.02, true.positions.shape)
    sides = {
        "plain": (true, own),
        "lever arm": (true, dataclasses.replace(own, positions=own.positions + arm)),
        "small": (true, dataclasses.replace(own, positions=0.05 * own.positions)),
        "large": (true, dataclasses.replace(own, positions=12.0 * own.positions)),
        "late": (true, dataclasses.replace(own, stamps=own.stamps + 50_000_000)),
        "slow": (true[::20], own),
        "noisy": (dataclasses.replace(true, positions=true.positions + noise), own),
        "at rest": (_at_rest(true, 150.0), _at_rest(own, 150.0)),
    }
    rule = dataclasses.replace(pair.protocol.association, max_gap_s=0.3)
    for name, (groundtruth, estimate) in sides.items():
        pairs = associate(groundtruth, estimate, rule)
        columns = [
            np.hstack([side.positions, side.quaternions])
            for side in (pairs.groundtruth, pairs.estimate)
        ]
        divergence = Divergence()
        divergence.add(pairs.estimate.stamps, *columns)
        assert not divergence.events, name
