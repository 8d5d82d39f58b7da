"""The error of an estimate without the noise of the fixes, and jumps of either."""

from __future__ import annotations

import numpy as np
import pytest
from fix_runs import fixes_of, quality
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from trajeval_ros import AssociationRule, Protocol, Request, run
from trajeval_ros.geometry.fix_selection import FixRule
from trajeval_ros.geometry.gauge import Gauge
from trajeval_ros.geometry.trajectory import Trajectory
from trajeval_ros.metrics.alignment import align
from trajeval_ros.metrics.noise_corrected_ate import correlations_of, debiased, jumps_of

COUNT = 200
TIMES = np.arange(COUNT, dtype=float)
PATH = np.stack([40 * np.cos(TIMES / 30), 40 * np.sin(TIMES / 30), 2 * np.sin(TIMES / 7)], 1)
STAMPS = (TIMES * 1e9).astype(np.int64) + 1_700_000_000 * 10**9
SIGMAS = np.array([0.3, 0.3, 0.6])


def noise_of(correlation_s: float) -> np.ndarray:
    if correlation_s == 0.0:
        return np.eye(COUNT)
    return correlations_of(STAMPS, correlation_s)


@pytest.mark.slow
@pytest.mark.parametrize("correlation_s", [0.0, 30.0, 1e6])
def test_the_square_has_no_bias(correlation_s: float) -> None:
    random = np.random.default_rng(1)
    truth = PATH + np.cumsum(random.standard_normal((COUNT, 3)), axis=0) * 0.02
    exact = truth - align(Gauge.YAW, truth, PATH).similarity.positions(PATH)
    expected = float(np.square(exact).sum(axis=1).mean())
    covariances = np.tile(np.diag(SIGMAS**2), (COUNT, 1, 1))
    noise = noise_of(correlation_s)
    root = np.linalg.cholesky(noise + 1e-12 * np.eye(COUNT))
    squares, inside, draws = [], 0, 300
    for _ in range(draws):
        fixes = truth + root @ random.standard_normal((COUNT, 3)) * SIGMAS
        aligned = align(Gauge.YAW, fixes, PATH).similarity.positions(PATH)
        estimated = debiased(fixes - aligned, aligned, covariances, noise, Gauge.YAW)
        naive = float(np.square(fixes - aligned).sum(axis=1).mean())
        squares.append(naive - estimated.noise_rms_m**2)
        inside += estimated.interval_m[0] <= np.sqrt(expected) <= estimated.interval_m[1]
    off = (np.mean(squares) - expected) / (np.std(squares) / np.sqrt(draws))
    assert abs(off) < 3.0
    assert inside >= 0.9 * draws


@given(st.sampled_from(["none", "translation", "yaw", "se3", "sim3"]), st.integers(0, 100))
def test_without_noise_it_is_the_ate(gauge: str, seed: int) -> None:
    random = np.random.default_rng(seed)
    errors = random.standard_normal((COUNT, 3))
    nothing = np.zeros((COUNT, 3, 3))
    estimated = debiased(errors, PATH, nothing, noise_of(100.0), Gauge.of(gauge))
    ate = np.sqrt(np.square(errors).sum(axis=1).mean())
    assert estimated.ate_m == pytest.approx(ate)
    assert estimated.interval_m == pytest.approx((ate, ate))
    assert estimated.noise_rms_m == 0.0


def test_noise_that_never_changes_is_aligned_away() -> None:
    errors = np.random.default_rng(0).standard_normal((COUNT, 3))
    covariances = np.tile(np.diag(SIGMAS**2), (COUNT, 1, 1))
    constant = np.ones((COUNT, COUNT))
    estimated = debiased(errors, PATH, covariances, constant, Gauge.TRANSLATION)
    assert estimated.noise_rms_m == pytest.approx(0.0, abs=1e-6)
    assert estimated.effective == pytest.approx(1.0)
    # And what is new each time is worth its number.
    estimated = debiased(errors, PATH, covariances, np.eye(COUNT), Gauge.TRANSLATION)
    assert estimated.effective == pytest.approx(COUNT)


def test_a_jump_is_there_and_back() -> None:
    random = np.random.default_rng(4)
    errors = np.cumsum(random.standard_normal((COUNT, 3)) * 0.01, axis=0)
    assert not jumps_of(STAMPS, errors).any()
    errors[50:58, :2] += 5.0
    assert np.flatnonzero(jumps_of(STAMPS, errors)).tolist() == list(range(50, 58))
    errors[120:, 0] += 5.0  # for good: that is believed
    assert np.flatnonzero(jumps_of(STAMPS, errors)).tolist() == list(range(50, 58))


def _dense(gauge: Gauge, aligned: np.ndarray, covariances: np.ndarray, noise: np.ndarray) -> tuple:
    """Return C (3N, 3N), and P, which removes what the gauge moves: by numeric derivatives."""
    left, values, _ = np.linalg.svd(covariances)
    halves = np.einsum("nij,nj,nkj->nik", left, np.sqrt(values), left)
    dense = np.einsum("iab,ij,jbc->iajc", halves, noise, halves)
    count = len(aligned)
    moves = [np.tile(axis, (count, 1)).ravel() for axis in np.eye(3)]
    axes = {Gauge.TRANSLATION: [], Gauge.PLANAR: [2], Gauge.YAW: [2]}.get(gauge, [0, 1, 2])
    centred = aligned - aligned.mean(axis=0)
    small = 1e-6
    for axis in axes:
        rotation = Rotation.from_rotvec(small * np.eye(3)[axis])
        moves.append(
            (rotation.apply(centred) - rotation.inv().apply(centred)).ravel() / (2.0 * small)
        )
    if gauge.has_scale:
        moves.append(centred.ravel())
    basis = np.column_stack(moves)
    return dense.reshape(3 * count, 3 * count), np.eye(3 * count) - basis @ np.linalg.pinv(basis)


@pytest.mark.parametrize("gauge", [item for item in Gauge if item is not Gauge.NONE], ids=str)
def test_the_formulas_are_those_of_dense_matrices(gauge: Gauge) -> None:
    """E|r|^2 = |Pe|^2 + tr(PC), and the variance of |r|^2 of a Gaussian: 2 tr(PCPC) + 4 e'PCPe."""
    random, count = np.random.default_rng(2), 9
    aligned = 3.0 * random.standard_normal((count, 3))
    roots = random.standard_normal((count, 3, 3))
    if gauge is Gauge.PLANAR:
        roots[:, 2] = 0.0
        aligned[:, 2] = 0.0
    covariances = 0.1 * roots @ roots.swapaxes(1, 2)
    noise = correlations_of(STAMPS[:count], 4.0)
    dense, projection = _dense(gauge, aligned, covariances, noise)
    errors = (projection @ random.standard_normal(3 * count)).reshape(count, 3) * 5.0
    estimated = debiased(errors, aligned, covariances, noise, gauge)
    within = projection @ dense @ projection
    column, explained = errors.ravel(), float(np.trace(within))
    square = float(np.square(within).sum())
    assert estimated.noise_rms_m == pytest.approx(np.sqrt(explained / count), rel=1e-6)
    value = (column @ column - explained) / count
    assert estimated.ate_m == pytest.approx(np.sqrt(value), rel=1e-6)
    spread = 2.0 * square + 4.0 * (column @ dense @ column - square)
    half_width = 1.959963984540054 * np.sqrt(spread) / count
    expected = np.sqrt(np.maximum(0.0, value + np.array([-half_width, half_width])))
    assert estimated.interval_m == pytest.approx(tuple(expected), rel=1e-5)
    blocks = sum(float(np.square(covariance).sum()) for covariance in covariances)
    assert estimated.effective == pytest.approx(count * blocks / np.square(dense).sum())


def runs_of(*estimates: np.ndarray, fixes: np.ndarray = PATH, kind: int = 2) -> list:
    random = np.random.default_rng(7)
    noisy = fixes + 0.02 * random.standard_normal(fixes.shape)
    truth = fixes_of(STAMPS, noisy, quality(COUNT, kind=kind))
    rotated = np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1))
    rotated[:, 2], rotated[:, 3] = np.sin(TIMES / 60), np.cos(TIMES / 60)
    others = [
        Trajectory(STAMPS, estimate, rotated, name=f"e{number}")
        for number, estimate in enumerate(estimates)
    ]
    # The states are a second apart.
    association = AssociationRule("groundtruth-stamps", max_gap_s=2.0)
    protocol = Protocol(gauge="yaw", association=association, lengths=())
    rule = Request(protocol, fixes=FixRule(correlation_s=60.0))
    return list(run(truth, others, rule).runs)


def drifting(seed: int) -> np.ndarray:
    steps = np.random.default_rng(seed).standard_normal((COUNT, 3))
    return PATH + np.cumsum(steps, axis=0) * 0.02


def test_nothing_is_dropped_because_it_disagrees() -> None:
    jumping = drifting(1)
    jumping[100:120] += [20.0, 0.0, 0.0]
    (result,) = runs_of(jumping)
    assert len(result.evaluation.association) == COUNT
    ate, estimated = result.evaluation.ate["position_m"], result.noise_corrected_ate
    assert ate is not None
    assert ate.rmse > 5.0
    assert estimated is not None
    assert estimated.jumps == 20
    assert estimated.ate_m < 0.5 < estimated.with_jumps_m
    assert not estimated.resolved  # that claims no more than an upper end
    assert any("add a second estimate" in warning for warning in result.evaluation.warnings)


@pytest.mark.slow
def test_a_jump_of_one_estimate_is_its_own() -> None:
    jumping = drifting(1)
    jumping[100:110] += [20.0, 0.0, 0.0]
    bad, good = runs_of(jumping, drifting(2))
    assert bad.noise_corrected_ate is not None
    assert good.noise_corrected_ate is not None
    assert (bad.noise_corrected_ate.jumps, bad.noise_corrected_ate.single_jumps) == (0, 10)
    assert (good.noise_corrected_ate.jumps, good.noise_corrected_ate.single_jumps) == (0, 0)
    assert bad.noise_corrected_ate.ate_m > 3.0
    assert any("only this estimate jumps" in w for w in bad.evaluation.warnings)


@pytest.mark.slow
def test_a_jump_of_all_is_the_fixes() -> None:
    multipath = PATH.copy()
    multipath[60:66] += [8.0, 0.0, 0.0]
    result = runs_of(drifting(1), drifting(2), fixes=multipath)
    assert len(result) == 2
    for item in result:
        assert item.noise_corrected_ate is not None
        assert (item.noise_corrected_ate.jumps, item.noise_corrected_ate.single_jumps) == (6, 0)
        assert item.noise_corrected_ate.ate_m < 0.5 < item.noise_corrected_ate.with_jumps_m
        assert any("caused by the receiver" in w for w in item.evaluation.warnings)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [0, 1, 2, 3])
def test_covariances_that_nobody_knows_give_no_figure(kind: int) -> None:
    (result,) = runs_of(drifting(1), kind=kind)
    if kind == 0:
        assert result.noise_corrected_ate is None
        assert any(
            "200 of the 200 paired fixes have no cov" in w for w in result.evaluation.warnings
        )
    else:
        assert result.noise_corrected_ate is not None
        assert result.noise_corrected_ate.by_guess == (kind == 1)
        low, high = result.noise_corrected_ate.interval_m
        assert low <= result.noise_corrected_ate.ate_m <= high


@pytest.mark.slow
def test_heights_that_change_their_meaning_are_told() -> None:
    stepping = PATH.copy()
    stepping[80:, 2] += 47.0
    (result,) = runs_of(drifting(1), fixes=stepping)
    assert any("change by +47" in w and "sea level" in w for w in result.evaluation.warnings)
    (result,) = runs_of(drifting(1))
    assert not any("sea level" in w for w in result.evaluation.warnings)
