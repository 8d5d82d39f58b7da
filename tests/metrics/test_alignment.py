"""Alignment is the least-squares optimum in its gauge; moments are sums."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from strategies import Array, along_line, make_element, make_estimate, make_groundtruth, seeds

from trajeval_ros.exceptions import DegenerateGeometryError
from trajeval_ros.geometry.gauge import Gauge, Similarity
from trajeval_ros.metrics.alignment import align, align_first, solve
from trajeval_ros.metrics.moments import Moments
from trajeval_ros.metrics.pair_alignment import position_weights

UTM = np.array([4.5e5, 5.2e6, 400.0])
ALIGNING = [Gauge.TRANSLATION, Gauge.YAW, Gauge.PLANAR, Gauge.SE3, Gauge.SIM3]


def points(
    seed: int, count: int = 60, *, error_m: float = 0.1, offset: Array | None = None
) -> tuple[Array, Array]:
    """Return positions of a groundtruth, and of an estimate in another frame."""
    truth = make_groundtruth(seed, 2 * count + 2)
    estimate = make_estimate(truth, seed + 1, error_m=error_m).positions
    p = truth.positions[1:-1:2]
    return (p, estimate) if offset is None else (p + offset, estimate + offset)


def cost(similarity: Similarity, p: Array, q: Array, weights: Array | None = None) -> float:
    squares = np.sum(np.square(p - similarity.positions(q)), axis=1)
    return float(np.average(squares, weights=weights))


def sample_rmse(similarity: Similarity, p: Array, q: Array) -> float:
    """Return the rmse of differences, taken in extended precision."""
    linear = np.longdouble(similarity.scale) * similarity.rotation.astype(np.longdouble)
    residuals = p - (q.astype(np.longdouble) @ linear.T + similarity.translation)
    return float(np.sqrt(np.mean(np.sum(np.square(residuals), axis=1))))


@pytest.mark.parametrize("gauge", ALIGNING)
@given(seed=seeds)
def test_an_element_of_the_gauge_is_found_again(gauge: Gauge, seed: int) -> None:
    q, _ = points(seed)
    element = make_element(gauge, seed + 2)
    result = align(gauge, element.positions(q), q)
    assert result.states_used == len(q)
    assert result.undetermined == ""
    np.testing.assert_allclose(result.similarity.rotation, element.rotation, atol=1e-12)
    np.testing.assert_allclose(result.similarity.translation, element.translation, atol=1e-10)
    assert result.similarity.scale == pytest.approx(element.scale, rel=1e-12)


@pytest.mark.parametrize("gauge", list(Gauge))
@pytest.mark.parametrize("weighted", [False, True])
@settings(max_examples=10)
@given(seed=seeds)
def test_no_other_element_of_the_gauge_fits_better(
    gauge: Gauge, weighted: bool, seed: int
) -> None:
    p, q = points(seed, error_m=0.5)
    random = np.random.default_rng(seed)
    weights = random.uniform(0.1, 10.0, size=len(p)) if weighted else None
    best = align(gauge, p, q, weights).similarity
    least = cost(best, p, q, weights)
    for _ in range(20):
        step = 10.0 ** random.uniform(-4, 0) * random.normal(size=7)
        if not gauge.has_translation:
            step[3:6] = 0.0
        if not gauge.has_so3:
            step[:2] = 0.0
        if not (gauge.has_so3 or gauge.yaw_only):
            step[2] = 0.0
        if not gauge.has_scale:
            step[6] = 0.0
        # Turned and stretched about the middle, so that small steps stay small.
        linear = Rotation.from_rotvec(step[:3]).as_matrix()
        growth = float(np.exp(step[6]))
        centre = best.positions(q).mean(axis=0)
        other = Similarity(
            linear @ best.rotation,
            growth * linear @ (best.translation - centre) + centre + step[3:6],
            best.scale * growth,
        )
        assert cost(other, p, q, weights) >= least * (1.0 - 1e-12)


def test_an_estimate_in_other_units_loses_no_digits() -> None:
    random = np.random.default_rng(4)
    truth = random.normal(size=(5, 3)) * [5.0, 0.05, 0.02]
    estimate = truth + 1e-3 * random.normal(size=(5, 3))
    # A power of two changes no digit of the estimate.
    small, large = (align("sim3", truth, unit * estimate).similarity for unit in (1.0, 1024.0))
    np.testing.assert_allclose(large.rotation, small.rotation, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(1024.0 * large.scale, small.scale, rtol=1e-14)


def test_a_yaw_is_determined_even_if_the_estimate_is_upside_down() -> None:
    p, _ = points(7, error_m=0.0)
    p = p * [1.0, 1.0, 5.0]
    freedom = align(Gauge.YAW, p, p * [1.0, 1.0, -1.0]).freedom
    assert freedom is not None
    assert np.isfinite(freedom.std_deg)


@given(seed=seeds)
def test_the_first_state_alone_fixes_se3(seed: int) -> None:
    truth = make_groundtruth(seed, 2)
    assert truth.quaternions is not None
    element = make_element(Gauge.SE3, seed + 1)
    inverse = Similarity(element.rotation.T, -element.rotation.T @ element.translation)
    other = inverse.trajectory(truth)
    assert other.quaternions is not None
    result = align_first(
        Gauge.SE3,
        truth.positions[0],
        truth.quaternions[0],
        other.positions[0],
        other.quaternions[0],
    ).similarity
    np.testing.assert_allclose(result.rotation, element.rotation, atol=1e-13)
    np.testing.assert_allclose(result.translation, element.translation, atol=1e-11)


@given(a=seeds, b=seeds)
def test_the_first_states_yaw_brings_the_rotations_closest(a: int, b: int) -> None:
    truth, other = (Rotation.random(random_state=seed % 2**31) for seed in (a, b))
    result = align_first(
        Gauge.YAW, np.ones(3), truth.as_quat(), np.zeros(3), other.as_quat()
    ).similarity

    def trace(angle: float) -> float:  # eq. (20)
        rotation = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()
        return float(np.trace(rotation @ other.as_matrix() @ truth.as_matrix().T))

    angle = np.arctan2(result.rotation[1, 0], result.rotation[0, 0])
    assert all(trace(angle) >= trace(item) - 1e-12 for item in np.linspace(-np.pi, np.pi, 73))
    np.testing.assert_array_equal(result.rotation[2], [0.0, 0.0, 1.0])
    np.testing.assert_allclose(result.translation, np.ones(3))


@pytest.mark.parametrize("gauge", list(Gauge))
@pytest.mark.parametrize("offset", [np.zeros(3), UTM], ids=["local", "utm"])
@settings(max_examples=10)
@given(seed=seeds, cut=st.integers(1, 50))
def test_moments_of_parts_add_up_to_those_of_the_whole(
    gauge: Gauge, offset: Array, seed: int, cut: int
) -> None:
    p, q = points(seed, error_m=0.01, offset=offset)
    whole = Moments.of_pairs(p, q)
    first = Moments.of_pairs(p[:cut], q[:cut], anchor=whole.anchor)
    second = Moments.of_pairs(p[cut:], q[cut:], anchor=whole.anchor)
    for moments in (first + second, second + first, whole + first - first):
        solution = solve(gauge, moments)
        similarity, why = solution.similarity, solution.undetermined
        assert why == ""
        assert moments.weight == pytest.approx(len(p))
        assert moments.rmse(similarity) == pytest.approx(
            sample_rmse(similarity, p, q), rel=1e-6, abs=1e-9
        )
        best = solve(gauge, whole).similarity
        assert moments.rmse(similarity) == pytest.approx(whole.rmse(best), rel=1e-9)
        np.testing.assert_allclose(similarity.rotation, best.rotation, atol=1e-11)
    left = whole - first
    np.testing.assert_allclose(left.mean, second.mean, rtol=1e-12, atol=1e-9)
    size = np.trace(whole.scatter[:3, :3])
    # Means are known to the rounding of coordinates, 1e-9 m at 5000 km.
    rounding = 1e-12 * size + 1e-15 * float(np.abs(offset).max()) * np.sqrt(size * len(p))
    np.testing.assert_allclose(left.scatter, second.scatter, rtol=0, atol=rounding)
    best = solve(gauge, second).similarity
    assert left.rmse(solve(gauge, left).similarity) == pytest.approx(
        second.rmse(best), rel=1e-6, abs=1e-9
    )


@given(seed=seeds, cuts=st.tuples(st.integers(1, 29), st.integers(30, 59)))
def test_merging_moments_is_associative_and_the_empty_ones_are_its_zero(
    seed: int, cuts: tuple[int, int]
) -> None:
    p, q = points(seed)
    anchor = Moments.of_pairs(p, q).anchor
    a, b, c = (
        Moments.of_pairs(each_p, each_q, anchor=anchor)
        for each_p, each_q in zip(np.split(p, cuts), np.split(q, cuts), strict=True)
    )
    zero = Moments.empty(anchor)
    for left, right in (
        ((a + b) + c, a + (b + c)),
        (a + b, b + a),
        (a + zero, a),
        (zero + a, a),
        (a - zero, a),
        (a - a, zero),
    ):
        for name in ("weight", "mean", "scatter"):
            actual, theirs = getattr(left, name), getattr(right, name)
            np.testing.assert_allclose(actual, theirs, rtol=1e-12, atol=1e-10, err_msg=name)


def test_a_window_can_slide_for_long() -> None:
    p, q = points(11, 600, error_m=0.01, offset=UTM)
    anchor = Moments.of_pairs(p[:50], q[:50]).anchor
    window = Moments.of_pairs(p[:50], q[:50], anchor=anchor)
    for i in range(50, 600):
        window += Moments.of_pairs(p[i : i + 1], q[i : i + 1], anchor=anchor)
        window -= Moments.of_pairs(p[i - 50 : i - 49], q[i - 50 : i - 49], anchor=anchor)
    similarity = solve(Gauge.SE3, window).similarity
    batch = align(Gauge.SE3, p[550:], q[550:]).similarity
    assert window.rmse(similarity) == pytest.approx(sample_rmse(batch, p[550:], q[550:]), rel=1e-6)


@pytest.mark.parametrize("count", [4095, 4096, 8192, 8193, 20_001, 70_000])
def test_moments_of_many_pairs_are_those_of_few(count: int) -> None:
    random = np.random.default_rng(count)
    q = random.normal(size=(count, 3)) + UTM
    p = q + random.normal(scale=0.01, size=(count, 3)) + [3.0, 0.0, 0.0]
    weights = random.uniform(0.5, 2.0, size=count)
    moments = Moments.of_pairs(p, q, weights)
    assert moments.weight == pytest.approx(weights.sum())
    centre = np.average(q - UTM, axis=0, weights=weights)
    # A block's mean is one scalar product of up to 8192 terms, which is known to 8192 u.
    rounding = 8192 * np.finfo(np.float64).eps / 2.0 * UTM.max()
    np.testing.assert_allclose(moments.mean_q - UTM, centre, rtol=0, atol=rounding)
    scatter = ((q - UTM - centre) * weights[:, None]).T @ (q - UTM - centre)
    np.testing.assert_allclose(moments.scatter[:3, :3], scatter, rtol=1e-7, atol=1e-7 * count)


@given(seed=seeds)
def test_moments_do_not_depend_on_their_anchor(seed: int) -> None:
    p, q = points(seed, error_m=0.01)
    anchored = [
        Moments.of_pairs(p, q, anchor=anchor)
        for anchor in (None, Similarity.identity(), align(Gauge.SE3, p, q).similarity)
    ]
    for gauge in ALIGNING:
        best = [moments.rmse(solve(gauge, moments).similarity) for moments in anchored]
        np.testing.assert_allclose(best, best[0], rtol=1e-8)


@given(seed=seeds)
def test_moments_know_the_mean_and_the_spread_under_any_linear_map(seed: int) -> None:
    p, q = points(seed, error_m=0.01)
    linear = np.random.default_rng(seed).normal(size=(3, 3))
    differences = p - q @ linear.T
    moments = Moments.of_pairs(p, q)
    np.testing.assert_allclose(
        moments.mean_difference(linear), differences.mean(axis=0), rtol=1e-9, atol=1e-9
    )
    apart = differences - differences.mean(axis=0)
    spread = np.sqrt(np.mean(np.sum(apart**2, axis=1)))
    assert moments.spread(linear) == pytest.approx(spread, rel=1e-9)


def test_moments_under_different_anchors_are_not_added_silently() -> None:
    p, q = points(12)
    one = Moments.of_pairs(p[:30], q[:30])
    other = Moments.of_pairs(p[30:], q[30:])
    with pytest.raises(ValueError, match="anchor"):
        _ = one + other


def test_moments_of_no_pairs_are_empty() -> None:
    nothing = np.empty((0, 3))
    moments = Moments.of_pairs(nothing, nothing)
    assert moments.weight == 0.0
    assert np.isfinite(moments.anchor.translation).all()


def test_weights_are_the_inverse_of_variance_with_the_errors_as_a_floor() -> None:
    covariances = np.zeros((3, 6, 6))
    covariances[:, :3, :3] = np.diag([1.0, 2.0, 6.0]) * np.array([0.0, 1.0, 4.0])[:, None, None]
    covariances[:, 3:, 3:] = 100.0 * np.eye(3)
    weights = position_weights(covariances, 0.6)
    np.testing.assert_allclose(1.0 / weights, np.array([0.0, 3.0, 12.0]) + 0.36 / 3.0)


@pytest.mark.parametrize("gauge", [Gauge.YAW, Gauge.PLANAR, Gauge.SE3, Gauge.SIM3])
def test_too_few_states_are_counted_in_the_refusal(gauge: Gauge) -> None:
    p, q = points(7)
    few = gauge.minimum_states - 1
    with pytest.raises(DegenerateGeometryError, match=f"at least {few + 1} .* {few}"):
        align(gauge, p[:few], q[:few])
    align(gauge, p[: few + 1], q[: few + 1])


@pytest.mark.parametrize(
    ("gauge", "direction", "axis"),
    [
        (Gauge.SE3, [1.0, 2.0, 0.5], "the direction of travel"),
        (Gauge.YAW, [0.0, 0.0, 1.0], "gravity"),
    ],
)
def test_the_axis_that_positions_leave_open_is_named(
    gauge: Gauge, direction: list[float], axis: str
) -> None:
    line = along_line(np.linspace(0.0, 20.0, 50), direction).positions
    noisy = line + np.random.default_rng(1).normal(scale=0.01, size=line.shape)
    assert f"rotation about {axis}:" in align(gauge, line, noisy).undetermined
